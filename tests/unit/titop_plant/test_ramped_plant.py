"""The telescope while wheels and arrays move: convergence, energy, phases, profiles."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import linalg
from scipy.integrate import solve_ivp
from support.loop_rows import COMMANDS
from support.slow_cases import slow

from lftkit import Port, System
from titop_plant.disturbances.wheel_and_drive_tones import imbalance_tones, no_tones
from titop_plant.interface import DT
from titop_plant.simulation.build import PlantConfig, PlantFamily, build_plant
from titop_plant.simulation.constant_step import ConstantStep
from titop_plant.simulation.plant import Plant
from titop_plant.simulation.plant_config import motion, values_along
from titop_plant.simulation.plant_step import plant_step, step_matrix
from titop_plant.simulation.ramped_step import MovingTones, RampedStep, node_interval, node_matrices
from titop_plant.simulation.sensor_samples import SensorModel
from titop_plant.telescope.load import load_telescope
from titop_plant.telescope.motion_profiles import MotionProfile, linear_profile, read_profile

SILENT = SensorModel(np.zeros(22), np.zeros(22), 1, 0.0, 0)
CROSSING = PlantConfig(
    noise=False,
    scenario="ramp",
    wheel_speed=(395.0, -200.0, 150.0, -100.0),
    wheel_acceleration=(8.0, 0.0, 0.0, 0.0),
    ramp_duration=1.2,
    seed=3,
)


def line_of_sight(plant: Plant, ticks: int, every: int = 1) -> np.ndarray:
    command, measurement, truth = np.zeros(8), np.zeros(22), np.zeros(2)
    record = np.empty((ticks // every, 2))
    for k in range(ticks):
        plant.step(command, measurement, truth)
        if k % every == 0:
            record[k // every] = truth
    return record


@pytest.mark.slow
def test_a_wheel_crosses_the_mode_near_400_as_in_an_integrator_of_others() -> None:
    """The linear time-varying equations by an explicit Runge-Kutta method of order 8, with step control."""
    assert CROSSING.wheel_speed is not None
    crossing = replace(CROSSING, wheel_speed=(398.0, *CROSSING.wheel_speed[1:]), ramp_duration=0.5)
    family, plant = PlantFamily.of(crossing), build_plant(crossing)
    assert isinstance(plant.dynamics, RampedStep)
    profile, tones = motion(crossing, family.telescope), plant.dynamics.moving

    def system(time: float) -> tuple[System, np.ndarray]:
        data = family.control_loop.at(values_along(crossing, profile, time, family.telescope))
        return data, (tones.unit.amplitude @ tones.phasors(time)).imag

    def slope(time: float, state: np.ndarray) -> np.ndarray:
        data, disturbance = system(time)
        return np.asarray(data.A @ state + data.B[:, COMMANDS:] @ disturbance)

    times = 1e-3 * np.arange(500)
    found = solve_ivp(slope, (0.0, times[-1]), plant.state, method="DOP853", t_eval=times, rtol=1e-7, atol=1e-13)
    expected = np.empty((500, 2))
    for row, time, state in zip(expected, times, found.y.T):
        data, disturbance = system(time)
        row[:] = data.C[-2:] @ state + data.D[-2:, COMMANDS:] @ disturbance
    assert np.abs(line_of_sight(plant, 500) - expected).max() < 5e-3 * np.abs(expected).max()


def gyroscope(speed: float, stiffness: float) -> System:
    """Two coupled oscillators with a gyroscopic term; the state is (x, y, x', y'), the energy its weighted norm."""
    A = np.zeros((4, 4))
    A[:2, 2:] = np.eye(2)
    A[2:, :2] = -np.diag([300.0**2, stiffness])
    A[2:, 2:] = 0.05 * speed * np.array([[0.0, 1.0], [-1.0, 0.0]])
    return System(
        A,
        np.zeros((4, 30)),
        np.vstack([np.eye(4), np.zeros((20, 4))]),
        np.zeros((24, 30)),
        (Port("u", 30),),
        (Port("y", 24),),
    )


@pytest.mark.further
@pytest.mark.parametrize("stretch", [slow(0.0), 2e4])
def test_energy_balance_of_a_free_response_while_parameters_vary(stretch: float) -> None:
    """Gyroscopic forces do no work while the speed varies; a stiffness k(t) gives the power 1/2 k' y^2."""
    profile = linear_profile(0.0, 0.0, np.zeros(4), np.full(4, 100.0), 10.0)
    interval = node_interval(profile, DT)

    def matrices(time: float) -> np.ndarray:
        return step_matrix(gyroscope(float(profile.speeds(time)[0]), 250.0**2 + stretch * time), no_tones(22))

    nodes = node_matrices(profile, interval, DT, matrices)
    tones = MovingTones(profile, no_tones(22))
    start = np.array([1.0, 0.5, 0.0, 100.0])
    plant = Plant(RampedStep(nodes, interval, tones, start), SILENT, np.ones(8))
    measured = np.empty((10001, 22))
    for row in measured:
        plant.step(np.zeros(8), row, np.zeros(2))
    x, y, vx, vy = measured[:, :4].T
    stiffness = 250.0**2 + stretch * DT * np.arange(10001)
    energy = 0.5 * (vx**2 + vy**2 + 300.0**2 * x**2 + stiffness * y**2)
    work = np.concatenate([[0.0], np.cumsum(0.25 * stretch * DT * (y[1:] ** 2 + y[:-1] ** 2))])
    assert np.abs(energy - work - energy[0]).max() < 2e-3 * energy.max()
    if stretch:
        assert work[-1] > 0.2 * energy[0]


def test_phases_are_the_integrals_of_the_speeds() -> None:
    """Through zero, where the sense of rotation changes: against quadrature, and a constant speed against its tones."""
    telescope = load_telescope()
    unit = imbalance_tones(telescope, np.ones(4), np.random.default_rng(0))
    profile = linear_profile(0.0, 0.0, [60.0, -60.0, 60.0, -60.0], [-40.0, 40.0, -40.0, 40.0], 3.0)
    tones = MovingTones(profile, unit)
    time = np.linspace(0.0, 3.5, 350001)
    turned = np.concatenate([[0.0], np.cumsum(0.5 * (profile.speeds(time)[1:, 0] + profile.speeds(time)[:-1, 0]))])
    for k in (0, 149999, 350000):
        phasor = tones.phasors(float(time[k]))[3]
        expected = float(profile.speeds(time[k])[0]) ** 2 * np.exp(1j * unit.harmonic[3] * turned[k] * 1e-5)
        assert phasor == pytest.approx(expected, rel=1e-6)
    still = MovingTones(MotionProfile(np.zeros(1), np.zeros(1), np.array([[-70.0, 80.0, -90.0, 100.0]])), unit).start()
    same = imbalance_tones(telescope, np.array([70.0, 80.0, 90.0, 100.0]), np.random.default_rng(0))
    np.testing.assert_allclose(still.frequency, same.frequency, rtol=1e-12)
    np.testing.assert_allclose(np.abs(still.amplitude), np.abs(same.amplitude), rtol=1e-12)
    backwards, forwards = still.amplitude[:5, 0], same.amplitude[:5, 0]
    assert backwards[1] / backwards[0] == pytest.approx(1j) and forwards[1] / forwards[0] == pytest.approx(-1j)


def test_a_ramp_of_almost_nothing_is_the_run_at_constant_speed() -> None:
    ramp = replace(CROSSING, wheel_acceleration=(1e-9, 0.0, 0.0, 0.0), ramp_duration=0.2)
    family = PlantFamily.of(ramp)
    plant = family.build(ramp)
    assert isinstance(plant.dynamics, RampedStep)
    tones = MovingTones(motion(ramp, family.telescope), plant.dynamics.moving.unit).start()
    data = family.control_loop.at({f"wheel_{i + 1}.speed": s for i, s in enumerate(ramp.wheel_speed or ())})
    constant = Plant(ConstantStep(plant_step(data, tones), plant.state, np.zeros(0)), SILENT, plant.authority)
    first, second = line_of_sight(plant, 300), line_of_sight(constant, 300)
    assert np.abs(first - second).max() < 1e-7 * np.abs(second).max()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time,theta\n", "the header must be time,theta,wheel_speed_1"),
        ("HEAD\n0,0,1,2,3\n", "line 2: must hold 6 finite numbers, got '0,0,1,2,3'"),
        ("HEAD\n1,0,1,2,3,4\n2,0,1,2,3,4\n", "time must increase from 0"),
        ("HEAD\n0,0,1,2,3,4\n", "over two lines or more, got 1 lines"),
    ],
)
def test_files_that_are_no_profile(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "p.csv"
    path.write_text(text.replace("HEAD", "time,theta,wheel_speed_1,wheel_speed_2,wheel_speed_3,wheel_speed_4"))
    with pytest.raises(ValueError, match=message):
        read_profile(path, 4)


def test_modes_over_time_are_those_at_the_speeds_of_that_time() -> None:
    """Gyroscopic: two hundred rad/s more of a wheel move some modes, as they do at constant speed."""
    ramp = replace(CROSSING, wheel_acceleration=(100.0, 0.0, 0.0, 0.0), ramp_duration=2.0)
    plant, family = build_plant(ramp), PlantFamily.of(ramp)
    assert plant.motion is not None
    assert plant.motion["knots"][0][2] == 395.0 and 1.0 in plant.motion["harmonics"]
    first, *_, last = plant.motion["modes_over_time"]
    assert first == [0.0, *plant.motion["modes"]] and last[0] == pytest.approx(2.0) and len(last) == len(first)
    for row in (first, last):
        values = values_along(ramp, motion(ramp, family.telescope), row[0], family.telescope)
        poles = linalg.eigvals(family.control_loop.at(values).A)
        light = np.sort(poles.imag[(poles.imag > 0.0) & (-poles.real < 0.1 * np.abs(poles)) & (poles.imag < 2500.0)])
        found = np.array([w for w in row[1:] if w < 2500.0])
        np.testing.assert_allclose(found[:40], light[:40], rtol=1e-4)
    moved = np.abs(np.array(last[1:41]) - plant.motion["modes"][:40])
    assert moved.max() > 0.05
