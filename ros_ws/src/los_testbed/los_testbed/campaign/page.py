"""HTML page of a campaign; pictures are histograms and maps of fixed size, so the file is as large for any number."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from lftkit.arrays import FloatArray
from los_testbed.campaign.dataset import Campaign, ResultFolder
from los_testbed.campaign.influence import yield_curve
from los_testbed.campaign.meanings import RANKED, meaning
from los_testbed.campaign.overview import quantile_heads
from los_testbed.campaign.sampling import COLUMNS, box
from los_testbed.campaign.verdict import LOST
from pointing_analysis.files.atomic_output import write_text
from pointing_analysis.report.figures import COLOURS, LIMIT, Picture, picture

TEMPLATE = Path(__file__).with_name("campaign.html.j2")
BINS, CELLS, LEVELS = 40, 16, 200
FEW, PER_CELL = 64, 6
"""Members that a map shows as points; members a cell of a map of more, so that hardly any cell is empty."""

MAPS = 3
ERROR = "relative error [mas]"
MAP = "viridis_r"
"""Large values stand out from the paper, also where a dark scheme inverts the lightness."""


def write_page(campaign: Campaign, folder: ResultFolder, summary: dict[str, Any], path: Path) -> Path:
    """Write the page of a campaign.

    Parameters
    ----------
    campaign : Campaign
    folder : ResultFolder
        With rows.
    summary : dict
        Of :func:`los_testbed.campaign.overview.campaign_summary`.
    path : Path
        An existing file is replaced.
    """
    table = folder.table([*COLUMNS, RANKED[campaign.depth], "status"])
    metric = table.column(RANKED[campaign.depth]).to_numpy()
    lost = np.array([s in LOST for s in table.column("status").to_pylist()])
    metric = np.where(lost, np.inf, metric)
    points = np.column_stack([table.column(name).to_numpy() for name in COLUMNS])
    known = ~np.isnan(metric)
    pictures = _pictures(summary, points[known], metric[known], campaign)
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    text = environment.from_string(TEMPLATE.read_text(encoding="utf-8")).render(
        summary=summary,
        meaning=meaning,
        manifest=campaign.manifest(),
        quantiles=quantile_heads(summary),
        pictures=[
            {
                "title": p.title,
                "alt": p.alt,
                "data": "data:image/svg+xml;base64," + base64.b64encode(p.svg).decode(),
            }
            for p in pictures
        ],
    )
    write_text(path, text)
    return path


def _pictures(summary: dict[str, Any], points: FloatArray, metric: FloatArray, campaign: Campaign) -> list[Picture]:
    finite = metric[np.isfinite(metric)]
    if not finite.size:
        return []
    name = summary["ranked_by"]
    given = sorted({v["limit"] for v in summary["verdicts"] if v["unit"] == "mas"})
    limits = [limit for limit in given if limit <= given[0] or limit < 1.5 * finite.max()]
    ranges = box(campaign.base.parameters)
    first = [entry["parameter"] for entry in summary["influence"]] or list(COLUMNS)
    pairs = [(first[0], first[1]), (first[0], first[2]), (first[1], first[2])][:MAPS]
    return [
        _distribution(name, finite, limits),
        _yield(name, metric, limits),
        *(_map(name, pair, points, metric, ranges, k) for k, pair in enumerate(pairs)),
    ]


def _limits(axis: Axes, limits: Sequence[float]) -> None:
    for number, limit in enumerate(limits):
        axis.axvline(limit, color=LIMIT, linestyle="--", linewidth=0.9, label="" if number else "limit")


def _distribution(name: str, metric: FloatArray, limits: Sequence[float]) -> Picture:
    bins = min(BINS, max(8, int(2.0 * np.sqrt(len(metric)))))

    def draw(figure: Figure) -> None:
        axis = figure.subplots()
        axis.hist(metric, bins=bins, color=COLOURS[0], label="members")
        _limits(axis, limits)
        axis.set_xlabel(ERROR)
        axis.set_ylabel("members")
        axis.yaxis.set_major_locator(MaxNLocator(integer=True))
        figure.legend(*axis.get_legend_handles_labels(), loc="outside upper left", ncols=2)

    alt = f"Histogram of {name} over the members; dashed: limits."
    return picture("distribution", f"Distribution of {name}", alt, 2.8, draw)


def _yield(name: str, metric: FloatArray, limits: Sequence[float]) -> Picture:
    finite = metric[np.isfinite(metric)]
    ends = np.array([finite.min(), finite.max(), *limits])
    levels = np.asarray(np.linspace(0.99 * ends.min(), 1.01 * ends.max(), LEVELS), dtype=float)
    share, bound = yield_curve(metric, levels)

    def draw(figure: Figure) -> None:
        axis = figure.subplots()
        axis.step(levels, 100.0 * share, where="post", color=COLOURS[0], label="below the level")
        axis.plot(levels, 100.0 * bound, color=COLOURS[1], linestyle=":", label="at least, 95 % confidence")
        _limits(axis, limits)
        axis.set_xlabel(f"level of the {ERROR}")
        axis.set_ylabel("members [%]")
        figure.legend(*axis.get_legend_handles_labels(), loc="outside upper left", ncols=3, columnspacing=1.2)

    return picture("yield", "Yield", f"Share of the members below each level of {name}; dashed: limits.", 2.8, draw)


def _label(parameter: str) -> str:
    return parameter if parameter == "tau" else f"{parameter} [rad/s]"


def _map(
    name: str,
    pair: tuple[str, str],
    points: FloatArray,
    metric: FloatArray,
    ranges: dict[str, tuple[float, float]],
    number: int,
) -> Picture:
    """Largest value in cells of two parameters; few members as points, those that are lost as red crosses."""
    finite = np.isfinite(metric)
    top = float(metric[finite].max())
    x, y = (points[:, COLUMNS.index(parameter)] for parameter in pair)

    def draw(figure: Figure) -> None:
        axis = figure.subplots()
        if len(metric) < FEW:
            image: Any = axis.scatter(x[finite], y[finite], c=metric[finite], cmap=MAP, s=30)
            axis.scatter(x[~finite], y[~finite], c=LIMIT, marker="x", s=30)
        else:
            edges, cells = _cells((x, y), np.where(finite, metric, 1.2 * top), [ranges[p] for p in pair])
            image = axis.pcolormesh(*edges, cells, cmap=MAP, rasterized=True)
            axis.grid(False)
        figure.colorbar(image, label=ERROR if len(metric) < FEW else f"largest {ERROR}")
        axis.set(xlim=ranges[pair[0]], ylim=ranges[pair[1]], xlabel=_label(pair[0]), ylabel=_label(pair[1]))

    title = f"Largest value over {pair[0]} and {pair[1]}"
    return picture(f"map-{number}", title, f"Map of the largest {name} over {pair[0]} and {pair[1]}.", 3.2, draw)


def _cells(
    points: tuple[FloatArray, FloatArray], values: FloatArray, ranges: Sequence[tuple[float, float]]
) -> tuple[list[FloatArray], FloatArray]:
    """Edges of the cells of two parameters, and the largest value in each; NaN where no member is."""
    count = min(CELLS, int(np.sqrt(len(values) / PER_CELL)))
    cells = np.full((count, count), np.nan)
    place = [
        np.clip((count * (x - low) / (high - low)).astype(int), 0, count - 1) for x, (low, high) in zip(points, ranges)
    ]
    np.fmax.at(cells, (place[1], place[0]), values)
    return [np.asarray(np.linspace(*limits, count + 1), dtype=float) for limits in ranges], cells
