"""Gyro, star tracker and further camera of a telescope: what they measure, their samples, laws that read them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from los_testbed.cli import app
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.run_parts import RunParts
from los_testbed.run.loop.simulate import run_in_process

from lftkit import sampled, state_space
from lftkit.errors import InputError
from lftkit.systems.connection.filters import high_pass, with_input_filter
from lftkit.systems.ports import Port, total_size
from lftkit.systems.sampled.sampled_system import SampledSystem
from lftkit.tuning.responses import ResponseProblem, parameters_of
from los_design.synthesis import pair_problem
from los_design.synthesis.store import continuous, load_designs
from los_loop.implemented_loop import ImplementedLoop
from los_loop.open_loop import OpenLoop
from pointing_analysis.read.run import Run
from titop_plant.interface import DT
from titop_plant.sensors import Sensor
from titop_plant.telescope.control_plant import loop_plant
from titop_plant.telescope.load import load_telescope
from titop_plant.telescope.loop_ports import LoopPorts
from titop_plant.telescope.placed.readings import SensorReadings
from titop_plant.telescope.telescope import Telescope

SENSORS = """
[[sensor]]
name = "gyro"
kind = "rate_gyro"
axes = [[0.6, 0.0, 0.8], [0.0, 1.0, 0.0]]
{gyro}

[[sensor]]
name = "spin"
kind = "angular_accelerometer"
place = "bus"
noise = 0.0

[[sensor]]
name = "tracker"
kind = "star_tracker"
rate = 10.0

[[sensor]]
name = "guide"
kind = "line_of_sight"
rate = 40.0
"""
SINE = """
[[disturbance]]
name = "sine"
kind = "cooler"
place = "bus"
frequency = 3.0
harmonics = [{ order = 1, force = [1.0, 0.5, 0.2] }]
"""
AXES = np.array([[0.6, 0.0, 0.8], [0.0, 1.0, 0.0]])
TRACKER, GUIDE = Port("tracker", 3, "rad"), Port("guide", 2, "rad")


def telescope_file(folder: Path, gyro: str = "", more: str = "") -> str:
    path = folder / "telescope.toml"
    path.write_text('base = "reference"\n' + SENSORS.format(gyro=gyro) + more, "utf-8")
    return str(path)


def test_they_measure_the_motion_of_the_bus_and_the_line_of_sight(tmp_path: Path) -> None:
    """A rate is the integral of the angular acceleration, an attitude that of the rate; the camera sees the truth."""
    settings = {"mode": "inprocess", "loop": "isolator", "noise": False, "start": "rest", "duration": 2.0}
    config = RunConfig.from_mapping({**settings, "parameters": telescope_file(tmp_path, more=SINE)})
    run_in_process(config, tmp_path / "bag")
    run = Run.open(tmp_path / "bag")
    signals = {name: run[f"sensor/{name}"] for name in ("gyro", "spin", "tracker", "guide")}
    assert {name: len(one) for name, one in signals.items()} == {"gyro": 2000, "spin": 2000, "tracker": 20, "guide": 80}
    alpha = signals["spin"].values
    omega = np.vstack([np.zeros(3), np.cumsum(0.5 * DT * (alpha[1:] + alpha[:-1]), axis=0)])
    gyro = signals["gyro"].values[:, :2]
    np.testing.assert_allclose(gyro - gyro[0], (omega - omega[0]) @ AXES.T, atol=2e-3 * np.abs(gyro).max())
    theta = np.vstack([np.zeros(3), np.cumsum(0.5 * DT * (omega[1:] + omega[:-1]), axis=0)])
    tracker, ticks = signals["tracker"].values, (signals["tracker"].stamp - run["truth/los"].stamp[0]) // 1_000_000
    assert ticks.tolist() == list(range(0, 2000, 100))
    np.testing.assert_allclose(tracker - tracker[0], theta[ticks], atol=5e-3 * np.abs(theta).max())
    frames = (signals["guide"].stamp - run["truth/los"].stamp[0]) // 1_000_000
    np.testing.assert_array_equal(signals["guide"].values[:, :2], run["truth/los"].values[frames, :2])


def test_their_errors_have_the_sizes_of_the_file(tmp_path: Path) -> None:
    gyro = "noise = 2e-6\nbias = 1e-5\nrandom_walk = 3e-5\nscale = 0.01"
    (sensor,) = load_telescope(telescope_file(tmp_path, gyro)).placed_sensors[:1]
    assert sensor.mount is not None and sensor.mount.rows == pytest.approx(1.01 * AXES)
    still, ticks, runs = np.zeros(2), 1000, []
    for seed in range(200):
        readings = SensorReadings([sensor], seed, noise=True)
        rows = np.empty((ticks, 2))
        for row in rows:
            row[:] = still
            readings.read(row)
        runs.append(rows)
    values = np.array(runs)
    ends = values[:, -20:].mean(axis=1) - values[:, :20].mean(axis=1)  # of the walk over about a second
    assert ends.std() == pytest.approx(3e-5 * np.sqrt(0.98), rel=0.15)
    steps = np.diff(values, axis=1)
    assert steps.std() == pytest.approx(np.hypot(2e-6 * np.sqrt(2.0), 3e-5 * np.sqrt(DT)), rel=0.01)
    assert values[:, :5].mean() == pytest.approx(1e-5, abs=3e-7)


def laws() -> tuple[SampledSystem, SampledSystem]:
    """The stored pair, each with a little of both slow sensors in its states and outputs."""
    found = []
    for stored in load_designs("implemented"):
        size = 1e-7 if stored.outputs[0].unit == "rad" else 1e-2
        more = size * np.random.default_rng(stored.order).standard_normal((stored.order + stored.D.shape[0], 5))
        B, D = np.hstack([stored.B, more[: stored.order]]), np.hstack([stored.D, more[stored.order :] * 1e3])
        found.append(replace(stored, B=B, D=D, inputs=(*stored.inputs, TRACKER, GUIDE)))
    return found[0], found[1]


@pytest.mark.parametrize("start", ["rest", "steady"])
def test_the_model_of_the_loop_holds_their_samples(start: str, tmp_path: Path) -> None:
    """Line of sight of a run, tick by tick, against the sampled loop with three rates; and the replay of its bag."""
    paths = tmp_path / "k_fsm.json", tmp_path / "k_pma.json"
    for law, path in zip(laws(), paths):
        law.to_file(path)
    settings = {
        "mode": "inprocess", "noise": False, "duration": 1.5, "scenario": "imbalance", "start": start,
        "parameters": telescope_file(tmp_path), **dict(zip(("k_fsm", "k_pma"), map(str, paths))),
    }  # fmt: skip
    config = RunConfig.from_mapping(settings)
    run_in_process(config, tmp_path / "bag")
    los = Run.open(tmp_path / "bag")["truth/los"].values[:, :2]
    parts = RunParts(config)
    assert not parts.start.note
    model = parts.tone_model()
    assert model.loop.frame_ticks == 100 and model.loop.ports.ticks == {"camera_los": 20, "tracker": 100, "guide": 25}
    np.testing.assert_allclose(los, model.record(len(los)), rtol=0.0, atol=1e-9 * np.abs(los).max())
    without = RunParts(replace(config, k_fsm=None, k_pma=None)).tone_model().record(len(los))
    assert np.abs(los - without).max() > 1e-4 * np.abs(los).max()
    assert not app.main(["--quiet", "replay", str(tmp_path / "bag"), "--output", str(tmp_path / "again")])
    one, other = (Run.open(tmp_path / name) for name in ("bag", "again"))
    for name in ("los_estimate", "fsm/command", "pma/command"):
        assert np.array_equal(one[name].values, other[name].values) and one[name].values.any()


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ('kind = "gyro"', "'sensor[0].kind' must be one of accelerometer, angular_accelerometer, rate_gyro, "),
        ('kind = "rate_gyro"\nplace = "M1"', "'sensor[0].place' must be one of bus, got 'M1'"),
        (
            'kind = "rate_gyro"\nrate = 30.0',
            "'sensor[0].rate' must divide 1000 Hz (50, 40, 25, ...), got 30.0 Hz",
        ),
        ('kind = "star_tracker"\nposition = [1.0, 0.0, 0.0]', "'sensor[0].position' must be absent for a star_tracker"),
        ('kind = "line_of_sight"\naxes = [[1.0, 0.0, 0.0]]', "'sensor[0].axes' must be absent for a line_of_sight"),
        ('kind = "rate_gyro"\nrandom_walk = -1.0', "'sensor[0].random_walk' must be at least 0, got -1"),
        ('kind = "rate_gyro"\nscale = -1.0', "'sensor[0].scale' must be above -1, got -1"),
    ],
)
def test_what_cannot_be_is_refused_with_its_line(lines: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "telescope.toml"
    path.write_text(f'base = "reference"\n[[sensor]]\nname = "one"\n{lines}\n', "utf-8")
    with pytest.raises(InputError, match=r"telescope\.toml, line [45]: ") as refused:
        load_telescope(path)
    assert message in str(refused.value)


def test_a_sample_that_is_not_whole_is_no_sample() -> None:
    """Of a sensor with two values one is not finite: the last whole sample stays."""
    from titop_plant.held_samples import HeldSamples

    zeros = np.zeros(2)
    held = HeldSamples([Sensor(Port("a", 2), zeros, zeros, framed=True)])
    rows = np.array([[1.0, 2.0], [3.0, np.nan], [np.nan, np.nan], [np.nan, 5.0], [6.0, 7.0]])
    expected = np.array([[1.0, 2.0], [1.0, 2.0], [1.0, 2.0], [1.0, 2.0], [6.0, 7.0]])
    together = rows.copy()
    held.fill_rows(together)
    held.values[:] = 0.0
    for row in rows:
        held.fill(row)
    np.testing.assert_array_equal(rows, expected)
    np.testing.assert_array_equal(together, expected)


@pytest.mark.parametrize("stage", [pair_problem.ALONE, pair_problem.BOTH])
def test_the_tuner_has_the_gains_of_the_loop_with_slow_sensors(stage: tuple[int, ...], tmp_path: Path) -> None:
    """The design problem against the loop of the sampled controllers, each closed by its own code."""
    telescope, rng = load_telescope(telescope_file(tmp_path)), np.random.default_rng(4)
    ports = telescope.loop_ports
    blocks = pair_problem.blocks(telescope, (pair_problem.OBSERVER, pair_problem.ACTUATORS))
    matrices, pair = [], []
    for stored, block, rows in zip(load_designs("implemented"), blocks, ports_of(telescope), strict=True):
        known = continuous(stored).at({})
        more = 1e-6 * rng.standard_normal((len(known.A) + len(known.D), total_size(rows) - known.B.shape[1]))
        more[len(known.A) :] = 0.0
        whole = np.hstack([np.block([[known.A, known.B], [known.C, known.D]]), more])
        n = len(known.A)
        law = state_space(whole[:n, :n], whole[:n, n:], whole[n:, :n], whole[n:, n:], rows, stored.outputs)
        matrices.append(whole)
        pair.append(
            sampled(
                with_input_filter(law, {p.name: high_pass(p, telescope.washout) for p in rows if washed(ports, p)}),
                DT,
                name=block.name,
            )
        )
    pair = [replace(law, design_basis=telescope.design_basis.to_mapping()) for law in pair]
    open_loop = OpenLoop(loop_plant(telescope, ports), telescope, ports)
    loop = ImplementedLoop(open_loop, pair[0], pair[1], pair_problem.STAGE_NAMES[stage])
    x = parameters_of(blocks, matrices)
    for omega in (0.7, 31.0, 333.0):
        point = rng.uniform(size=len(open_loop.names))
        samples = pair_problem.sample(open_loop, np.array([omega]), point[None])
        tuned = ResponseProblem(blocks, samples, pair_problem.gains(telescope, (stage,))).values(x)[:, 0]
        for (name, target), value in zip(pair_problem.limits(telescope, stage).items(), tuned, strict=True):
            metric = loop.metrics()[name]
            if metric.band[0] <= omega < metric.band[1]:
                expected = float(loop.gains(loop.at(omega), metric, point[None])[0])
                assert value * target / metric.limit == pytest.approx(expected, rel=1e-8), name


def ports_of(telescope: Telescope) -> tuple[tuple[Port, ...], tuple[Port, ...]]:
    """Inputs of both controllers with all sensors of the file."""
    rows = telescope.loop_ports
    return rows.of_design("k_fsm").measured, rows.of_design("k_pma").measured


def washed(ports: LoopPorts, port: Port) -> bool:
    return any(row.washout for row in ports.sensors if row.port == port)


def test_the_start_of_a_run_is_that_of_its_sensors(tmp_path: Path) -> None:
    """Two telescopes that differ in the bias of a sensor that K_PMA reads, in one process."""
    path = tmp_path / "k_pma.json"
    laws()[1].to_file(path)
    starts = []
    for bias in (1e-5, 2e-5):
        (tmp_path / str(bias)).mkdir()
        file = telescope_file(tmp_path / str(bias))
        Path(file).write_text(
            Path(file).read_text("utf-8").replace("rate = 10.0", f"rate = 10.0\nbias = {bias}"), "utf-8"
        )
        config = RunConfig(parameters=file, k_pma=str(path), scenario="imbalance")
        states = RunParts(config).start.states
        assert states is not None
        starts.append(states.command)
    assert np.abs(starts[0] - starts[1]).max() > 1e-4
