"""Tables of README.md and docs/results.md: docs/fill_tables.py and the markers; make targets on the pages exist."""

from __future__ import annotations

import doctest
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
from support.scripts import script

from los_design.figures import paper_numbers
from los_design.figures.paper_case import PaperCase

ROOT = Path(__file__).parents[2]
PAGES = ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "docs/extend/regenerate.md")


@pytest.fixture(scope="module")
def filler():
    return script(ROOT / "docs" / "fill_tables.py")


def test_examples(filler) -> None:
    result = doctest.testmod(filler)
    assert result.attempted >= 3
    assert result.failed == 0


def test_pages_have_the_markers_once(filler) -> None:
    for name in filler.PAGES:
        page = filler.PAGES[name].read_text("utf-8")
        assert filler.filled(page, name, "TABLE").count("TABLE") == 1


def test_the_readme_shows_the_results_of_the_results_page(filler) -> None:
    """Both tables of worst cases come from one run of the stages."""
    results = (ROOT / "docs" / "results.md").read_text("utf-8")
    readme = (ROOT / "README.md").read_text("utf-8")
    assert filler.worst_case(results.split("<!-- stages:begin -->")[1].split("<!-- stages:end -->")[0]) in readme


def test_the_page_of_the_paper_has_the_numbers_of_the_files_beside_it(filler) -> None:
    """After a change of the telescope or of a design `make paper` has been run."""
    text = (ROOT / "docs/figures/paper/results.json").read_text("utf-8")
    of, page = (
        paper_numbers.names(PaperCase.of(ROOT / "examples/paper")),
        filler.PAGES["paper_gammas"].read_text("utf-8"),
    )
    assert of.items() <= json.loads(text).items()
    for name in ("paper_gammas", "paper_decades", "paper_reduction"):
        assert filler.filled(page, name, filler.table_of(name, text)) == page


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("gammas", ""),
        ("stages", "nothing"),
        ("other", "| a |"),
        ("run", ""),
        ("worst_case", ""),
        ("paper_gammas", "{}"),
    ],
)
def test_errors_do_not_change_the_page(tmp_path: Path, name: str, text: str) -> None:
    page = tmp_path / "page.md"
    page.write_text("<!-- gammas:begin -->\n<!-- gammas:end -->\n")
    command = [sys.executable, str(ROOT / "docs" / "fill_tables.py"), name, "--page", str(page)]
    done = subprocess.run(command, input=text, text=True, capture_output=True, timeout=600)
    assert done.returncode == 2
    assert len(done.stderr.strip().splitlines()) == 1
    assert page.read_text() == "<!-- gammas:begin -->\n<!-- gammas:end -->\n"


def test_targets_of_make_exist() -> None:
    text = (ROOT / "Makefile").read_text("utf-8")
    targets = set(re.findall(r"^([a-z-]+):", text, flags=re.MULTILINE))
    for name in PAGES:
        named = set(
            re.findall(
                r"`?make ([a-z-]+)\b",
                "\n".join(re.findall(r"`[^`]+`|^make .*$", (ROOT / name).read_text("utf-8"), flags=re.MULTILINE)),
            )
        )
        assert named <= targets, name
