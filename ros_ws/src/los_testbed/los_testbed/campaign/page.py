"""HTML page of a campaign; its pictures are of fixed size, so the file is as large for any number of members."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from lftkit.arrays import FloatArray
from lftkit.support.atomic_output import write_text
from los_testbed.campaign.campaign_verdict import LOST
from los_testbed.campaign.dataset import Campaign, ResultFolder
from los_testbed.campaign.influence import MOST_BINS, PER_BIN, yield_curve
from los_testbed.campaign.meanings import TOTAL, meaning
from los_testbed.campaign.overview import quantile_heads
from pointing_analysis.report.figures import COLOURS, LIMIT, Picture, picture

TEMPLATE = Path(__file__).with_name("campaign.html.j2")
BINS, LEVELS = 40, 200
SHOWN, SMALL = 3, 0.005
"""Parameters with their own panel; share of the variance below which a pair is omitted."""

ERROR = "relative error [mas]"


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
    columns = campaign.parameters.columns
    table = folder.table([*columns, campaign.ranked, "status"])
    metric = table.column(campaign.ranked).to_numpy()
    lost = np.array([s in LOST for s in table.column("status").to_pylist()])
    metric = np.where(lost, np.inf, metric)
    points = {name: table.column(name).to_numpy() for name in columns}
    known = ~np.isnan(metric)
    pictures = _pictures(summary, {name: values[known] for name, values in points.items()}, metric[known])
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


def _pictures(summary: dict[str, Any], points: Mapping[str, FloatArray], metric: FloatArray) -> list[Picture]:
    finite = metric[np.isfinite(metric)]
    if not finite.size:
        return []
    name = meaning(summary["ranked_by"])
    of_requirements = sorted({v["limit"] for v in summary["verdicts"] if summary["ranked_by"] in (v["column"], TOTAL)})
    limits = [limit for limit in of_requirements if limit <= of_requirements[0] or limit < 1.5 * finite.max()]
    made = [_distribution(name, finite, limits), _yield(name, metric, limits)]
    if any(entry["first_order"] is not None for entry in summary["influence"]):
        strongest = sorted(summary["influence"], key=lambda entry: -(entry["first_order"] or 0.0))[:SHOWN]
        made.append(_effects(summary))
        made.append(_main_effects(name, [entry["parameter"] for entry in strongest], points, metric))
    return made


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

    alt = f"Histogram over the members: {name}; dashed: limits."
    return picture("distribution", "Distribution of the relative error", alt, 2.8, draw)


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

    return picture("yield", "Yield", f"Share of the members below each level: {name}; dashed: limits.", 2.8, draw)


def _label(parameter: str) -> str:
    return parameter if parameter == "tau" else f"{parameter} [rad/s]"


def _effects(summary: dict[str, Any]) -> Picture:
    """Shares of the variance that are more than chance, of parameters and pairs, the largest first, and the rest."""
    mains = [(_words(i["parameter"]), i["first_order"], COLOURS[0]) for i in summary["influence"] if i["known"]]
    pairs = [
        (" with ".join(map(_words, e["parameters"])), e["share"], COLOURS[1])
        for e in summary["pairs"]
        if e["known"] and e["share"] >= SMALL
    ]
    rows = sorted(mains + pairs, key=lambda row: -row[1])
    rest = max(1.0 - sum(share for _, share, _ in rows), 0.0)
    rows.append(("not distinguishable from chance", rest, "#999999"))

    def draw(figure: Figure) -> None:
        axis = figure.subplots()
        y = np.arange(len(rows))
        shares = [100.0 * share for _, share, _ in rows]
        axis.barh(y, shares, color=[colour for *_, colour in rows])
        for k, share in enumerate(shares):
            axis.annotate(f"{share:.1f} %", (share, k), xytext=(3, 0), textcoords="offset points", va="center")
        axis.set_yticks(y, [name for name, *_ in rows])
        axis.invert_yaxis()
        axis.set_xlim(0.0, 115.0 * max(share for _, share, _ in rows))
        axis.set_xlabel("share of the variance [%]")

    alt = "Shares of the variance: " + ", ".join(f"{name} {100 * share:.1f} %" for name, share, _ in rows)
    return picture("effects", "Influence of the parameters on the relative error", alt, 1.2 + 0.24 * len(rows), draw)


def _words(parameter: str) -> str:
    return parameter.replace("_", " ")


def _main_effects(
    name: str, parameters: Sequence[str], points: Mapping[str, FloatArray], metric: FloatArray
) -> Picture:
    """Median and the middle 80 % of the members over each parameter, in equally filled bins."""
    finite = np.isfinite(metric)
    bins = min(MOST_BINS, int(np.count_nonzero(finite)) // PER_BIN)

    def draw(figure: Figure) -> None:
        axes = figure.subplots(1, len(parameters), sharey=True, squeeze=False)[0]
        for axis, parameter in zip(axes, parameters):
            x, y = points[parameter][finite], metric[finite]
            groups = np.array_split(np.argsort(x, kind="stable"), bins)
            centre = [float(x[group].mean()) for group in groups]
            low, middle, high = np.array([np.quantile(y[group], (0.1, 0.5, 0.9)) for group in groups]).T
            axis.fill_between(
                centre, low, high, color=COLOURS[0], alpha=0.25, linewidth=0.0, label="80 % of the members"
            )
            axis.plot(centre, middle, color=COLOURS[0], label="median")
            axis.locator_params(axis="x", nbins=2)
            axis.tick_params(axis="x", labelsize="x-small")
            axis.set_xlabel(_label(parameter).replace(" [", "\n["))
        axes[0].set_ylabel(ERROR)
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper left", ncols=2)

    alt = f"Median and middle 80 % of the members over {', '.join(parameters)}: {name}."
    return picture("main-effects", "Main effects of the most influential parameters", alt, 2.8, draw)
