"""Cells of a table, read back from its HTML, its Markdown and its LaTeX."""

from __future__ import annotations

import html.parser
import re
from typing import Any

from pointing_analysis.formatting.tables import TextTable


class Cells(html.parser.HTMLParser):
    """Cells of the body of a table in HTML."""

    def __init__(self) -> None:
        super().__init__()
        self.rows: list[list[str]] = []
        self.inside = False

    def handle_starttag(self, tag: str, attrs: Any) -> None:
        if tag == "tr":
            self.rows.append([])
        self.inside |= tag == "td"
        if tag == "td":
            self.rows[-1].append("")
        if tag == "br":
            self.rows[-1][-1] += "\n"

    def handle_endtag(self, tag: str) -> None:
        self.inside &= tag != "td"

    def handle_data(self, data: str) -> None:
        if self.inside:
            self.rows[-1][-1] += data


def of_html(table: TextTable) -> list[list[str]]:
    found = Cells()
    found.feed(table.html())
    return found.rows[1:]


def of_markdown(table: TextTable) -> list[list[str]]:
    lines = table.markdown().splitlines()[2:]
    cells = [re.split(r"(?<!\\)\|", line)[1:-1] for line in lines]
    return [[cell[1:-1].replace("\\|", "|").replace("<br>", "\n") for cell in row] for row in cells]


PLAIN = {r"\textbackslash{}": "\\", r"\textasciitilde{}": "~", r"\textasciicircum{}": "^", r"\textbar{}": "|"}
PLAIN |= {r"\textless{}": "<", r"\textgreater{}": ">", r"\newline ": "\n", r"$\pm$": "±", "$-$": "−", "-{}-": "@@"}
PLAIN |= {rf"\{c}": c for c in "%&#_${}"}


def of_latex(text: str) -> list[list[str]]:
    """Cells between the rules, read back by the rules of LaTeX: each special character is written as a command."""
    body = text[text.index("\\midrule\n") + 9 : text.index("\\bottomrule")]
    rows = [re.split(r"(?<!\\) & ", line.removesuffix(r" \\")) for line in body.splitlines()]
    command = re.compile("|".join(map(re.escape, sorted(PLAIN, key=len, reverse=True))))
    shown = [[command.sub(lambda m: PLAIN[m[0]], cell.removeprefix("{}[") and cell) for cell in row] for row in rows]
    return [[c.removeprefix("{}").replace("--", "–").replace("@@", "--") for c in row] for row in shown]
