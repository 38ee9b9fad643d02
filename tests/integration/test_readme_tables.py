"""Tables of README.md and docs/results.md: docs/fill_tables.py and the markers; make targets on the pages exist."""

from __future__ import annotations

import doctest
import importlib.util
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from los_design.figures import paper_numbers
from los_design.figures.paper_case import PaperCase

ROOT = Path(__file__).parents[2]
PAGES = ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "docs/extend/regenerate.md")


@pytest.fixture(scope="module")
def filler():
    spec = importlib.util.spec_from_file_location("fill_tables", ROOT / "docs" / "fill_tables.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_examples(filler) -> None:
    result = doctest.testmod(filler)
    assert result.attempted >= 3
    assert result.failed == 0


def test_pages_have_the_markers_once(filler) -> None:
    for name in filler.PAGES:
        page = filler.PAGES[name].read_text("utf-8")
        assert filler.filled(page, name, "TABLE").count("TABLE") == 1


def test_filling_is_idempotent(filler) -> None:
    page = filler.PAGES["stages"].read_text("utf-8")
    once = filler.filled(page, "stages", "| a |")
    assert filler.filled(once, "stages", "| a |") == once


def test_the_readme_shows_the_results_of_the_results_page(filler) -> None:
    """Both tables of worst cases come from one run of the stages."""
    results = (ROOT / "docs" / "results.md").read_text("utf-8")
    readme = (ROOT / "README.md").read_text("utf-8")
    assert filler.worst_case(results.split("<!-- stages:begin -->")[1].split("<!-- stages:end -->")[0]) in readme


def test_the_readme_is_short() -> None:
    """One table of results with four rows and three columns; before the quick start 200 words and 8 rows."""
    text = (ROOT / "README.md").read_text("utf-8")
    rows = text.split("<!-- worst_case:begin -->")[1].split("<!-- worst_case:end -->")[0].strip().splitlines()
    assert len(rows) == 2 + 4
    assert {row.count("|") for row in rows} == {5}
    before = text.split("## Quick start")[0].splitlines()
    assert len(" ".join(line for line in before if not line.startswith("|")).split()) < 200
    assert len([line for line in before if line.startswith("|")]) <= 2 + 8
    written = re.sub(r"<!-- (\w+):begin -->.*?<!-- \1:end -->", "", text, flags=re.DOTALL)  # without output and tables
    lines = [line for line in written.splitlines() if not line.startswith("|")]
    assert len(" ".join(lines).split()) < 950


def test_the_design_table_becomes_rows(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("<!-- gammas:begin -->\n<!-- gammas:end -->\n")
    rows = [
        {"design": "k-pma", "variant": "implemented", "gammas": {"APE": 0.5, "force": 0.25}, "status": "converged"},
        {"design": "k-pma", "variant": "published, robust", "gammas": [0.5768, 0.9835, 0.9835, 0.1185]},
    ]
    command = [sys.executable, str(ROOT / "docs" / "fill_tables.py"), "gammas", "--page", str(page)]
    subprocess.run(command, input=json.dumps(rows), text=True, check=True, timeout=60)
    lines = [line for line in page.read_text().splitlines() if line.startswith("|")]
    assert lines[0] == "| design, problem | APE | RPE | force | noise → APE |"
    assert lines[2] == "| K_PMA, as implemented, robust | 0.5000 |  | 0.2500 |  |"
    assert lines[3] == "| K_PMA, *the paper, robust* | 0.5768 | 0.9835 | 0.1185 | 0.9835 |"


def test_the_numbers_of_the_paper_s_problem_become_tables(filler) -> None:
    bands = [{"band": [1.0, 6.0], "nominal": 3.04, "family": [-0.1, 3.2], "peaks": 8.0, "peak_mas": [100.0, 39.9]}]
    gammas = [{"design": "k-fsm", "variant": "nominal, family", "gammas": {"APE": 0.5, "mirror": "inf"}, "status": ""}]
    text = json.dumps({"gammas": gammas, "decades": bands, "reduction": bands})
    assert "| K_FSM, nominal, over the family | 0.5000 | inf |" in filler.table_of("paper_gammas", text)
    assert filler.table_of("paper_decades", text).endswith("| nominal | 3.0 |\n| all members | -0.1 to 3.2 |")
    assert filler.table_of("paper_reduction", text).endswith("| largest value, FSM + PMA [mas] | 39.9 |")


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
    done = subprocess.run(command, input=text, text=True, capture_output=True, timeout=60)
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
