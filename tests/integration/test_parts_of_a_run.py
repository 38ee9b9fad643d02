"""All that acts in a run is named, its parts add up to the record, and its tones are lines."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from los_testbed.cli import app
from los_testbed.config.run_config import RunConfig
from los_testbed.config.run_settings import with_scenario
from los_testbed.parts.run_parts import RunParts
from los_testbed.parts.start import AT_REST, START_FILE, RunStart
from los_testbed.run.conditions import conditions
from los_testbed.run.loop.simulate import run_in_process
from los_testbed.run.loop.source_alone import NOISE, Part, errors_of_source, parts_of
from los_testbed.run.summary import source_shares as module_of_shares
from los_testbed.run.summary.ran_loop import RanLoop
from los_testbed.run.summary.source_shares import REST, TOGETHER, source_shares

from pointing_analysis.indices.errors import default_transient
from pointing_analysis.read.run import Run
from pointing_analysis.report.report import render, tones_of
from pointing_analysis.requirements.conditions import WHEEL_SPEEDS, conditions_of
from pointing_analysis.requirements.summary import Summary, summarise
from titop_plant.disturbances.drive_lines import fixed_lines, stepper_lines
from titop_plant.interface import DT
from titop_plant.telescope.load import load_telescope

pytestmark = pytest.mark.usefixtures("without_pictures")

MOVING_ROTORS = Path(__file__).parents[2] / "examples" / "spacecraft" / "moving_rotors.toml"

HARMONICS = "harmonics = [{order = 1, force = [0.2, 0.1, 0.3]}, {order = 2, torque = [0.01, 0.0, 0.02]}]"
SOURCES = {
    "series": 'file = "series.csv"\nplace = "wheel_2"\nkeep_mean = true',
    "harmonics": f'place = "wheel_1"\nsquared = false\n{HARMONICS}',
    "waterfall": 'file = "waterfall.csv"\nspeed = 200.0',
    "psd": 'file = "psd.csv"\nplace = "payload"',
    "cooler": f'place = "payload"\nfrequency = 45.0\nlinewidth = 0.2\n{HARMONICS}',
    "pulses": "force = [3.0, 0.0, 1.0]\ntorque = [0.5, 0.5, 0.0]\nperiod = 0.5\nwidth = 0.05",
}
CLASS = """
import numpy as np


class Wind:
    def __init__(self):
        self.reset()

    def reset(self):
        self.random = np.random.default_rng(7)

    def step(self, out):
        out[:] = 0.0
        out[22:25] = self.random.standard_normal(3)
"""


LAW = """
from pathlib import Path

import los_estimator
from lftkit.systems.sampled.sampled_system import SampledSystem

observer = SampledSystem.from_file(Path(los_estimator.__file__).parent / "designs/k_fsm.json").to_control()
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    t = np.arange(2000) / 1000.0
    force = np.sin(2 * np.pi * np.outer(t, [11.0, 23.0, 37.0]))
    np.savetxt("series.csv", np.c_[t, force], delimiter=",", header="time (s),Fx,Fy,Fz", comments="")
    lines = [[60.0 * s, f, 0.3 * (f == 2 * s)] for s in (30.0, 34.0) for f in np.arange(50.0, 80.0)]
    np.savetxt("waterfall.csv", lines, delimiter=",", header="speed (rpm),frequency (Hz),Fz", comments="")
    np.savetxt("psd.csv", [[1, 1e-3], [200, 1e-4]], delimiter=",", header="frequency (Hz),Fx", comments="")
    (tmp_path / f"wind_{tmp_path.name}.py").write_text(CLASS)
    return tmp_path


def telescope(folder: Path, *kinds: str) -> str:
    tables = [f'[[disturbance]]\nname = "my {kind}"\nkind = "{kind}"\n{SOURCES[kind]}\n' for kind in kinds]
    (folder / "telescope.toml").write_text('base = "reference"\n' + "\n".join(tables))
    return str(folder / "telescope.toml")


def recorded(**settings: object) -> Run:
    config = RunConfig.from_mapping({"mode": "inprocess", "duration": 1.2, "loop": "fsm", **settings})
    run_in_process(config, Path("bag"))
    return Run.open(Path("bag"))


@pytest.fixture
def simulated(monkeypatch: pytest.MonkeyPatch) -> list[np.ndarray]:
    """Lines of sight of the parts whose shares were computed."""
    found: list[np.ndarray] = []

    def noted(part: Part) -> Part:
        def los(ticks: int) -> np.ndarray:
            found.append(part.los(ticks))
            return found[-1]

        return replace(part, los=los)

    monkeypatch.setattr(module_of_shares, "parts_of", lambda parts: [noted(part) for part in parts_of(parts)])
    return found


def check_sum(run: Run, simulated: list[np.ndarray], *names: str) -> None:
    """The parts are these, their lines of sight add up to the record, tick by tick, and their shares to 1."""
    rows = source_shares(RanLoop.of(run))
    truth, total = run["truth/los"].values[:, :2], np.sum(simulated, axis=0)
    assert np.abs(total - truth).max() < 1e-6 * np.abs(truth).max()
    assert [row.name for row in rows] == [*names, TOGETHER], "nothing is left over"
    assert sum(row.share for row in rows[:-1]) == pytest.approx(1.0, abs=1e-6) == rows[-1].share
    assert rows[-1].rpe == pytest.approx(summarise(run, transient=1.0).rpe_rms, rel=1e-9)
    acting = [name for name in names if name != NOISE]
    assert list(conditions_of(run).names) == acting and summarise(run).scenario == ", ".join(acting)


@pytest.mark.further
def test_a_telescope_with_sources_runs_with_them_alone(folder: Path, simulated: list[np.ndarray]) -> None:
    run = recorded(parameters=telescope(folder, *SOURCES))
    assert run.parameters["scenario"] == "none"
    check_sum(run, simulated, *(f"my {kind}" for kind in SOURCES), NOISE)


@pytest.mark.further
def test_a_scenario_that_is_asked_for_acts_beside_them(folder: Path, simulated: list[np.ndarray]) -> None:
    run = recorded(parameters=telescope(folder, "cooler"), scenario="worst_case")
    check_sum(run, simulated, "worst_case", "my cooler", NOISE)


def test_sources_that_cancel_have_no_shares(folder: Path) -> None:
    """What is left of them is rounding, of which they were said to be -554063908432868 %."""
    both = [f'[[disturbance]]\nname = "{name}"\nkind = "series"\n{SOURCES["series"]}\n' for name in "ab"]
    (folder / "telescope.toml").write_text('base = "reference"\n' + "\n".join([both[0], both[1] + "scale = -1.0\n"]))
    rows = source_shares(RanLoop.of(recorded(parameters="telescope.toml", noise=False)))
    assert [row.name for row in rows] == ["a", "b", TOGETHER]
    assert (
        [row.share for row in rows] == [0.0, 0.0, 0.0]
        and rows[0].rpe == pytest.approx(rows[1].rpe)
        and rows[0].rpe > 0.0
    )


def test_a_class_and_files_have_a_row_each(folder: Path, simulated: list[np.ndarray]) -> None:
    name = f"wind_{folder.name}:Wind"
    run = recorded(disturbance_source=name, disturbance_files="series.csv@wheel_1", scenario="imbalance")
    check_sum(run, simulated, "imbalance", name, "series", NOISE)


def test_samples_at_the_edges_of_a_window_count_by_their_part(
    folder: Path, simulated: list[np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Windows of 12.5 ticks are whole on a grid of tenths of a tick; once 12 ticks were taken."""
    run = recorded(parameters=telescope(folder, "pulses"))
    monkeypatch.setattr(module_of_shares, "exposure_of_run", lambda run: 12.5e-3)
    shares = [row.share for row in source_shares(RanLoop.of(run))][:-1]

    def within(los: np.ndarray) -> np.ndarray:
        tenths = np.repeat(los[round(default_transient(1.2) / DT) :], 10, axis=0)
        windows = tenths[: len(tenths) // 125 * 125].reshape(-1, 125, 2)
        return np.asarray(windows - windows.mean(axis=1, keepdims=True))

    whole = within(np.sum(simulated, axis=0))
    assert shares == pytest.approx([np.sum(within(los) * whole) / np.sum(whole**2) for los in simulated], abs=1e-6)


def test_a_system_of_python_control_has_the_rows_too(folder: Path) -> None:
    (folder / f"law_{folder.name}.py").write_text(LAW)
    run = recorded(parameters=telescope(folder, "pulses"), k_fsm=f"law_{folder.name}:observer")
    assert [row.name for row in source_shares(RanLoop.of(run))] == ["my pulses", NOISE, TOGETHER]


def test_a_law_without_a_model_is_the_reason_why_there_are_none(folder: Path) -> None:
    (folder / f"code_{folder.name}.py").write_text(
        "class Still:\n    def reset(self): pass\n    def step(self, measurement, out): out[:] = 0.0\n"
    )
    run = recorded(parameters=telescope(folder, "pulses"), k_fsm=f"code_{folder.name}:Still")
    with pytest.raises(ValueError, match=r"^the bag does not hold the controllers k_fsm.json, as of user code$"):
        source_shares(RanLoop.of(run))


@pytest.mark.further
@pytest.mark.usefixtures("folder")
def test_wheels_and_drives_of_the_telescope_have_a_row_each(simulated: list[np.ndarray]) -> None:
    check_sum(recorded(parameters=str(MOVING_ROTORS)), simulated, "wheel broadband", "array drive", NOISE)


def test_what_limits_make_is_a_row_of_its_own(folder: Path) -> None:
    run = recorded(parameters=telescope(folder, "pulses"), fsm_authority=1e-6, duration=1.5)
    rows = source_shares(RanLoop.of(run))
    assert [row.name for row in rows] == ["my pulses", NOISE, REST, TOGETHER]
    assert sum(row.share for row in rows[:-1]) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("settings", "scenario"),
    [
        ({}, "worst_case"),
        ({"parameters": "telescope.toml"}, "none"),
        ({"parameters": "telescope.toml", "scenario": "ramp"}, "ramp"),
        ({"parameters": "telescope.toml", "disturbance": False}, "worst_case"),
        ({"parameters": str(MOVING_ROTORS)}, "none"),
        ({"disturbance_files": "series.csv"}, "none"),
        ({"disturbance_files": "series.csv", "scenario": "imbalance"}, "imbalance"),
        ({"disturbance_source": "mine:Wind"}, "none"),
        ({"plant": "mine:Plant", "start": "rest"}, "worst_case"),
    ],
)
def test_which_scenario_acts(folder: Path, settings: dict[str, object], scenario: str) -> None:
    telescope(folder, "cooler")
    assert with_scenario(RunConfig(**settings)).scenario == scenario  # type: ignore[arg-type]
    assert with_scenario(RunConfig()).scenario == RunParts(RunConfig()).config.scenario == "worst_case"


@pytest.mark.parametrize(
    ("settings", "speeds"),
    [
        ({}, [212.0, 187.0, 236.0, 254.0]),  # of the parameter file
        ({"wheel_speed": [50.0, -60.0, 70.0, -80.0]}, [50.0, 60.0, 70.0, 80.0]),
        ({"profile": "table.csv"}, []),
        ({"plant": "mine:Plant", "start": "rest"}, []),
    ],
)
def test_the_report_looks_for_lines_at_the_speeds_of_the_wheels(
    settings: dict[str, object], speeds: list[float]
) -> None:
    entries = conditions(RunParts(RunConfig.from_mapping({"scenario": "none", **settings})), AT_REST)
    run = SimpleNamespace(parameters={name: json.loads(entries[name]) for name in (WHEEL_SPEEDS,) if name in entries})
    assert tones_of(run).tolist() == sorted(speeds)


@pytest.mark.further
def test_tone_and_member_are_on_screen_in_json_and_on_the_page(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = ["run", "--mode", "inprocess", "--duration", "1.2", "--loop", "fsm"]
    assert app.main([*line, "--json", "--output", "a"]) == 0
    shown = capsys.readouterr()
    tone = RunStart.from_bytes(Run.open(Path("a")).attachments[START_FILE]).tone
    assert tone is not None
    acts = f"worst_case (tone of {tone.omega / (2 * np.pi):.4g} Hz, worst for the RPE)"
    values = json.loads(shown.out)
    assert values["acting"] == [acts] and values["member"].startswith("arrays at ")
    assert f"sources {acts}" in shown.err and f"member  {values['member']}" in shown.err
    page = Path("a/report.html").read_text()
    assert acts in page and values["member"] in page
    assert app.main([*line, "--scenario", "unit_norm", "--no-report", "--output", "b"]) == 0
    capsys.readouterr()
    assert app.main(["report", "a", "b", "--output", "page.html"]) in (0, 1)
    said = " ".join(capsys.readouterr().out.split())
    words = "disturbance and member differ from a: no comparison of controllers"
    page = Path("page.html").read_text()
    assert words in said and words[1:] in page and acts in page and "unit_norm" in page


COOLER = """
import numpy as np
from titop_plant.interface import DT
from titop_plant.simulation.driven_plant import disturbance_columns
from titop_plant.telescope.load import load_telescope

WRENCH = disturbance_columns(load_telescope())["external_wrench"]


class Cooler:
    def reset(self):
        self.tick = 0

    def step(self, out):
        angle = 2.0 * np.pi * 45.0 * DT * self.tick
        out[:] = 0.0
        force = 200.0 * np.sin(angle) + 100.0 * np.sin(2.0 * angle + 1.0)
        out[WRENCH] = force * np.array([1.0, 0.5, 0.2, 0.1, 0.1, 0.0])
        self.tick += 1
"""


def run_of(bag: Path, **settings: object) -> tuple[Run, Summary]:
    run_in_process(RunConfig(mode="inprocess", duration=8.0, loop="fsm+pma", seed=4, **settings), bag)  # type: ignore[arg-type]
    run = Run.open(bag)
    return run, summarise(run)


@pytest.mark.further
@pytest.mark.usefixtures("without_pictures")
def test_harmonics_of_a_cooler_are_tones_and_what_is_left_is_the_noise(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "own_cooler.py").write_text(COOLER)
    monkeypatch.syspath_prepend(tmp_path)
    run, with_cooler = run_of(tmp_path / "cooler", disturbance_source="own_cooler:Cooler", start="rest")
    _, quiet = run_of(tmp_path / "quiet", disturbance=False, start="rest")
    assert with_cooler.budget is not None and quiet.budget is not None
    lines = [line for line in with_cooler.budget.found if not line.is_sideband]
    assert [line.omega / (2.0 * np.pi) for line in lines] == pytest.approx([45.0, 90.0], abs=0.02)
    moving = {line.carrier for line in with_cooler.budget.found if line.is_sideband}
    assert moving <= {line.omega for line in lines}, "the ringing of the start is at the sides of the tones"
    assert with_cooler.budget.fast > 20.0 and with_cooler.budget.slow == 0.0
    assert quiet.budget.found == () and quiet.budget.fast == 0.0
    assert with_cooler.budget.noise == pytest.approx(quiet.budget.noise, rel=0.1), "and the ringing of its start"
    page = render([run])
    assert page.count("dB above the noise") == 2


FILE = Path(__file__).parents[2] / "examples/spacecraft/moving_rotors.toml"
SEED = 3


def test_without_steppers_the_drives_are_those_of_the_reference() -> None:
    telescope = load_telescope(str(FILE))
    assert len(telescope.motors) == 2 and not telescope.without_steppers().motors
    assert telescope.without_steppers().sadm == load_telescope().sadm


@pytest.mark.slow
def test_the_lines_make_the_error_of_a_run() -> None:
    """RPE of 20 ms by the lines against that of the simulated open plant under the drives alone, both of this seed."""
    telescope = load_telescope(str(FILE))
    config = RunConfig(
        mode="inprocess",
        loop="isolator",
        scenario="imbalance",
        wheel_speed=(0.0, 0.0, 0.0, 0.0),
        duration=20.0,
        seed=SEED,
        parameters=str(FILE),
    )
    parts = RunParts(config)
    index = [one.name for one in parts.sources].index("array drive")
    los = errors_of_source(parts, index, 20_000)
    ticks = round(0.02 / DT)
    windows = los[: len(los) // ticks * ticks].reshape(-1, ticks, 2)
    run = math.sqrt(float(np.square(windows - windows.mean(axis=1, keepdims=True)).sum(axis=2).mean()))
    lines = stepper_lines(telescope, SEED)
    part = 1.0 - np.square(np.sinc(lines.omega * 0.02 / (2.0 * np.pi)))
    assert run == pytest.approx(math.sqrt(float((lines.size**2 * part).sum() / 2.0)), rel=0.03)
    fixed = fixed_lines(telescope)
    np.testing.assert_allclose(fixed.omega, telescope.sadm.step_frequency * np.arange(1, 6), rtol=1e-12)
