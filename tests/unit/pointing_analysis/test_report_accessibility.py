"""The report in light and dark, on a telephone and on a desk: no finding of axe-core, runs hidden, pictures enlarged.

The rules are those of the package axe-core-python, or of a newer axe-core of npm below node_modules.
"""

from __future__ import annotations

import json
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from support import headless_browser

from pointing_analysis.read import Run
from pointing_analysis.report import write_report
from pointing_analysis.synthetic import write_bag

ROOT = Path(__file__).parents[3]
MAS = np.pi / 648_000_000
SCHEMES = ("light", "dark")
pytestmark = pytest.mark.skipif(headless_browser.browser() is None, reason="no chromium on this machine")


@pytest.fixture(scope="module")
def rules() -> str:
    newer = ROOT / "node_modules" / "axe-core" / "axe.min.js"
    if newer.exists():
        return newer.read_text("utf-8")
    pytest.importorskip("axe_core_python")
    spec = find_spec("axe_core_python")
    assert spec is not None and spec.origin is not None
    return (Path(spec.origin).parent / "axe.min.js").read_text("utf-8")


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


@pytest.mark.parametrize("width", [390, 1280])
def test_axe_finds_nothing(chromium, page: Path, rules: str, scheme: str, width: int) -> None:
    chromium.open(page, width, phone=width < 500)
    chromium.value(rules + "; 0")
    script = (
        "axe.run().then(r => JSON.stringify(r.violations.map(v => [v.id, v.nodes.map(n => n.html.slice(0, 120))])))"
    )
    answer = chromium.call("Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True)
    assert json.loads(answer["result"]["value"]) == []


def test_the_dark_scheme_is_dark(chromium, page: Path, scheme: str) -> None:
    chromium.open(page, 1280)
    colour = chromium.value("getComputedStyle(document.body).backgroundColor.match(/\\d+/g).map(Number)")
    assert (sum(colour) < 150) == (scheme == "dark")


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


def test_a_picture_can_be_enlarged(chromium, page: Path) -> None:
    """Where there are two columns; in one column it has the whole width already, and no control."""
    chromium.open(page, 900)
    assert chromium.value("getComputedStyle(document.querySelector('.enlarge')).display") == "none"
    chromium.open(page, 1280)
    size = "document.querySelector('#psd svg').getBoundingClientRect().width"
    before = chromium.value(size)
    chromium.value("document.querySelector('#psd .enlarge input').click()")
    assert chromium.value(size) > 1.5 * before
