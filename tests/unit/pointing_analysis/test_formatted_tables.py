"""Tables as text: the same cells in every form, and no text of a cell is markup in any of them."""

from __future__ import annotations

import csv
import io
import json
import re

import pytest
from support.table_forms import of_html, of_latex, of_markdown

from pointing_analysis.formatting.latex import latex_table
from pointing_analysis.formatting.tables import Heading, Marked, TextTable, numbers, texts

AWKWARD = "50 % of a_b & <c> #1 ~ ^ \\ {x} $y$ -- 'z'"
TABLE = TextTable.of(
    (*texts("requirement", "verdict"), *numbers("value", "RPE rms [mas]")),
    [
        ("|APE|, 99.7 %", Marked("compliant", "ok"), "1.54 arcsec", "17"),
        (AWKWARD, Marked("not compliant", "bad"), "−3 mas", "1 ± 2"),
        ("[two]\nlines", "within limit; not yet demonstrated at 95 % confidence: needs 97 s", "–", ""),
    ],
    "Requirements of a_b\n50 %",
    name="requirements",
)


def test_all_forms_have_the_same_cells() -> None:
    wanted = [list(map(str, row)) for row in TABLE.rows]
    assert [list(row) for row in csv.reader(io.StringIO(TABLE.csv()))] == [list(TABLE.heads), *wanted]
    assert of_html(TABLE) == wanted
    assert of_markdown(TABLE) == wanted
    assert of_latex(latex_table(TABLE)) == wanted
    assert [list(row.values()) for row in json.loads(json.dumps(TABLE.as_dicts()))] == wanted


@pytest.mark.parametrize("character", list('\\{}&%$#_~^<>|"[]*-\n\x00\x1b'))
def test_no_character_of_a_cell_is_a_command_of_latex(character: str) -> None:
    """Every one at the start of a row, in the middle and doubled; braces stay balanced, cells stay two."""
    cell = f"{character}a{character}{character}b"
    line = latex_table(TextTable.of(("x", "y"), [(cell, "z")])).split("\\midrule\n")[1].splitlines()[0]
    assert line.endswith(r" & z \\")
    bare = re.sub(r"\\[a-zA-Z]+|\\.", "", line.removesuffix(r" & z \\"))
    assert not set("&%#_~^<>|\x00\x1b") & set(bare) and "--" not in bare
    assert bare.count("{") == bare.count("}") and bare.count("$") % 2 == 0
    assert line[0] not in "[*", "behind the end of a line they would be its options"


def test_a_table_of_latex_is_as_wide_as_a_page_at_most() -> None:
    """Parts of the width of columns that wrap, with the letters of the others."""
    long = "a requirement with a long name, and what it asks for"
    wide = TextTable.of((*texts("one", "two"), *numbers(*"abcdef")), [(long, long, *["123 of 4567"] * 6)])
    tables = (TABLE, wide, TextTable.of(("name", "value"), [("short", "1")]))
    for table in tables:
        text = latex_table(table)
        parts = [float(x) for x in re.findall(r"p\{([\d.]+)\\linewidth\}", text)]
        assert sum(parts) <= 1.0 and text.count(r"\begin{tabular}") == text.count(r"\end{tabular}") == 1
        bare = re.sub(r"\\\\|\\.", "", text)
        assert bare.count("{") == bare.count("}")
        assert (r"\footnotesize" in text) == (table is not tables[-1])
    assert text.count("p{") == 0 and r"\begin{tabular}{ll}" in text


def test_html_has_no_markup_of_a_cell() -> None:
    found = TextTable.of((Heading("<b>"),), [("<script>&\"'",)], "<i>", classes=('"x',)).html(caption=True)
    assert "<script" not in found and "<b>" not in found and "<i>" not in found and 'class=""' not in found
    assert of_html(TextTable.of(("a",), [("<script>&\"'",)])) == [["<script>&\"'"]]
