"""The report: nothing from outside; readable on a telephone, on a desk, on paper, by keyboard, in light and dark."""

from __future__ import annotations

import html.parser
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support import axe, headless_browser

from pointing_analysis.budget.file import load_budget
from pointing_analysis.budget.total import evaluate
from pointing_analysis.image.optics import with_optics
from pointing_analysis.indices.synthetic import write_bag
from pointing_analysis.read.run import Run
from pointing_analysis.report import report
from pointing_analysis.report.cumulative_figure import cumulative
from pointing_analysis.report.figures import commands
from pointing_analysis.report.line_sources import likely_source
from pointing_analysis.report.model_results import ModelResults
from pointing_analysis.report.pointing_budget_page import render_budget
from pointing_analysis.report.report import latency_us, render, view, write_report
from pointing_analysis.report.spectrum_figure import density
from pointing_analysis.requirements.rows import WITHIN, overall
from pointing_analysis.requirements.summary import summarise
from pointing_analysis.spectra.prediction import Prediction, ToneComparison
from pointing_analysis.spectra.sidebands import FoundLine
from titop_plant.telescope.load import load_telescope

MAS = np.pi / 648_000_000
STAGES = {"none": 400.0, "isolator": 150.0, "fsm": 15.0, "fsm+pma": 5.0}
PREDICTED = ModelResults(
    predictions=(
        None,
        Prediction(note="the controllers are gone"),
        Prediction(
            (
                ToneComparison(88.0, 1, 15 * MAS, 15.3 * MAS, 0.3 * MAS / np.sqrt(2.0), 0.0),
                ToneComparison(210.0, 2, 30 * MAS, 60 * MAS, 0.0, 0.0),
            ),
            1.0,
            6.0,
        ),
        Prediction(
            (ToneComparison(88.0, 1, 2 * MAS, 0.1 * MAS, MAS, 0.0), ToneComparison(210.0, 1, 0.0, MAS, 0.0, 0.0)),
            1.0,
            6.0,
        ),
    )
)


def make(path: Path, loop: str, scale: float, n: int = 4000, **parameters) -> Path:
    rng = np.random.default_rng(len(loop))
    t = 1e-3 * np.arange(n)
    tones = [88.0, 210.0]
    truth = sum(scale * MAS * np.column_stack([np.sin(w * t), np.cos(w * t)]) for w in tones)
    truth += MAS * rng.standard_normal((n, 2))
    command = -10 * truth
    signals = {
        "truth/los": truth,
        "los_estimate": truth,
        "fsm/strain_gauge": np.zeros((n, 2)),
        "isolator/accel": rng.standard_normal((n, 6)),
        "fsm/command": command,
        "pma/command": rng.standard_normal((n, 6)),
        "camera/los": truth[::20],
    }
    given = {"loop": loop, "mode": "inprocess", "scenario": "design", "seed": 1, "tones_rad_s": tones}
    given |= {"requirements": load_telescope().to_mapping()["requirement"], **parameters}
    return write_bag(path, signals, periods={"camera/los": 20}, parameters=given)


@pytest.fixture(scope="module")
def stages(tmp_path_factory) -> list[Path]:
    folder = tmp_path_factory.mktemp("stages")
    return [make(folder / loop, loop, scale) for loop, scale in STAGES.items()]


@pytest.fixture(scope="module")
def page(stages, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("report") / "four.html"
    return write_report([Run.open(bag) for bag in stages], path, model=PREDICTED)


class Outline(html.parser.HTMLParser):
    """Collects what a reader without eyes or network depends on."""

    def __init__(self) -> None:
        super().__init__()
        self.ids: list[str] = []
        self.links: list[str] = []
        self.sources: list[str] = []
        self.pictures: list[str | None] = []
        self.headings: list[int] = []
        self.open: list[str] = []
        self.text: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = dict(attrs)
        if "id" in found:
            self.ids.append(str(found["id"]))
        for key in ("src", "href"):
            if key in found:
                (self.links if str(found[key]).startswith("#") else self.sources).append(str(found[key]))
        if tag == "svg":
            self.pictures.append(found.get("aria-label"))
        if re.fullmatch("h[1-6]", tag):
            self.headings.append(int(tag[1]))
        if tag not in ("meta", "link", "img", "br", "input"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text.append(data)


def outline(path: Path) -> Outline:
    found = Outline()
    found.feed(path.read_text())
    assert found.open == []
    return found


def test_nothing_comes_from_outside(page) -> None:
    found = outline(page)
    assert all(source.startswith("data:") for source in found.sources)
    assert "<script" not in page.read_text()
    assert "http" not in re.sub(r'"data:[^"]*"', "", page.read_text())


def test_pictures_have_texts_and_are_svg(page) -> None:
    found = outline(page)
    assert len(found.pictures) == 10
    assert all(label and len(label) > 20 for label in found.pictures)
    text = page.read_text().lower()
    assert "<img" not in text and "<date>" not in text and "dc:date" not in text
    for run in range(len(STAGES)):  # every run has curves that can be hidden
        assert text.count(f'<g class="run-{run}">') > 5


@pytest.mark.usefixtures("without_pictures")
def test_the_verdict_shows_limit_and_margin(stages) -> None:
    """Margin: limit minus quantile of the requirement, with its sign."""
    run = Run.open(stages[0])
    page = render([run])
    found = summarise(run)
    for verdict, row in zip(found.verdicts, found.rows):
        r = verdict.requirement
        margin = r.limit - verdict.quantile.value
        assert row.relative_margin == pytest.approx(margin / r.limit)
        assert f"({abs(100 * margin / r.limit):.0f} %)" in row.margin_text and row.margin_text in page
    worst = min((row for row in found.rows if row.index == "RPE"), key=lambda row: row.relative_margin)
    top = page[page.index('id="verdict"') : page.index('id="requirements"')]
    assert all(f">{text}</td>" in top for text in (worst.value_text, worst.limit_text, worst.margin_text))


def test_the_cumulative_rms_steps_up_by_the_tone(stages) -> None:
    """Each tone of amplitude a in quadrature on both axes adds a^2 to the mean square, at its frequency."""
    seen = view(Run.open(stages[0]), "none")
    assert seen.spectrum is not None
    power = (seen.spectrum.cumulative_rms() / MAS) ** 2
    for w in (88.0, 210.0):
        below, above = np.interp(np.array([-2, 2]) + w / (2 * np.pi), seen.spectrum.frequency, power)
        assert above - below == pytest.approx(STAGES["none"] ** 2, rel=0.05)
    picture = cumulative([seen])
    assert picture.svg.count(b'id="run-0"') == 4  # two curves, two named steps


def test_headings_ids_and_links(page) -> None:
    found = outline(page)
    assert len(set(found.ids)) == len(found.ids)
    assert all(link[1:] in found.ids for link in found.links)
    assert found.headings[0] == 1
    assert found.headings.count(1) == 1


def test_verdict_stands_on_top_and_equals_the_summary(stages, page) -> None:
    text = page.read_text()
    order = [text.index(f'id="{name}"') for name in ("verdict", "pictures", "requirements", "further", "provenance")]
    assert order == sorted(order)
    found = re.findall(r'<strong class="name">([^<]*)</strong> <span class="status (\w+)">([^<]*)<', text)
    assert [name for name, *_ in found] == [*STAGES]
    classes = {"compliant": "ok", WITHIN: "within", "not compliant": "bad"}
    for bag, (_, css, shown) in zip(stages, found):
        status = overall(summarise(Run.open(bag)).verdicts)
        assert shown == status and css == classes.get(status, "open")
    assert "not compliant" in text


def test_lines_are_named_with_what_is_likely_to_make_them(tmp_path) -> None:
    """A tone of a source, a wheel, a multiple of its speed, else the scenario that acts; else there is no name."""
    acting: list[dict[str, object]] = [{"name": "imbalance", "kind": "scenario", "what": ""}]
    acting += [{"name": name, "lines_rad_s": lines} for name, lines in (("cooler", [210.0, 260.0]), ("pump", [260.0]))]
    acting += [{"name": "fan", "lines_rad_s": [260.0]}, {"name": "odd", "lines_rad_s": "260"}]
    tones = [88.0, 140.0, 210.0, 260.0, 301.0]
    given = {"wheel_speeds_rad_s": [70.0, -88.0], "acting": acting, "tones_rad_s": tones}
    seen = view(Run.open(make(tmp_path / "bag", "fsm", 5.0, **given)), "fsm")
    names = {round(line.omega): likely_source(seen, line) for line in (*seen.tones, *seen.within_noise)}
    several = {210: "cooler", 260: "cooler, pump and 1 other", 301: "imbalance"}
    assert names == {70: "wheel 1", 88: "wheel 2", 140: "2 × wheel 1", **several}
    nobody = FoundLine(333.0, np.zeros(2), np.zeros(2), np.zeros(2), level=20.0, chance=0.0)
    found = replace(seen.tones[0], omega=333.0, found=nobody)
    assert likely_source(seen, found) == ""
    alt = density([seen]).alt
    assert "14.01 Hz wheel 2" in alt and "33.42 Hz cooler" in alt


def test_text_from_a_bag_is_not_markup(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(report, "PICTURES", (lambda drawn: density(drawn.views),))
    run = Run.open(make(tmp_path / "bag", "<img src=x onerror=alert(1)>", 5.0, note="<script>alert(2)</script>"))
    page = render([run])
    assert "<script" not in page
    assert "<img src=x" not in page


def test_timing_histograms_of_a_real_time_bag(tmp_path, monkeypatch) -> None:
    """Messages that know when they were sent give tick intervals and the latency from sensor to command."""
    from mcap.writer import Writer

    rng = np.random.default_rng(0)
    original = Writer.add_message

    def sent(self, channel_id, log_time, data, publish_time, sequence=0):
        late = 200_000 if channel_id == 2 else 0
        original(self, channel_id, log_time, data, publish_time + late + int(rng.integers(0, 30_000)), sequence)

    monkeypatch.setattr(Writer, "add_message", sent)
    n = 3000
    truth = MAS * rng.standard_normal((n, 2))
    signals = {"isolator/accel": np.zeros((n, 6)), "fsm/command": np.zeros((n, 2)), "truth/los": truth}
    run = Run.open(write_bag(tmp_path / "bag", signals, parameters={"loop": "fsm"}))
    assert np.median(latency_us(run)) == pytest.approx(200, abs=5)
    monkeypatch.setattr(report, "PICTURES", report.PICTURES[-2:])
    page = render([run])
    assert "Tick intervals" in page
    assert "Sensor to command" in page


@pytest.mark.usefixtures("without_pictures")
def test_predictions_stand_beside_what_was_measured(stages, page) -> None:
    text = page.read_text()
    part = text[text.index('id="predicted"') : text.index('id="further"')]
    rows = [re.findall(r'class="n">([^<]*)</td>', row) for row in re.findall(r"<tr>(<td.*?)</tr>", part, re.DOTALL)]
    assert rows[0] == ["33.423", "210.00 (2 lines)", "30", "60", "2.000"]  # the strongest first
    assert rows[1] == ["14.006", "88.00", "15", "15.3", "1.020 ± 0.020"]
    assert rows[2][-1] == "in noise"
    assert rows[3][-1] == "–"  # nothing predicted
    assert "fsm+pma: 1 s to 6 s" in part and "isolator: no prediction: the controllers are gone" in part
    assert "none:" not in part
    runs = [Run.open(bag) for bag in stages]
    none = ModelResults(predictions=[None])
    assert "Predicted" not in render(runs[:1]) and "Predicted" not in render(runs[:1], model=none)
    for name in ("predictions", "sources", "loops"):
        results: Any = {name: [()]}
        with pytest.raises(ValueError, match=f"^{name} must be one for each of the 2 runs, got 1$"):
            render(runs[:2], model=ModelResults(**results))


def test_bad_input(stages, tmp_path) -> None:
    with pytest.raises(ValueError, match="at least one run"):
        write_report([], tmp_path / "x.html")
    with pytest.raises(ValueError, match="folder of the report must exist"):
        write_report([Run.open(stages[0])], tmp_path / "no" / "x.html")
    blind = Run.open(write_bag(tmp_path / "blind", {"los_estimate": np.zeros((100, 2))}))
    with pytest.raises(ValueError, match="truth/los"):
        write_report([blind], tmp_path / "x.html")
    assert not list(tmp_path.glob("*.html"))


needs_browser = pytest.mark.skipif(headless_browser.browser() is None, reason="no chromium on this machine")


@pytest.fixture(scope="module")
def chromium():
    with headless_browser.Page() as found:
        yield found


@needs_browser
@pytest.mark.parametrize(("width", "phone"), [(390, True), (320, True), (1280, False), (1920, False)])
def test_fits_the_window_without_errors(chromium, page, width: int, phone: bool) -> None:
    chromium.open(page, width, phone=phone)
    assert chromium.value("document.documentElement.scrollWidth") <= width
    assert chromium.value("[...document.images].every(i => i.complete && i.naturalWidth > 0)")
    small = "[...document.querySelectorAll('p, td, dd, dt, li, summary, a')]"
    assert chromium.value(f"Math.min(...{small}.map(e => parseFloat(getComputedStyle(e).fontSize)))") >= 12
    assert chromium.errors == []
    assert [u for u in chromium.requests if not u.startswith(("file:", "data:", "about:"))] == []


@needs_browser
def test_nothing_overlaps_or_leaves_its_box(chromium, page) -> None:
    for width in (390, 1280):
        chromium.open(page, width, phone=width < 500)
        found = "[...document.querySelectorAll('#verdict, figure, #verdict *')]"
        wide = f"{found}.filter(e => e.scrollWidth > e.clientWidth + 1 && getComputedStyle(e).display != 'inline')"
        assert chromium.value(f"{wide}.map(e => e.outerHTML.slice(0, 80))") == []


@needs_browser
def test_the_requirements_of_several_runs_show_all_columns(chromium, page) -> None:
    """The last one was cut on the right of a window of 1280 pixels."""
    chromium.open(page, 1280)
    table = "document.querySelector('#requirements .scroll')"
    heads = chromium.value("[...document.querySelectorAll('#requirements th')].map(e => e.textContent)")
    assert (heads[0], heads[8]) == ("Run", "Independent samples")
    assert chromium.value(f"{table}.scrollWidth - {table}.clientWidth") <= 0


@pytest.mark.further
@needs_browser
def test_keyboard_reaches_links_tables_and_details(chromium, page) -> None:
    chromium.open(page, 1280)
    seen = []
    for _ in range(40):
        chromium.press("Tab", 9)
        seen.append(chromium.value("document.activeElement.tagName + '.' + document.activeElement.className"))
        if not seen[-1].startswith("BODY"):  # whoever has the focus shows it
            assert chromium.value("getComputedStyle(document.activeElement).outlineStyle") in ("solid", "auto")
    assert seen[0] == "A.skip"
    assert any(s == "DIV.scroll" for s in seen)
    assert sum(s.startswith("SUMMARY") for s in seen) >= 8
    chromium.value("document.querySelector('summary').focus()")
    before = chromium.value("document.querySelector('details').open")
    chromium.press("Enter", 13)
    chromium.call("Input.dispatchKeyEvent", type="char", text="\r", key="Enter")
    assert chromium.value("document.querySelector('details').open") is not before


@pytest.mark.further
@needs_browser
def test_prints_with_everything_unfolded(chromium, page) -> None:
    chromium.open(page, 1280)
    pdf = chromium.pdf()
    assert pdf.startswith(b"%PDF")
    assert 2 <= len(re.findall(rb"/Type\s*/Page\b", pdf)) <= 16
    chromium.call("Emulation.setEmulatedMedia", media="print")
    try:
        folded = "[...document.querySelectorAll('details table, details ul')]"
        hidden = f"{folded}.filter(t => t.getBoundingClientRect().height < 10).length"
        assert chromium.value(hidden) == 0
        assert chromium.value("getComputedStyle(document.querySelector('nav')).display") == "none"
    finally:
        chromium.call("Emulation.setEmulatedMedia", media="")


@pytest.fixture(params=["light", "dark"])
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


@needs_browser
@pytest.mark.parametrize(
    ("kind", "scheme", "width"),
    [("page", "light", 390), ("page", "dark", 1280), ("budget_page", "dark", 390), ("budget_page", "light", 1280)],
)
def test_axe_finds_nothing(chromium, kind: str, scheme: str, width: int, request: pytest.FixtureRequest) -> None:
    pytest.importorskip("axe_core_python")
    assert axe.findings(chromium, request.getfixturevalue(kind), width, scheme) == []


@needs_browser
def test_the_dark_scheme_is_dark(chromium, page: Path, scheme: str) -> None:
    chromium.open(page, 1280)
    colour = chromium.value("getComputedStyle(document.body).backgroundColor.match(/\\d+/g).map(Number)")
    assert (sum(colour) < 150) == (scheme == "dark")


@needs_browser
def test_pictures_of_pixels_keep_their_colours(chromium, stages: list[Path], tmp_path: Path, scheme: str) -> None:
    """A star is bright on a dark sky; curves are drawn for white paper and are inverted on a dark one."""
    optics = {"aperture_diameter": 2.4, "wavelength": 550e-9, "pixel_mas": 38.0}
    run = with_optics(Run.open(stages[-1]), optics)
    chromium.open(write_report([run], tmp_path / "star.html"), 1280)
    each = "s => [!!s.querySelector('image'), getComputedStyle(s).filter]"
    pictures = chromium.value(f"[...document.querySelectorAll('figure svg')].map({each})")
    assert {pixels for pixels, _ in pictures} == {True, False}
    assert all((way == "none") == (pixels or scheme == "light") for pixels, way in pictures)


@needs_browser
@pytest.mark.further
def test_a_run_can_be_hidden_and_shown_again(chromium, page: Path) -> None:
    """Its card, its rows and its curves; the other runs stay."""
    chromium.open(page, 1280)
    shown = "[...document.querySelectorAll('.run-{}')].filter(e => getComputedStyle(e).display != 'none').length"
    all_of_both = [chromium.value(shown.format(run)) for run in (0, 1)]
    assert min(all_of_both) > 8
    assert chromium.value("document.querySelectorAll('svg g.run-1').length") >= 4
    chromium.value("document.getElementById('show-1').click()")
    assert [chromium.value(shown.format(run)) for run in (0, 1)] == [all_of_both[0], 0]
    chromium.value("document.getElementById('show-1').click()")
    assert [chromium.value(shown.format(run)) for run in (0, 1)] == all_of_both


@needs_browser
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


@pytest.mark.parametrize("size", [0.0, 1e-6])
def test_commands_have_a_picture_where_one_of_them_is_not_zero(tmp_path: Path, size: float) -> None:
    """A stage without fine control records zeros."""
    signals = {"truth/los": MAS * np.ones((4000, 2)), "fsm/command": np.zeros((4000, 2))}
    signals["fsm/command"][7, 1] = size
    seen = view(Run.open(write_bag(tmp_path / "bag", signals)), "bag")
    assert (commands([seen], {"fsm/command": 1e-3}) is None) == (size == 0.0)
