"""Every Python block of the documentation runs, every TOML block is read."""

from __future__ import annotations

import contextlib
import io
import re
import runpy
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import create_autospec

import pytest
from support.documented_commands import PAGES, ROOT, blocks
from support.uncertain_examples import two_mass_benchmark

from pointing_analysis.files.structured_text import load_toml

pytestmark = pytest.mark.usefixtures("without_pictures")
TEXTS = {path: path.read_text("utf-8") for path in (*PAGES, ROOT / "CONTRIBUTING.md")}
WITH_TESTS_OF_THEIR_OWN = {"tutorial.md", "linear_systems.md", "norms.md", "quick_start.md", "examples.md"}
WITH_TESTS_OF_THEIR_OWN |= {path.name for path in (ROOT / "docs/extend").glob("*.md")}
"""Run by test_tutorials.py, which compares the output as well, and by test_contributing_pages.py."""
Names = dict[str, Any]


def a_bag(folder: Path, _: pytest.MonkeyPatch) -> Names:
    (folder / "bags").mkdir()
    for name in ("reference", "my_run"):
        (folder / "bags" / name).symlink_to(ROOT / "bags" / "reference")
    return {}


def rows_of_a_campaign(folder: Path, _: pytest.MonkeyPatch) -> Names:
    arrow = pytest.importorskip("pyarrow")
    pytest.importorskip("pandas")
    from pyarrow import parquet

    (folder / "bags/first/rows").mkdir(parents=True)
    parquet.write_table(arrow.table({"index": [0, 1]}), folder / "bags/first/rows/0.parquet")
    return {}


def tables_and_clusters(_: Path, __: pytest.MonkeyPatch) -> Names:
    for name in ("pandas", "xarray", "pyarrow", "distributed"):
        pytest.importorskip(name)
    return {}


def an_uncertain_system(_: Path, __: pytest.MonkeyPatch) -> Names:
    return {"system": two_mass_benchmark(masses=False)}


def a_design_that_is_only_called(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Names:
    """The design takes an hour: its call is checked against the signature, its result is empty."""
    from los_design import redesign

    (folder / "soft.toml").write_text("base = 'reference'\n[pma]\nstiffness = 90.0\n")
    check = SimpleNamespace(gammas={})
    summary = redesign.DesignSummary(folder, check, [])
    monkeypatch.setattr(redesign, "design_all", create_autospec(redesign.design_all, return_value=summary))
    return {}


def the_mass_and_spring(_: Path, __: pytest.MonkeyPatch) -> Names:
    names = runpy.run_path(str(ROOT / "examples/robust_mass_spring_damper.py"))
    from lftkit.tuning import pid, tune_robust

    return {**names, "pid": pid, "tune_robust": tune_robust}


def files_of_nastran(folder: Path, _: pytest.MonkeyPatch) -> Names:
    pytest.importorskip("pyNastran", reason="extra nastran")
    from titop_plant.telescope.bodies import payload_frame
    from titop_plant.telescope.load import load_telescope

    example = runpy.run_path(str(ROOT / "examples/nastran_payload_to_run.py"))
    frame = payload_frame(load_telescope()).divided()
    example["write_bulk_data"](frame, folder / "payload.bdf")
    example["write_results"](frame, folder / "payload.op2")
    return {}


NEEDED: dict[str, Callable[[Path, pytest.MonkeyPatch], Names]] = {
    "your_data.md": a_bag,
    "pointing_analysis.md": a_bag,
    "campaigns.md": rows_of_a_campaign,
    "certificates.md": an_uncertain_system,
    "reference.md": tables_and_clusters,
    "your_controller.md": a_design_that_is_only_called,
    "tuning.md": the_mass_and_spring,
    "structures.md": files_of_nastran,
}
"""What the text of a page presupposes."""
SLOW = {"certificates.md", "tuning.md"}
EVERY_LINE_SHOWN = {"from_matlab.md"}
"""What each line prints is the comment behind it."""
WITH_PYTHON = [p for p, text in TEXTS.items() if blocks(text, "python") and p.name not in WITH_TESTS_OF_THEIR_OWN]


@pytest.mark.parametrize(
    "path", [pytest.param(p, id=p.name, marks=[pytest.mark.slow] * (p.name in SLOW)) for p in WITH_PYTHON]
)
def test_python_blocks_run(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In order, in one session; the output is the one shown, where the page shows one."""
    monkeypatch.chdir(tmp_path)
    names = NEEDED[path.name](tmp_path, monkeypatch) if path.name in NEEDED else {}
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        for block in blocks(TEXTS[path], "python"):
            exec(compile(block, path.name, "exec"), names)
    if path.name in EVERY_LINE_SHOWN:
        expected = re.findall(r"^ *print\(.*\)  # (.*)$", "\n".join(blocks(TEXTS[path], "python")), flags=re.MULTILINE)
        assert printed.getvalue().splitlines() == expected
    for shown in re.findall(r"print\(.*\)\s+# (.*\d.*)$", "\n".join(blocks(TEXTS[path], "python")), flags=re.MULTILINE):
        if path.name == "your_data.md":
            assert shown in printed.getvalue()


@pytest.mark.parametrize("path", [p for p, text in TEXTS.items() if blocks(text, "toml")], ids=lambda p: p.name)
def test_toml_blocks_are_read(path: Path) -> None:
    assert all(load_toml(block, path) for block in blocks(TEXTS[path], "toml"))
