"""Sources at places of the structure: against exact tones, against laws of mechanics, in the right amounts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy import signal as spectra
from support.loop_rows import COMMANDS, MEASUREMENTS

from lftkit.arrays import FloatArray
from lftkit.systems.ports import port_slices
from titop_plant.disturbances import sources as placed
from titop_plant.disturbances.moving_mass import MovingMassSignal, PhaseNoise
from titop_plant.disturbances.places import all_places, place_matrix, source_ports
from titop_plant.disturbances.signals import (
    PulseSignal,
    SampledSignal,
    ToneSignal,
    noise_of_density,
    repeated,
)
from titop_plant.disturbances.sources import INSTANTS, PlacedSource, Sources
from titop_plant.interface import TRUTH
from titop_plant.simulation import build as simulation
from titop_plant.simulation.driven_plant import DisturbanceInput
from titop_plant.simulation.plant import Plant
from titop_plant.simulation.plant_config import PlantConfig
from titop_plant.simulation.source_matrix import source_matrix
from titop_plant.telescope.load import load_telescope

QUIET = PlantConfig(disturbance=False, noise=False, theta=0.4)
DT = 1e-3
PARAMETERS = load_telescope()


@pytest.fixture(scope="module")
def family() -> simulation.PlantFamily:
    return simulation.PlantFamily.of(QUIET)


def truth(plant: object, ticks: int) -> FloatArray:
    y, los, found, command = np.zeros(MEASUREMENTS), np.zeros(TRUTH), np.zeros((ticks, TRUTH)), np.zeros(COMMANDS)
    for k in range(ticks):
        plant.step(command, y, los)  # type: ignore[attr-defined]
        found[k] = los
    return found


def driven(family: simulation.PlantFamily, *sources: PlacedSource) -> Plant:
    start = np.zeros(family.control_loop.order)
    drive = DisturbanceInput(source_matrix(family, QUIET, sources), Sources(sources), "test")
    plant = replace(family.build(QUIET, start), inputs=(drive,))
    plant.reset()
    return plant


def source(signal: object, place: str = "wheel_2", **options: FloatArray) -> PlacedSource:
    return PlacedSource("a", "test", place, place_matrix(place, PARAMETERS, **options), signal)  # type: ignore[arg-type]


TONES = ((31.0, 0.3, 0.2j), (97.0, 0.1j, 0.4), (211.0, 0.2, 0.1), (386.0, 0.5, 0.3j))
"""Frequency [Hz] and amplitudes of force x and torque y."""


def series(rate: float) -> SampledSignal:
    """The tones as a record of 10 s of the given rate, a whole number of periods."""
    t = np.arange(round(10 * rate)) / rate
    values = np.zeros((t.size, 6))
    for hz, force, torque in TONES:
        turning = np.exp(2j * np.pi * hz * t)
        values[:, 0] += (force * turning).imag
        values[:, 4] += (torque * turning).imag
    return SampledSignal(values, rate, DT)


def exact_tones() -> ToneSignal:
    amplitude = np.zeros((len(TONES), 6), complex)
    amplitude[:, 0], amplitude[:, 4] = [a for _, a, _ in TONES], [b for _, _, b in TONES]
    return ToneSignal(2 * np.pi * np.array([hz for hz, _, _ in TONES]), amplitude, DT)


@pytest.fixture(scope="module")
def reference(family: simulation.PlantFamily) -> FloatArray:
    """Response to the tones by the phasors of the plant, which are exact at every frequency."""
    rows = []
    for hz, force, torque in TONES:
        amplitude = np.zeros(22, complex)
        amplitude[5], amplitude[9] = force, torque
        rows.append((2 * np.pi * hz, *amplitude.real, *amplitude.imag))
    config = replace(QUIET, disturbance=True, scenario="worst_case", tones=tuple(rows))
    return truth(family.build(config, np.zeros(family.control_loop.order)), 1500)


@pytest.mark.parametrize(
    ("signal", "tolerance"),
    [
        (exact_tones, 1e-7),
        (lambda: series(2000.0), 1e-6),
        (lambda: series(1024.0), 1e-6),
        (lambda: series(997.3), 1e-6),
    ],
    ids=["tones", "2000 Hz", "1024 Hz", "997.3 Hz"],
)
def test_the_response_is_that_of_exact_tones(
    family: simulation.PlantFamily,
    reference: FloatArray,
    monkeypatch: pytest.MonkeyPatch,
    signal: Callable[[], object],
    tolerance: float,
) -> None:
    monkeypatch.setattr(placed, "FADE", 0.0)
    found = truth(driven(family, source(signal())), len(reference))
    assert np.abs(found - reference).max() < tolerance * np.abs(reference).max()


def test_what_is_above_half_of_the_tick_rate_does_not_fold_back() -> None:
    rate = 4096.0
    t = np.arange(round(5 * rate)) / rate
    high = SampledSignal(np.sin(2 * np.pi * 700.0 * t)[:, None] * np.ones(6), rate, DT)
    low = SampledSignal(np.sin(2 * np.pi * 300.0 * t)[:, None] * np.ones(6), rate, DT)
    seen = [np.abs([one.tick(k, INSTANTS) for k in range(1000, 1100)]).max() for one in (high, low)]
    assert seen[0] < 1e-6 and seen[1] > 0.99


def test_frames_and_offsets() -> None:
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    force_x = np.eye(6)[0]
    wrench = place_matrix("bus", PARAMETERS, turn, np.array([0.0, 2.0, 0.0])) @ force_x
    found = wrench[port_slices(source_ports(PARAMETERS))["external_wrench"]]
    assert np.allclose(found, [0.0, 1.0, 0.0, 0.0, 0.0, -2.0])  # along y of the body; torque = 2 e_y x e_x, turned
    own, body = (place_matrix("wheel_1", PARAMETERS, frame) for frame in (None, np.eye(3)))
    assert np.allclose(np.linalg.norm(own[:, :3], axis=0), 1.0) and not np.allclose(own, body)
    assert np.allclose(own.T @ own, np.eye(6)) and np.allclose(body.T @ body, np.eye(6))
    for place, options, message in (
        ("moon", {}, "place must be one of bus"),
        ("bus", {"frame": 2 * np.eye(3)}, "frame must be a rotation"),
        ("drive_1", {"offset": np.zeros(3)}, "must be absent at drive_1"),
    ):
        with pytest.raises(ValueError, match=message):
            place_matrix(place, PARAMETERS, **options)
    places = all_places(PARAMETERS)
    assert len(set(places)) == len(places) == 15


def test_noise_has_the_density_that_was_asked_for() -> None:
    frequency, density = np.array([2.0, 20.0, 300.0]), np.zeros((3, 6))
    density[:, 0], density[:, 4] = (4.0, 4.0, 0.04), (0.0, 1.0, 1.0)
    one = noise_of_density(frequency, density, 100.0, DT, np.random.default_rng(4))
    found, power = spectra.welch(one.values[:, 0], one.rate, nperseg=4096)
    for hz, expected in ((10.0, 4.0), (77.46, 0.4), (200.0, 0.04 * 1.5 ** (np.log(100.0) / np.log(15.0)))):
        near = np.abs(found - hz) < 3.0
        assert power[near].mean() == pytest.approx(expected, rel=0.25)
    assert one.values[:, 0].var() == pytest.approx(np.trapezoid(power, found), rel=0.05)
    assert power[found > 310.0].max() < 1e-6 and not one.values[:, 1].any()
    assert abs(np.corrcoef(one.values[:, 0], one.values[:, 4])[0, 1]) < 0.02


def test_pulses_have_their_impulse_and_end() -> None:
    wrench = np.array([2.0, 0, 0, 0, 0, 0])
    one = PulseSignal(wrench, first=0.0104, width=0.0303, period=0.5, last=1.2, dt=DT)
    given = np.array([one.tick(k, INSTANTS)[0, 0] for k in range(3000)])
    assert given.sum() * DT == pytest.approx(3 * 2.0 * 0.0303, rel=1e-9)
    assert given[:10].max() == 0.0 and given[10] == pytest.approx(2.0 * 0.6) and given.max() == pytest.approx(2.0)


def test_the_line_of_a_cooler_has_the_width_that_was_asked_for() -> None:
    """The phase of a Lorentzian line of full width w spreads with the variance 2 pi w t."""
    rng = np.random.default_rng(1)
    ends = [PhaseNoise.of(0.2, 50.0, 2.0, rng).at(np.array([1.6]))[0][0] for _ in range(3000)]
    assert np.var(ends) == pytest.approx(2 * np.pi * 0.2 * 1.6, rel=0.1)


@pytest.mark.further
def test_the_force_of_a_moving_mass_is_the_second_derivative_of_its_displacement() -> None:
    """By central differences of the displacement, and no more momentum after any time than the mass can have."""
    omega, order = 2 * np.pi * 47.0, np.array([1.0, 2.0, 3.0])
    amplitude = np.zeros((3, 6), complex)
    amplitude[:, 2], amplitude[:, 3] = (0.08, 0.03j, 0.015), (0.01j, 0.0, 0.002)
    noise = PhaseNoise.of(0.5, 47.0, 40.0, np.random.default_rng(3))
    one = MovingMassSignal(omega, order, amplitude, DT, noise)
    step = 1e-5
    t = 7.0 + step * np.arange(40_000)
    phase = omega * t + noise.at(t)[0]
    moved = -np.imag(np.exp(1j * np.multiply.outer(phase, order)) @ (amplitude / np.square(order * omega)[:, None]))
    force = np.diff(moved, 2, axis=0) / step**2
    given = one.tick(0, t[1:-1] / DT)
    assert np.abs(given - force).max() < 1e-4 * np.abs(force).max()
    middle, weight = np.polynomial.legendre.leggauss(6)
    instants = 0.5 * (middle + 1.0)
    impulse = np.cumsum([0.5 * DT * weight @ one.tick(k, instants) for k in range(40_000)], axis=0)
    largest = 2.0 * (np.abs(amplitude) / (order * omega)[:, None]).sum(axis=0)
    assert (np.abs(impulse) <= 1.3 * largest + 1e-12).all()


def test_a_record_that_is_repeated_has_no_step() -> None:
    t = np.arange(4000) / 1000.0
    whole = repeated((t + np.sin(9 * t))[:, None] * np.ones(6), 1000.0)
    assert len(whole) == 3500
    assert abs(whole[0, 0] - whole[-1, 0]) < 0.05 and abs(t[-1] - t[0]) > 3.9


def test_the_same_bits_after_a_reset_and_in_any_order(family: simulation.PlantFamily) -> None:
    plant = driven(family, source(series(997.3)), source(exact_tones(), "payload"))
    first = truth(plant, 60)
    plant.reset()
    assert np.array_equal(truth(plant, 60), first)
    one, other = series(1024.0), series(1024.0)
    later = [one.tick(k, INSTANTS) for k in (5, 900, 3)]
    assert all(np.array_equal(a, other.tick(k, INSTANTS)) for a, k in zip(later, (5, 900, 3)))
    assert plant.tones == pytest.approx(2 * np.pi * np.array([hz for hz, _, _ in TONES]))


def noise(frequency: list[float], density: list[float], seconds: float = 100.0) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies and density of noise that is made of the rows, with the lowest frequencies resolved."""
    table = np.zeros((len(frequency), 6))
    table[:, 4] = density
    one = noise_of_density(np.array(frequency), table, seconds, DT, np.random.default_rng(4))
    return spectra.welch(one.values[:, 4], one.rate, nperseg=8192)


def test_the_row_at_0_hz_changes_little_where_the_next_row_is_near() -> None:
    near, far = (noise([first, 0.02, 40.0], [4.0, 4.0, 4.0])[1] for first in (0.0, 0.01))
    assert near.sum() == pytest.approx(far.sum(), rel=0.1)


@pytest.mark.parametrize("first", [0.0, 1.0, 4.0, 100.0])
def test_the_first_segment_is_straight_on_linear_axes_whatever_the_length_of_the_run(first: float) -> None:
    """The row at 0 Hz of a Welch table is little but the mean: it must not count more in a shorter run."""
    expected = 40.0 * (first + 4.0) / 2
    for seconds in (5.0, 100.0):
        found, power = noise([0.0, 40.0], [first, 4.0], seconds)
        assert np.trapezoid(power, found) == pytest.approx(expected, rel=0.15)


def test_rows_below_the_lowest_frequency_of_a_short_run_do_no_harm() -> None:
    found, power = noise([0.0, 1e-4, 40.0], [4.0, 4.0, 4.0], 20.0)
    assert np.isfinite(power).all()
    assert power[(found > 0.5) & (found < 39.0)].mean() == pytest.approx(4.0, rel=0.2)
