"""Pages in light and dark, on a telephone and on a desk: no finding of axe-core, runs hidden, pictures enlarged."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support import axe, headless_browser

from pointing_analysis.budget.file import load_budget
from pointing_analysis.budget.total import evaluate
from pointing_analysis.indices.synthetic import write_bag
from pointing_analysis.read.run import Run
from pointing_analysis.report.pointing_budget_page import render_budget
from pointing_analysis.report.report import write_report

ROOT = Path(__file__).parents[3]
MAS = np.pi / 648_000_000
SCHEMES = ("light", "dark")
pytestmark = pytest.mark.skipif(headless_browser.browser() is None, reason="no chromium on this machine")


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("runs")
    t = 1e-3 * np.arange(3000)
    for name, scale in (("isolator", 300.0), ("fsm", 10.0)):
        truth = scale * MAS * np.column_stack([np.sin(88 * t), np.cos(88 * t)])
        parameters = {"loop": name, "scenario": "design", "seed": 1, "tones_rad_s": [88.0]}
        write_bag(folder / name, {"truth/los": truth}, parameters=parameters)
    return write_report([Run.open(folder / name) for name in ("isolator", "fsm")], folder / "report.html")


@pytest.fixture(scope="module")
def chromium():
    with headless_browser.Page() as found:
        yield found


@pytest.fixture(params=SCHEMES)
def scheme(request, chromium):
    chromium.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": request.param}])
    yield request.param
    chromium.call("Emulation.setEmulatedMedia", features=[])


@pytest.fixture(scope="module")
def budget_page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    page = tmp_path_factory.mktemp("budget") / "budget.html"
    text = 'unit = "mas"\n[[requirement]]\nname = "APE"\ntext = "prob(|APE| < 9 arcsec) >= 0.9 at 95 % confidence"\n'
    sources = "".join(f'[sources.s{i}]\ntype = "random"\nsigma = {i + 1}\n' for i in range(20))
    page.with_suffix(".toml").write_text(text + sources)
    budget = load_budget(page.with_suffix(".toml"))
    page.write_text(render_budget(budget, list(evaluate(budget))))
    return page


@pytest.mark.parametrize(
    ("kind", "scheme", "width"),
    [("page", "light", 390), ("page", "dark", 1280), ("budget_page", "dark", 390), ("budget_page", "light", 1280)],
)
def test_axe_finds_nothing(chromium, kind: str, scheme: str, width: int, request: pytest.FixtureRequest) -> None:
    pytest.importorskip("axe_core_python")
    assert axe.findings(chromium, request.getfixturevalue(kind), width, scheme) == []


def test_the_dark_scheme_is_dark(chromium, page: Path, scheme: str) -> None:
    chromium.open(page, 1280)
    colour = chromium.value("getComputedStyle(document.body).backgroundColor.match(/\\d+/g).map(Number)")
    assert (sum(colour) < 150) == (scheme == "dark")


@pytest.mark.further
def test_a_run_can_be_hidden_and_shown_again(chromium, page: Path) -> None:
    """Its card, its rows and its curves; the other run stays."""
    chromium.open(page, 1280)
    shown = "[...document.querySelectorAll('.run-{}')].filter(e => getComputedStyle(e).display != 'none').length"
    all_of_both = [chromium.value(shown.format(run)) for run in (0, 1)]
    assert min(all_of_both) > 8
    assert chromium.value("document.querySelectorAll('svg g.run-1').length") >= 4
    chromium.value("document.getElementById('show-1').click()")
    assert [chromium.value(shown.format(run)) for run in (0, 1)] == [all_of_both[0], 0]
    chromium.value("document.getElementById('show-1').click()")
    assert [chromium.value(shown.format(run)) for run in (0, 1)] == all_of_both


@pytest.mark.further
def test_a_picture_can_be_enlarged(chromium, page: Path) -> None:
    """Where there are two columns; in one column it has the whole width already, and no control."""
    chromium.open(page, 900)
    assert chromium.value("getComputedStyle(document.querySelector('.enlarge')).display") == "none"
    chromium.open(page, 1280)
    size = "document.querySelector('#psd svg').getBoundingClientRect().width"
    before = chromium.value(size)
    chromium.value("document.querySelector('#psd .enlarge input').click()")
    assert chromium.value(size) > 1.5 * before
