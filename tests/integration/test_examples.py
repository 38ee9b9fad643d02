"""Programs, notebooks and worked examples of the folder examples run, and do what their pages say."""

from __future__ import annotations

import ast
import json
import re
import runpy
import shlex
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from los_testbed.cli import app as cli
from los_testbed.config.run_config import RunConfig
from support.loop_rows import MEASUREMENTS

from lftkit.systems.ports import total_size
from pointing_analysis.read.run import Run
from titop_plant.interface import CAMERA
from titop_plant.simulation.driven_plant import driven_ports
from titop_plant.telescope.load import load_telescope

EXAMPLES = Path(__file__).parents[2] / "examples"


def run(name: str) -> dict[str, Any]:
    return runpy.run_path(str(EXAMPLES / f"{name}.py"))


def rigid_inertia(example: dict[str, Any]) -> np.ndarray:
    """Tensor about the common centre of mass: hub, tube, tip and the wheel, which turns freely about z."""
    outer, inner = 0.006, 0.006 - 0.0004
    tube = 2700.0 * np.pi * (outer**2 - inner**2) * 1.0  # [kg], 1 m long
    across = tube * (1.0 / 12.0 + (outer**2 + inner**2) / 4.0)
    wheel = example["WHEEL"]
    parts = (
        (12.0, [0.0, 0.0, 0.0], [0.12, 0.08, 0.13]),
        (tube, [0.0, 0.17 + 0.5, 0.05], [across, tube * (outer**2 + inner**2) / 2.0, across]),
        (0.15, [0.0, 0.17 + 1.0, 0.05], [2e-5] * 3),
        (wheel.mass, [0.0, 0.0, -0.05], [wheel.radial_inertia, wheel.radial_inertia, 0.0]),
    )
    centre = sum(m * np.array(r) for m, r, _ in parts) / sum(m for m, _, _ in parts)
    total = np.zeros((3, 3))
    for m, r, own in parts:
        d = np.array(r) - centre
        total += np.diag(own) + m * (d @ d * np.eye(3) - np.outer(d, d))
    return total


def test_a_torque_of_the_wheel_turns_hub_and_wheel_in_opposite_senses() -> None:
    """Below the modes the hub has the acceleration J^-1 [0; 0; u], the wheel -u / J_w less that of the hub."""
    example = run("cubesat_boom_and_wheel")
    still = example["cubesat"]().at({"wheel.speed": 0.0})
    s = 0.05j
    gain = (still.C @ np.linalg.solve(s * np.eye(still.A.shape[0]) - still.A, still.B) + still.D).real
    rows, columns = still.output_indices, still.input_indices
    hub = gain[rows(["accel_G"])[5], columns(["wheel_torque"])[0]]
    wheel = gain[rows(["wheel_accel"])[0], columns(["wheel_torque"])[0]]
    assert hub == pytest.approx(np.linalg.inv(rigid_inertia(example))[2, 2], rel=1e-4)
    assert wheel == pytest.approx(-1.0 / example["WHEEL"].axial_inertia - hub, rel=1e-9)


@pytest.mark.slow
def test_the_figures_of_the_closed_loop_are_drawn(tmp_path: Path) -> None:
    from los_design.figures.figures import draw

    paths = draw(tmp_path, 0, names=["controllers", "stages_implemented"])
    assert [path.name for path in paths] == [
        f"{name}.{suffix}" for name in ("controllers", "stages_implemented") for suffix in ("png", "svg")
    ]
    assert all(path.stat().st_size > 10_000 for path in paths)


def test_the_stewart_platform_has_the_modes_of_its_legs() -> None:
    """Poles of the block against energies: the stiffness along any motion is the sum over the legs."""
    example = run("stewart_platform_isolator")
    J, k = example["leg_matrix"](), example["LEG_STIFFNESS"]
    motion = np.random.default_rng(0).standard_normal(6)
    stretch = J.T @ motion  # of each leg
    system = example["platform"](0.0).at({})
    stored = motion @ system.C[:6, :6] @ motion
    assert stored == pytest.approx(k * float(stretch @ stretch), rel=1e-12)
    poles = np.linalg.eigvals(system.A)
    modes = np.linalg.eigvals(np.linalg.solve(example["PAYLOAD"], k * J @ J.T))
    np.testing.assert_allclose(np.sort(np.abs(poles))[::2] ** 2, np.sort(modes.real), rtol=1e-9)
    vertical = k * float(J[2] @ J[2]) / 60.0  # symmetric legs: the mode along z is that of mass and vertical stiffness
    assert np.abs(np.sort(modes.real) / vertical - 1.0).min() < 1e-9
    example["main"]()


@pytest.mark.further
def test_the_benchmark_takes_twelve_lines_and_finds_the_published_margin(capsys: pytest.CaptureFixture[str]) -> None:
    """Manual of the Robust Control Toolbox, as docs/certificates.md: 2.8826 to 2.8864, critical at 575.0339 rad/s."""
    file = EXAMPLES / "two_mass_spring_benchmark.py"
    body = ast.parse(file.read_text("utf-8")).body[1:]  # without the docstring
    assert sum(int(n.end_lineno or 0) - n.lineno + 1 for n in body) <= 12
    found = run("two_mass_spring_benchmark")
    assert found["plant"].occurrences() == {"m1": 1, "k": 1, "m2": 1} and found["plant"].order == 4
    bounds = found["bounds"]
    assert bounds.status == "closed" and 2.8 < bounds.lower <= 2.8864
    assert bounds.upper == pytest.approx(2.8864, abs=5e-5) and bounds.frequency == pytest.approx(575.0339, abs=1e-4)
    at = {name: float(v) for name, v in bounds.point.items()}
    crossing = found["loop"].at(at, beyond_range=True).poles()
    assert abs(crossing.real[abs(crossing.imag - 575.03) < 1]).max() < 1e-3 * 575
    assert "proof checked: True" in capsys.readouterr().out


TEXT = (EXAMPLES / "classes_for_a_run.py").read_text("utf-8").replace("\\\n       ", "")
LINES = re.findall(r"^    los-testbed (run .*)$", TEXT, flags=re.MULTILINE)


@pytest.mark.parametrize("line", LINES)
def test_each_command_of_the_example_runs(line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(EXAMPLES)
    bag = tmp_path / "bag"
    assert cli.main([*shlex.split(line), "--duration", "1", "--no-report", "--output", str(bag)]) == 0
    run = Run.open(bag)
    named = [v for v in run.parameters.values() if isinstance(v, str) and v.startswith("classes_for_a_run:")]
    assert len(named) == 1 and len(LINES) == 4, "one for each class"
    assert np.isfinite(run["truth/los"].values).all()


def test_the_pulses_last_20_ms_and_come_twice_a_second() -> None:
    pulses = run("classes_for_a_run")["ThrusterPulses"](RunConfig(seed=4))
    pulses.reset()
    rows = np.zeros((60_000, total_size(driven_ports(load_telescope()))))
    for row in rows:
        pulses.step(row)
    on = rows[:, 23] > 0.0
    assert not np.delete(rows, [23, 27], axis=1).any()
    edges = np.diff(np.r_[0, on.astype(int), 0])
    lengths = np.flatnonzero(edges < 0) - np.flatnonzero(edges > 0)
    assert lengths[:-1].min() >= 20
    assert 80 < len(lengths) < 160  # 120 expected in a minute, less where they overlap


def test_the_observer_holds_the_frame_and_subtracts_the_mirror() -> None:
    observer, y, out = run("classes_for_a_run")["CameraObserver"](), np.zeros(MEASUREMENTS), np.zeros(2)
    observer.reset()
    for tick in range(10_000):
        y[:] = 0.0
        y[CAMERA] = (3e-6, -1e-6) if tick % 20 == 0 else np.nan
        y[20:22] = 1e-5
        observer.step(y, out)
    np.testing.assert_allclose(out, [2e-6, -2e-6], rtol=1e-6)


@pytest.mark.slow
def test_robust_mass_spring_damper() -> None:
    example = run("robust_mass_spring_damper")
    result = example["main"]()
    assert result.status == "converged"
    assert result.rounds[0].worst_soft > 1.5 * result.rounds[0].soft, "the nominal design is fragile"
    assert all(w.value <= 1.01 for w in result.worst), "the robust one keeps every requirement in the box"
    # an independent look at 200 random plants and the corners
    from lftkit.tuning import certify

    rng = np.random.default_rng(5)
    low, high = np.array(list(example["BOX"].values())).T
    corners = [low + (high - low) * np.array([i & 1, i >> 1 & 1, i >> 2]) for i in range(8)]
    points = [*corners, *rng.uniform(low, high, size=(200, 3))]
    models = [example["build"](dict(zip(example["BOX"], p))) for p in points]
    found = certify(models, result.controller, example["REQUIREMENTS"])
    assert found.stable
    assert found.values.max() <= 1.01


@pytest.mark.slow
def test_fixed_order_missile_autopilot() -> None:
    example = run("fixed_order_missile_autopilot")
    results = example["main"]()
    bound = example["FULL_ORDER_OPTIMUM"]
    assert results[0].soft == pytest.approx(0.93547, abs=1e-5)
    for order in (1, 2, 4):
        assert bound * (1 - 1e-6) <= results[order].soft <= 1.02 * bound
        assert results[order].certificate.upper.max() == pytest.approx(results[order].soft, rel=2e-5)


@pytest.mark.further
def test_multi_requirement_pid() -> None:
    example = run("multi_requirement_pid")
    result = example["main"]()
    assert result.feasible and result.certificate.stable
    assert result.certificate.values[1:].max() <= 1 + 1e-4
    assert result.certificate.values == pytest.approx(result.values, rel=1e-3)
    # the load rejection cannot be had without touching a margin
    assert result.values[1:].max() == pytest.approx(1.0, abs=1e-4)
    # time simulation of the sensitivity peak's meaning: an open-loop distance of 1 / 1.7 from -1, with the exact delay
    plant, K = example["process"](), result.controller
    w = np.geomspace(1e-3, 1e2, 4000)
    distance = []
    for x in w:
        P = plant.C[[3]] @ np.linalg.solve(1j * x * np.eye(4) - plant.A, plant.B[:, [3]])
        C = K.D + K.C @ np.linalg.solve(1j * x * np.eye(K.order) - K.A, K.B)
        distance.append(abs(1 - (P * C).item() * np.exp(-1j * x * example["DELAY"])))
    assert min(distance) >= 0.45


NOTEBOOKS = sorted((EXAMPLES / "notebooks").glob("*.ipynb"))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_notebooks_are_numbered_and_stored_without_output(path: Path) -> None:
    assert NOTEBOOKS[int(path.stem[0]) - 1] == path and len(NOTEBOOKS) == 4
    cells = [cell for cell in json.loads(path.read_text("utf-8"))["cells"] if cell["cell_type"] == "code"]
    assert len(cells) > 4
    assert all(not cell["outputs"] and cell["execution_count"] is None for cell in cells)


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_notebooks_run(path: Path) -> None:
    """In a kernel of their own, in the folder in which they are; at least one cell shows a picture."""
    nbclient = pytest.importorskip("nbclient")
    import nbformat

    notebook = nbformat.read(path, as_version=4)
    nbclient.NotebookClient(notebook, timeout=280, resources={"metadata": {"path": str(path.parent)}}).execute()
    outputs = [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]
    assert any("image/png" in output.get("data", {}) for output in outputs)
    told = "".join(output["text"] for output in outputs if output.get("name") == "stderr").splitlines()
    assert not [line for line in told if not re.fullmatch(r"\w+: \d+ s", line)], "progress of a slow machine alone"


@pytest.mark.further
def test_stars_are_compared(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A star of magnitude 25 is seen in no frame; what is in the folder is not run again."""
    arguments = ["--magnitudes", "10,25", "--rates", "50", "--duration", "1", "--output", str(tmp_path)]
    monkeypatch.setattr(sys, "argv", ["guide_star_trade.py", *arguments])
    tables = []
    for _ in range(2):
        run("guide_star_trade")
        tables.append([line.split() for line in capsys.readouterr().out.splitlines() if line.lstrip()[0].isdigit()])
    assert tables[0] == tables[1] and [row[:3] for row in tables[0]] == [["10", "50", "2"], ["25", "50", "50"]]
