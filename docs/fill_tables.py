"""Write a table of docs/results.md, docs/paper.md or README.md between its markers, from the output of a command.

    los-testbed design table --json | python docs/fill_tables.py gammas
    python docs/fill_tables.py stages < FOLDER/stages.md         # FOLDER of los-testbed stages
    python docs/fill_tables.py worst_case < FOLDER/stages.md
    python docs/fill_tables.py bounds < FOLDER/bounds.json       # FOLDER of los-testbed design certify
    python docs/fill_tables.py proven < FOLDER/bounds.json
    python docs/fill_tables.py paper_gammas < docs/figures/paper/results.json      # of examples/paper/all.py
    COLUMNS=100 los-testbed run --mode inprocess --output FOLDER | python docs/fill_tables.py run

The page contains ``<!-- NAME:begin -->`` and ``<!-- NAME:end -->``; the text between them is replaced. ``stages`` are
the results of the scenario of worst cases on docs/results.md, as are ``gammas``, ``proven``, one row a stage, and
``run``, the output of a command. README.md has
``worst_case``, one row a stage; docs/certificates.md has ``bounds``; docs/paper.md has ``paper_gammas``,
``paper_decades`` and ``paper_reduction``.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from pointing_analysis.formatting.tables import TextTable, numbers

DOCS = Path(__file__).parent
PAGES = dict.fromkeys(("gammas", "stages", "proven", "run"), DOCS / "results.md")
PAGES["worst_case"] = DOCS.parent / "README.md"
PAGES["bounds"] = DOCS / "certificates.md"
PAGES |= dict.fromkeys(("paper_gammas", "paper_decades", "paper_reduction", "paper_orders"), DOCS / "paper.md")
FIGURES = {"APE": "APE", "slow": "RPE, slow tone", "fast": "RPE, fast tone", "mirror": "mirror", "force": "force"}
"""Figures of ``design certify``."""
WORST_CASE = "**Scenario `worst_case`"
"""Begin of the paragraph of stages.md that the tables are made from."""
TONES = ("APE", "RPE, slow", "RPE, fast")
"""Rows of a stage in the table of worst cases."""
COLUMNS = ("APE", "RPE", "mirror", "force", "noise -> APE", "noise -> RPE")
PUBLISHED = {"k-fsm": ("APE", "RPE", "mirror"), "k-pma": ("APE", "RPE", "noise -> APE", "force")}
DESIGNS = {"k-fsm": "K_FSM", "k-pma": "K_PMA"}
PROBLEMS = {
    "implemented": "as implemented, robust",
    "implemented_nominal": "as implemented, nominal",
    "robust": "robust, with the other",
    "robust, alone": "robust, alone",
    "nominal": "nominal",
    "published, robust": "*the paper, robust*",
    "published, nominal": "*the paper, nominal*",
    "nominal, family": "nominal, over the family",
}


def markdown(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Table of Markdown; every column but the first aligned to the right."""
    return TextTable.of((head[0], *numbers(*head[1:])), rows).markdown()


def gammas(rows: Sequence[Mapping[str, Any]]) -> str:
    """Gammas of the stored designs and the published ones, one row per design and problem.

    Examples
    --------
    >>> print(gammas([{"design": "k-fsm", "variant": "published, robust", "gammas": [0.9857, 1.0026, 0.9877]}]))
    | design, problem | APE | RPE | mirror |
    | --- | ---: | ---: | ---: |
    | K_FSM, *the paper, robust* | 0.9857 | 1.0026 | 0.9877 |
    """
    found = []
    for row in rows:
        values = row["gammas"]
        if not isinstance(values, Mapping):
            values = dict(zip(PUBLISHED[row["design"]], values))
        name = f"{DESIGNS[row['design']]}, {PROBLEMS.get(row['variant'], row['variant'])}"
        found.append((name, {key: float(value) for key, value in values.items()}))
    others = [key for _, values in found for key in values if key not in COLUMNS]
    columns = [c for c in (*COLUMNS, *dict.fromkeys(others)) if any(c in values for _, values in found)]
    return markdown(
        ["design, problem", *(c.replace("->", "→") for c in columns)],
        [[name, *(f"{values[c]:.4f}" if c in values else "" for c in columns)] for name, values in found],
    )


def by_band(rows: Sequence[Mapping[str, Any]], lines: Sequence[tuple[str, Callable[[Mapping[str, Any]], str]]]) -> str:
    """A column for each band of frequency, a line for each value.

    Examples
    --------
    >>> print(by_band([{"band": [1.0, 6.0], "nominal": 3.04}], DECADES[:1]))
    | rad/s | 1 to 6 |
    | --- | ---: |
    | nominal | 3.0 |
    """
    head = ["rad/s", *(f"{row['band'][0]:g} to {row['band'][1]:g}" for row in rows)]
    return markdown(head, [[name, *(cell(row) for row in rows)] for name, cell in lines])


DECADES: tuple[tuple[str, Callable[[Mapping[str, Any]], str]], ...] = (
    ("nominal", lambda row: f"{row['nominal']:.1f}"),
    ("all members", lambda row: f"{row['family'][0]:.1f} to {row['family'][1]:.1f}"),
)
"""Lines of the distance between wheels and drives."""

REDUCTION = (
    ("largest value of all members [dB]", lambda row: f"{row['peaks']:.1f}"),
    ("largest value, FSM [mas]", lambda row: f"{row['peak_mas'][0]:.3g}"),
    ("largest value, FSM + PMA [mas]", lambda row: f"{row['peak_mas'][1]:.3g}"),
)
"""Lines of what the proof masses take from the mirror's curve."""


def orders(rows: Sequence[Mapping[str, Any]]) -> str:
    """Gammas of both controllers of each order; one that is not converged has its status.

    Examples
    --------
    >>> gammas = {"APE": 0.7, "RPE": 0.69, "mirror": 0.999, "noise -> APE": 0.6, "force": 0.2}
    >>> design, other = ({"gammas": gammas, "status": status} for status in ("converged", "stalled"))
    >>> print(orders([{"order": 2, "k-fsm": design, "k-pma": other}]).splitlines()[-1])
    | 2 | 0.7000 | 0.6900 | 0.7000, `stalled` | 0.6900 | 0.6000 | 0.2000 |
    """
    columns = {"k-fsm": ("APE", "RPE"), "k-pma": ("APE", "RPE", "noise -> APE", "force")}
    head, lines = ["order"], [[str(row["order"])] for row in rows]
    for kind, names in columns.items():
        head += [f"{DESIGNS[kind]}: {name.replace('->', '→')}" for name in names]
        for line, row in zip(lines, rows):
            first, *others = [f"{row[kind]['gammas'][name]:.4f}" for name in names]
            status = row[kind]["status"]
            line += [first if status == "converged" else f"{first}, `{status}`", *others]
    return markdown(head, lines)


def with_status(row: Mapping[str, Any]) -> dict[str, Any]:
    """A row of gammas that says how its design ended, if it has a status.

    Examples
    --------
    >>> with_status({"variant": "robust", "status": "converged"})["variant"]
    'robust, with the other, `converged`'
    >>> with_status({"variant": "nominal, family", "status": ""})["variant"]
    'nominal, over the family'
    """
    name = PROBLEMS.get(row["variant"], row["variant"])
    return {**row, "variant": f"{name}, `{row['status']}`" if row["status"] else name}


def parts(text: str, heading: str) -> list[str]:
    """Paragraphs of stages.md that begin with `heading`, each with the table that follows it.

    Examples
    --------
    >>> parts("**Scenario `design`** (10 s)\\n\\n| a |\\n|---|\\n\\nTransmissibility:\\n\\n| b |", "Transmissibility")
    ['Transmissibility:\\n\\n| b |']
    """
    blocks = [block.strip() for block in text.split("\n\n")]
    return [f"{block}\n\n{blocks[i + 1]}" for i, block in enumerate(blocks[:-1]) if block.startswith(heading)]


def worst_case(text: str) -> str:
    """One row a stage of the scenario of worst cases: error by tone and noise, and the limits it meets.

    Examples
    --------
    >>> head = "| stage | worst tone | with noise, all draws | limits |\\n|---|---|---:|---:|\\n"
    >>> rows = [f"| fsm | {tone} | 9 mas | meets 10 |" for tone in TONES]
    >>> print(worst_case("**Scenario `worst_case`**\\n\\n" + head + "\\n".join(rows)))
    | stage | APE | RPE, slow tone | RPE, fast tone |
    | --- | ---: | ---: | ---: |
    | fsm | 9 mas, meets 10 | 9 mas, meets 10 | 9 mas, meets 10 |
    """
    lines = [
        [cell.strip() for cell in line.split("|")[1:-1]]
        for line in parts(text, WORST_CASE)[0].splitlines()
        if line.startswith("|")
    ]
    head, rows = lines[0], [dict(zip(lines[0], line)) for line in lines[2:]]
    found: dict[str, list[str]] = {}
    for row in rows:
        found.setdefault(row[head[0]], []).append(f"{row['with noise, all draws']}, {row['limits']}")
    return markdown(
        ["stage", *(tone.replace("slow", "slow tone").replace("fast", "fast tone") for tone in TONES)],
        [[stage, *cells] for stage, cells in found.items()],
    )


def between(figure: Mapping[str, Any]) -> str:
    """Lower and upper bound; a dash where no upper one is proven.

    Examples
    --------
    >>> between({"lower": 0.9506, "upper": 1.0}), between({"lower": 0.2, "upper": None})
    ('0.951–1', '0.200–?')
    """
    upper = figure["upper"]
    return f"{figure['lower']:.3f}–{'?' if upper is None else rounded_up(upper)}"


def rounded_up(bound: float) -> str:
    """An upper bound with four decimals, not below it.

    Examples
    --------
    >>> rounded_up(0.99571), rounded_up(1.0)
    ('0.9958', '1')
    """
    return f"{math.ceil(1e4 * bound) / 1e4:.5g}"


def place(figure: str) -> tuple[int, str]:
    """Where a figure stands in a table: margins and noise after the others."""
    return (list(FIGURES).index(figure) if figure in FIGURES else len(FIGURES)), figure


def bounds(figures: Sequence[Mapping[str, Any]]) -> str:
    """One row a figure: bounds, frequency of the lower one, cost of the proof.

    Examples
    --------
    >>> print(bounds([{"stage": "fsm", "figure": "slow", "lower": 0.19, "upper": 1.0, "frequency": 2.84,
    ...                "seconds": 110.9}]))
    | stage, figure | lower | at, rad/s | upper, proven | proof, CPU s |
    | --- | ---: | ---: | ---: | ---: |
    | fsm, RPE, slow tone | 0.190 | 2.840 | 1 | 111 |
    """
    head = ("stage, figure", "lower", "at, rad/s", "upper, proven", "proof, CPU s")
    rows = []
    for f in sorted(figures, key=lambda f: (f["stage"], *place(f["figure"]))):
        lower, upper = f"{f['lower']:.3g}" if f["lower"] < 0.1 else f"{f['lower']:.3f}", f["upper"]
        at = f"{f['frequency']:#.4g}".rstrip(".")
        name = f"{f['stage']}, {FIGURES.get(f['figure'], f['figure'])}"
        rows.append((name, lower, at, "" if upper is None else rounded_up(upper), f"{f['seconds']:.0f}"))
    return markdown(head, rows)


def proven(figures: Sequence[Mapping[str, Any]]) -> str:
    """One row a stage: whether all members are stable, lower and upper bound of each figure.

    Examples
    --------
    >>> print(proven([{"stage": "fsm", "figure": "APE", "lower": 0.95, "upper": 1.0, "stable": True}]))
    |stage|stable|APE|
    |---|---|---|
    |fsm|all|0.950–1|
    """
    shown = [name for name in FIGURES if any(f["figure"] == name for f in figures)]
    rows = []
    for stage in sorted({f["stage"] for f in figures}):
        own = {f["figure"]: f for f in figures if f["stage"] == stage}
        stable = "all" if any(f["stable"] for f in own.values()) else "?"
        rows.append([stage, stable, *(between(own[name]) if name in own else "" for name in shown)])
    head = ["stage", "stable", *(FIGURES[name] for name in shown)]
    return "\n".join(f"|{'|'.join(row)}|" for row in (head, ["---"] * len(head), *rows))


def screen(text: str) -> str:
    """Output of a command as a block of code; the paths of its bag and report are those of the example.

    Examples
    --------
    >>> print(screen("a table\\nbag     /tmp/x\\nreport  /tmp/x/report.html\\n"))
    ```text
    a table
    bag     bags/20261120-120000-inprocess-fsm+pma
    report  bags/20261120-120000-inprocess-fsm+pma/report.html
    ```
    """
    lines = [line.rstrip() for line in text.strip("\n").splitlines()]
    bag = "bags/20261120-120000-inprocess-fsm+pma"
    shown = {"bag  ": f"bag     {bag}", "report  ": f"report  {bag}/report.html"}
    lines = [next((shown[start] for start in shown if line.startswith(start)), line) for line in lines]
    return "\n".join(["```text", *lines, "```"])


def table_of(name: str, text: str) -> str:
    """Text for the markers `name`.

    Raises
    ------
    ValueError
        Unknown name, or a text without such a table.
    """
    if name == "gammas":
        return gammas(json.loads(text))
    if name.startswith("paper_"):
        rows = json.loads(text)[name.removeprefix("paper_")]
        lines = {"paper_decades": DECADES, "paper_reduction": REDUCTION}
        if name == "paper_orders":
            return orders(rows)
        return by_band(rows, lines[name]) if name in lines else gammas([with_status(row) for row in rows])
    if name in ("bounds", "proven"):
        return {"bounds": bounds, "proven": proven}[name](json.loads(text)["figures"])
    if name == "run" and "verdict" in text:
        return screen(text)
    if name == "worst_case" and parts(text, WORST_CASE):
        return worst_case(text)
    if name != "stages":
        raise ValueError(f"name must be one of {', '.join(PAGES)} with an input of its kind, got {name!r}")
    found = parts(text, WORST_CASE)
    if not found:
        raise ValueError(f"input must be stages.md with a paragraph that begins with {WORST_CASE!r}, got none")
    return found[0]


def filled(page: str, name: str, table: str) -> str:
    """The page with the table between its markers.

    Raises
    ------
    ValueError
        The page has no such markers.

    Examples
    --------
    >>> filled("a <!-- t:begin -->old<!-- t:end --> b", "t", "new")
    'a <!-- t:begin -->\\n\\nnew\\n\\n<!-- t:end --> b'
    """
    begin, end = f"<!-- {name}:begin -->", f"<!-- {name}:end -->"
    if page.count(begin) != 1 or page.count(end) != 1:
        counts = page.count(begin), page.count(end)
        raise ValueError(f"page must have {begin} and {end} once each, got {counts[0]} and {counts[1]}")
    before, rest = page.split(begin)
    return f"{before}{begin}\n\n{table}\n\n{end}{rest.split(end)[1]}"


def main() -> int:
    """Read JSON from the standard input, write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("name", help=", ".join(PAGES))
    parser.add_argument("--page", type=Path, help="page with the markers (default: the one that has them)")
    given = parser.parse_args()
    try:
        table = table_of(given.name, sys.stdin.read())
        page = given.page or PAGES[given.name]
        page.write_text(filled(page.read_text("utf-8"), given.name, table), "utf-8")
    except (OSError, KeyError, ValueError) as error:
        sys.stderr.write(f"fill_tables: {error}\n")
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
