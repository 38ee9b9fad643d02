"""Write a table of README.md between its markers, from the output of a command.

    los-testbed design table --json | python docs/fill_tables.py gammas
    python docs/fill_tables.py stages < FOLDER/stages.md         # FOLDER of los-testbed stages
    python docs/fill_tables.py prediction < FOLDER/stages.md

The page contains ``<!-- NAME:begin -->`` and ``<!-- NAME:end -->``; the text between them is replaced. ``stages`` are
the results of each scenario, ``prediction`` the transmissibility in one of them, measured and modelled.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

PAGE = Path(__file__).parents[1] / "README.md"
COLUMNS = ("APE", "RPE", "mirror", "force", "noise -> APE", "noise -> RPE")
PUBLISHED = {"k-fsm": ("APE", "RPE", "mirror"), "k-pma": ("APE", "RPE", "noise -> APE", "force")}
DESIGNS = {"k-fsm": "K_FSM", "k-pma": "K_PMA"}
PROBLEMS = {
    "implemented": "as implemented, robust",
    "implemented_nominal": "as implemented, nominal",
    "paper": "paper's problem, robust",
    "paper_nominal": "paper's problem, nominal",
    "published, robust": "*the paper, robust*",
    "published, nominal": "*the paper, nominal*",
}


def markdown(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Table of Markdown; every column but the first aligned to the right."""
    lines = [head, ["---", *["---:"] * (len(head) - 1)], *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


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


def parts(text: str, heading: str) -> list[str]:
    """Paragraphs of stages.md that begin with `heading`, each with the table that follows it.

    Examples
    --------
    >>> parts("**Scenario `design`** (10 s)\\n\\n| a |\\n|---|\\n\\nTransmissibility:\\n\\n| b |", "Transmissibility")
    ['Transmissibility:\\n\\n| b |']
    """
    blocks = [block.strip() for block in text.split("\n\n")]
    return [f"{block}\n\n{blocks[i + 1]}" for i, block in enumerate(blocks[:-1]) if block.startswith(heading)]


def table_of(name: str, text: str) -> str:
    """Text for the markers `name`.

    Raises
    ------
    ValueError
        Unknown name, or a text without such a table.
    """
    if name == "gammas":
        return gammas(json.loads(text))
    chosen = {"stages": "**Scenario", "prediction": "Transmissibility"}
    if name not in chosen:
        raise ValueError(f"name must be gammas, {' or '.join(chosen)}, got {name!r}")
    found = parts(text, chosen[name])
    if not found:
        raise ValueError(f"input must be stages.md with a paragraph that begins with {chosen[name]!r}, got none")
    return "\n\n".join(found if name == "stages" else found[:1])


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
    parser.add_argument("name", help="gammas, stages or prediction")
    parser.add_argument("--page", type=Path, default=PAGE)
    given = parser.parse_args()
    try:
        table = table_of(given.name, sys.stdin.read())
        given.page.write_text(filled(given.page.read_text("utf-8"), given.name, table), "utf-8")
    except (OSError, KeyError, ValueError) as error:
        sys.stderr.write(f"fill_tables: {error}\n")
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
