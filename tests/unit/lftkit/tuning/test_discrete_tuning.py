"""Tuning of discrete loops: known optima, a scan of all gains, the image of a system, what is refused."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy import linalg
from support.tuned_plants import STATIC, first_order, tuned_plant

from lftkit import hinf_norm
from lftkit.systems.connection.feedback import close_loop
from lftkit.systems.sampled.image import image_of
from lftkit.systems.system import System
from lftkit.tuning import (
    ClosedLoopPoles,
    ConicSector,
    Decentralised,
    Goal,
    H2Gain,
    HinfGain,
    LoopShape,
    Margins,
    MaxLoopGain,
    MinLoopGain,
    Overshoot,
    Sensitivity,
    StepTracking,
    TuningOptions,
    TuningRequirement,
    gain,
    pid,
    state_space,
    tune_discrete,
    worst_case,
)
from lftkit.tuning.certificate import certify
from lftkit.tuning.goals.goal import resolved
from lftkit.tuning.structures.on_image import StructureOnImage
from lftkit.tuning.structures.structures import Structure, controller

OPTIONS = TuningOptions(starts=0)


def delayed_lag(dt: float = 0.1) -> System:
    """x+ = 0.9 x + w + u one sample late; y = x, z = (x, u / 2)."""
    A, B = [[0.9, 1.0], [0.0, 0.0]], np.eye(2)
    C, D = [[1.0, 0.0], [0.0, 0.0], [1.0, 0.0]], [[0.0, 0.0], [0.0, 0.5], [0.0, 0.0]]
    return System(A, B, C, D, [("w", 1), ("u", 1)], [("z", 2), ("y", 1)], dt=dt)


def norm_with(plant: System, K: System) -> float:
    return hinf_norm(*close_loop(plant, K, ["w"], ["z"]).matrices, dt=plant.dt).value


@cache
def scanned() -> float:
    """Least norm over static gains of `delayed_lag`: a scan, and one with smaller steps about its best gain."""
    plant, ports = delayed_lag(), ([("y", 1)], [("u", 1)])

    def norm(k: float) -> float:
        return norm_with(plant, System.static([[k]], *ports))

    best = min(np.linspace(-0.95, 0.05, 41), key=norm)
    return min(map(norm, best + np.linspace(-0.025, 0.025, 41)))


def test_no_gain_of_a_scan_is_better() -> None:
    plant = delayed_lag()
    result = tune_discrete([plant], [HinfGain("w", "z")], STATIC, initial=[[-0.1]], options=OPTIONS)
    best = scanned()
    assert str(result.status) == "converged"
    assert result.soft == pytest.approx(best, rel=1e-4) and result.soft < 1.0005 * best
    assert result.soft == pytest.approx(norm_with(plant, result.controller), rel=1e-5)
    assert 0.0 <= result.peak_frequencies.max() <= np.pi / plant.dt


def test_a_controller_with_a_state_gains_what_the_gain_cannot() -> None:
    """Initial and final parameters are those of discrete controllers."""
    plant, structure = delayed_lag(), state_space([("y", 1)], [("u", 1)], 1)
    start = System([[-0.2]], [[0.1]], [[0.1]], [[-0.4]], [("y", 1)], [("u", 1)])
    options = TuningOptions(starts=0, iterations=60)
    result = tune_discrete(
        [plant], [HinfGain("w", "z")], structure, initial=[structure.parameters_of(start)], options=options
    )
    K = result.controller
    assert K.dt == plant.dt and result.soft < 0.99 * scanned()
    assert result.soft == pytest.approx(norm_with(plant, K), rel=1e-5)
    assert np.block([[K.A, K.B], [K.C, K.D]]) == pytest.approx(structure.gain_matrix(result.x), abs=1e-12)


def test_hard_gains_and_discrete_weights_hold_on_the_discrete_loop() -> None:
    plant = delayed_lag()
    lag = System([[0.5]], [[1.0]], [[0.5]], [[0.0]], [("in", 1)], [("out", 1)], dt=plant.dt)
    double = System.static(2.0 * np.eye(2), [("in", 2)], [("out", 2)])
    needs = [
        HinfGain("w", "z", weight_in=lag, weight_out=double, name="weighted"),
        HinfGain("w", "z", bound=4.0, hard=True, name="bound"),
    ]
    result = tune_discrete([plant], needs, STATIC, initial=[[-0.1]], options=OPTIONS)
    assert result.feasible and result.certificate is not None and result.certificate.stable
    loop = close_loop(plant, result.controller, ["w"], ["z"])
    theta = np.linspace(0.0, np.pi, 2001)
    gains = [np.linalg.norm(loop.C @ np.linalg.solve(np.exp(1j * t) * np.eye(2) - loop.A, loop.B), 2) for t in theta]
    weight = np.abs(0.5 / (np.exp(1j * theta) - 0.5)) * 2.0
    assert result.values[0, 0] == pytest.approx(np.max(gains * weight), rel=1e-4)
    assert 4.0 * result.values[1, 0] == pytest.approx(np.max(gains), rel=1e-4)


def held(k: float, goal: TuningRequirement | Goal, plant: System | None = None) -> float:
    """Value of a goal for u = k y on the discrete loop, which is that of the image that is tuned."""
    models, needs = resolved([plant or first_order(0.5, 0.1)], [goal])
    dt = models[0].dt
    K = System.static([[k]], [("y", 1)], [("u", 1)])
    found = certify(models, replace(K, dt=dt), needs)
    image = certify([image_of(models[0])], K, [r.on_image(models[0]) for r in needs])
    assert found.stable and found.values == pytest.approx(image.values, rel=2e-5)
    return float(found.values[0, 0])


@pytest.mark.parametrize("k", [-0.5, -0.9])
def test_goals_of_a_lag_on_samples_are_those_of_closed_forms(k: float) -> None:
    """S = (z - 0.5) / (z - 0.5 - k), from w to x 1 / (z - 0.5 - k): all extremes are at z = 1 or z = -1."""
    ends = np.array([1.0, -1.0])
    S, T = (ends - 0.5) / (ends - 0.5 - k), -k / (ends - 0.5 - k)
    gain_ = 1.0 / (ends - 0.5 - k)
    assert held(k, Sensitivity("u")) == pytest.approx(abs(S).max(), rel=1e-5)
    assert held(k, Sensitivity("u", complementary=True)) == pytest.approx(abs(T).max(), rel=1e-5)
    margins = held(k, Margins("u", gain_margin=3.0))  # a disk of size 1
    assert margins == pytest.approx(abs(S - 0.5).max(), rel=1e-5)
    assert held(k, Overshoot("w", "z", percent=4.0)) == pytest.approx(abs(gain_).max(), rel=1e-5)
    sector = held(k, ConicSector("w", "z", low=-4.0, high=4.0))  # |gain| below 4
    assert sector == pytest.approx(abs(gain_).max() / 4.0, rel=1e-5)


def test_weights_of_goals_count_at_the_image_of_the_circle() -> None:
    """Loop shape of the discrete integrator whose image is the integrator of the crossover: exactly 1."""
    dt, crossover = 0.1, 2.0
    half = 0.5 * dt * crossover  # crossover / s is half (z + 1) / (z - 1)
    plant = System([[1.0]], [[2 * half]], [[1.0]], [[half]], [("u", 1)], [("y", 1)], dt=dt)
    assert held(-1.0, LoopShape("u", crossover), plant) == pytest.approx(1.0, rel=1e-3)
    assert held(-1.0, MinLoopGain("u", 0.5 * crossover), plant) < 0.51
    assert held(-1.0, MaxLoopGain("u", 0.5 * crossover), plant) == pytest.approx(2.0, rel=1e-3)


@pytest.mark.parametrize("k", [-0.2, -0.5, -0.9])
def test_variances_poles_and_bands_of_a_lag_on_samples_are_those_of_closed_forms(k: float) -> None:
    """x+ = (0.5 + k) x + w: noise of unit density has samples of variance 1 / T."""
    dt, pole = 0.1, 0.5 + k
    assert held(k, H2Gain("w", "z")) == pytest.approx(np.sqrt(1.0 / (1.0 - pole**2) / dt), rel=1e-9)
    rate = np.log(complex(pole) if pole else 1e-12) / dt
    poles = ClosedLoopPoles(min_decay=4.0, min_damping=0.3)
    wanted = max(2.0 + rate.real / 4.0, 2.0 - (-rate.real / abs(rate)) / 0.3)
    assert held(k, poles) == pytest.approx(wanted, rel=1e-9)
    z = np.exp(1j * dt * np.linspace(5.0, 20.0, 2001))
    band = HinfGain("w", "z", band=(5.0, 20.0))
    assert held(k, band) == pytest.approx(np.abs(1.0 / (z - pole)).max(), rel=1e-5)


def test_a_step_response_on_samples_is_compared_sample_by_sample() -> None:
    dt, tau, k = 0.1, 0.4, -0.3
    error, x = [], 0.0
    for number in range(400):
        error.append(x - (1.0 - np.exp(-number * dt / tau)))
        x = (0.5 + k) * x + 0.8  # the gain of the loop at rest is 1
    plant = tuned_plant([[0.5]], [[0.8, 1]], [[1], [1]], dt=dt)
    least = sum(np.exp(-2.0 * number * dt / tau) for number in range(400))
    wanted = np.sqrt(np.sum(np.square(error)) / least) / 0.1
    assert held(k, StepTracking("w", "z", time_constant=tau), plant) == pytest.approx(wanted, rel=5e-3)  # leak of 1e-3


def test_the_optimal_regulator_of_samples_is_found() -> None:
    """A measured state: the static gain of the discrete Riccati equation has the least variance."""
    A, B, dt, effort = np.array([[1.0, 0.1], [0.0, 0.9]]), np.array([[0.0], [0.1]]), 0.1, 0.3
    C, D = np.vstack([np.eye(2), np.zeros((1, 2)), np.eye(2)]), np.zeros((5, 3))
    D[2, 2] = effort
    plant = System(A, np.hstack([np.eye(2), B]), C, D, [("w", 2), ("u", 1)], [("z", 3), ("y", 2)], dt=dt)
    P = linalg.solve_discrete_are(A, B, np.eye(2), [[effort**2]])
    K = -np.linalg.solve(B.T @ P @ B + effort**2, B.T @ P @ A)
    result = tune_discrete(
        [plant], [H2Gain("w", "z")], gain([("y", 2)], [("u", 1)]), initial=[[-1.0, -1.0]], options=OPTIONS
    )
    assert str(result.status) == "converged"
    assert result.soft == pytest.approx(np.sqrt(np.trace(P) / dt), rel=1e-6)
    assert pytest.approx(K, rel=1e-2) == result.controller.D


def test_a_discrete_pid_is_the_continuous_one_by_the_trapezoidal_rule() -> None:
    dt, x = 0.1, [2.0, 0.5, 0.1]
    slow = controller(pid("y", "u", derivative_filter=0.03), x)
    fast = StructureOnImage(pid("y", "u", derivative_filter=0.03, dt=dt), dt).sampled(np.array(x))
    z = np.exp(1j * np.array([0.3, 1.0, 2.5]))
    here = [(fast.C @ np.linalg.solve(p * np.eye(2) - fast.A, fast.B) + fast.D).item() for p in z]
    there = [
        (slow.C @ np.linalg.solve(p * np.eye(2) - slow.A, slow.B) + slow.D).item() for p in 2 / dt * (z - 1) / (z + 1)
    ]
    assert here == pytest.approx(there, rel=1e-12)


def held_structures() -> list[Structure]:
    """A PID; a state space with fixed and bounded entries; both kinds side by side."""
    law = pid("y", "u", derivative_filter=0.3, dt=0.1)
    free = state_space([("y", 1)], [("v", 1)], 2).with_fixed({"A[0,1]": 0.3, "D[0,0]": 0.0})
    return [law, free.with_bounds({"A[0,0]": (-0.5, 0.5)}), Decentralised((law, free))]


@pytest.mark.parametrize("number", range(3))
def test_slopes_by_the_parameters_of_a_discrete_controller_are_differences(number: int) -> None:
    structure, rng = StructureOnImage(held_structures()[number], 0.1), np.random.default_rng(2)
    x = 0.3 * structure.start(rng)
    G = rng.standard_normal(structure.gain_matrix(x).shape)
    steps = 1e-6 * np.eye(len(x))
    change = [np.sum(G * (structure.gain_matrix(x + h) - structure.gain_matrix(x - h))) / 2e-6 for h in steps]
    assert structure.pullback(x, G) == pytest.approx(change, rel=1e-6)
    image, K = controller(structure, x), structure.sampled(x)
    for first, second in zip(image_of(K).matrices, image.matrices):
        assert second == pytest.approx(first, rel=1e-9, abs=1e-12)


def drawn_loop(rng: np.random.Generator) -> tuple[System, System]:
    """A stable discrete plant of order 3 and a static controller that keeps it stable."""
    while True:
        A = rng.normal(size=(3, 3))
        A *= 0.8 / np.abs(np.linalg.eigvals(A)).max()
        B, C, D = rng.normal(size=(3, 2)), rng.normal(size=(2, 3)), np.array([[0.3, 0.0], [0.0, 0.0]])
        plant = tuned_plant(A, B, C, D, dt=0.2)
        k = 0.2 * rng.normal()
        if np.abs(np.linalg.eigvals(A + k * B[:, 1:] @ C[1:])).max() < 0.95:
            return plant, System.static([[k]], [("y", 1)], [("u", 1)])


@pytest.mark.parametrize("seed", range(2))
def test_a_certificate_in_discrete_time_is_that_of_the_unit_circle(seed: int) -> None:
    """Against the response of the loop closed by hand on a fine grid, and its impulse response."""
    plant, K = drawn_loop(np.random.default_rng(seed))
    k, (A, B, C, D) = float(K.D.item()), plant.matrices
    closed = A + k * B[:, 1:] @ C[1:]
    angles = np.linspace(0.0, np.pi, 20_001)
    gains = [
        abs((C[:1] @ np.linalg.solve(np.exp(1j * t) * np.eye(3) - closed, B[:, :1]) + D[:1, :1]).item())
        for t in angles[::10]
    ]
    found = certify([plant], K, [HinfGain("w", "z"), H2Gain("w", "z"), ClosedLoopPoles(min_decay=1.0)])
    assert found.values[0, 0] >= max(gains) * (1.0 - 1e-9) and found.upper[0, 0] >= found.values[0, 0]
    assert found.values[0, 0] == pytest.approx(max(gains), rel=1e-3)
    assert found.peak_frequencies[0, 0] == pytest.approx(angles[::10][int(np.argmax(gains))] / 0.2, abs=0.05)
    impulse = [D[0, 0], *(float((C[:1] @ np.linalg.matrix_power(closed, n) @ B[:, :1]).item()) for n in range(800))]
    assert found.values[1, 0] == pytest.approx(np.sqrt(np.sum(np.square(impulse)) / 0.2), rel=1e-9)
    decay = float(np.log(np.abs(np.linalg.eigvals(closed)).max())) / 0.2
    assert found.abscissae[0] == pytest.approx(decay) and found.values[2, 0] == pytest.approx(2.0 + decay)


def test_a_worst_case_in_discrete_time_is_that_of_the_unit_circle() -> None:
    """x+ = a x + w: the largest gain 1 / (1 - |a|) is at z = 1 for a positive pole, at z = -1 for a negative one."""

    def build(values: Mapping[str, float]) -> System:
        return first_order(values["a"], 0.1)

    nothing = System.static([[0.0]], [("y", 1)], [("u", 1)])
    for box, at, omega in (((-0.5, 0.9), 0.9, 0.0), ((-0.9, 0.5), -0.9, np.pi / 0.1)):
        found, poles = worst_case(build, {"a": box}, nothing, [HinfGain("w", "z"), ClosedLoopPoles(min_decay=1.0)])
        assert found.value == pytest.approx(10.0) and found.parameters["a"] == pytest.approx(at)
        assert found.omega == pytest.approx(omega, abs=1e-6)
        assert poles.value == pytest.approx(2.0 + np.log(0.9) / 0.1, rel=1e-4)
