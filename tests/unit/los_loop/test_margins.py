"""Stability margins: changed loops against simulation, what a peak of sensitivity guarantees."""

from __future__ import annotations

import math

import numpy as np
import pytest
from small_loop import small_controllers, small_plant
from support.loop_rows import COMMANDS, loop_rows

from lftkit.arrays import FloatArray
from los_loop.closing import sampled_loop
from los_loop.control_laws import ControlLaws
from los_loop.margins import (
    GAINS,
    GuaranteedMargins,
    change_names,
    changed_loops,
    delayed,
    doubtful,
    scaled,
    unstable_changes,
)
from los_loop.sampled_loop import SampledLoop

TICKS = 400


def small_loop() -> SampledLoop:
    return sampled_loop(small_plant(), ControlLaws(*small_controllers(), "fsm+pma", loop_rows(20)))


def simulated(loop: SampledLoop, gains: np.ndarray, late: int) -> np.ndarray:
    """Line of sight from an initial state; commands multiplied and put into a queue by hand."""
    n = loop.plant_order
    V = slice(n, n + COMMANDS)
    rng = np.random.default_rng(0)
    state: FloatArray = np.zeros(loop.hold.shape[0])
    state[:n] = rng.standard_normal(n)
    queue = [np.zeros(COMMANDS)] * (late + 1)
    los = []
    for k in range(TICKS):
        state[V] = queue.pop(0)
        los.append(loop.truth @ state)
        state = (loop.hold if k % loop.frame_ticks else loop.frame) @ state
        queue.append(gains * state[V])
    return np.array(los)


def record(loop: SampledLoop, state: np.ndarray) -> np.ndarray:
    los = []
    for k in range(TICKS):
        los.append(loop.truth @ state)
        state = (loop.hold if k % loop.frame_ticks else loop.frame) @ state
    return np.array(los)


def test_changed_loops_are_those_of_a_simulation_with_a_queue() -> None:
    loop = small_loop()
    start = np.random.default_rng(0).standard_normal(loop.plant_order)
    gains = np.linspace(0.4, 1.8, COMMANDS)
    for changed, reference in (
        (scaled(loop, gains), simulated(loop, gains, 0)),
        (delayed(loop), simulated(loop, np.ones(COMMANDS), 1)),
        (delayed(delayed(loop)), simulated(loop, np.ones(COMMANDS), 2)),
    ):
        state = np.r_[start, np.zeros(changed.hold.shape[0] - start.size)]
        np.testing.assert_allclose(record(changed, state), reference, atol=1e-9 * np.abs(reference).max())


def test_every_channel_is_changed_alone_and_all_together() -> None:
    names = [name for name, _ in changed_loops(small_loop(), "fsm+pma")]
    assert len(names) == len(set(names)) == 1 + 2 * (1 + COMMANDS)
    assert {"one more tick", "gain x0.5", "gain x2", "gain x2 at force 6", "gain x0.5 at mirror 1"} <= set(names)
    assert len([name for name, _ in changed_loops(small_loop(), "fsm")]) == 1 + 2 * 3
    assert names == change_names("fsm+pma", COMMANDS)


def test_a_change_that_meets_the_critical_point_on_its_way_is_in_doubt() -> None:
    """Random return differences, moved so that they are singular for a part of a change."""
    rng, omega, stage = np.random.default_rng(3), 700.0, "fsm+pma"
    for change, name in enumerate(change_names(stage, COMMANDS)):
        for _ in range(20):
            L = rng.standard_normal((COMMANDS, COMMANDS)) + 1j * rng.standard_normal((COMMANDS, COMMANDS))
            way, D = rng.uniform(0.05, 1.0), np.ones(COMMANDS, complex)
            if change == 0:
                D *= np.exp(-1j * omega * 1e-3 * way)
            else:
                factor, only = (change - 1) // (COMMANDS + 1), (change - 1) % (COMMANDS + 1)
                D[slice(None) if only == 0 else only - 1] = 1.0 + way * (GAINS[factor] - 1.0)
            L -= np.diag(1.0 / D) * np.linalg.eigvals(np.eye(COMMANDS) + L * D)[0]
            sensitivity = np.linalg.inv(np.eye(COMMANDS) + L)
            assert np.abs(np.linalg.det(np.eye(COMMANDS) + L * D)) < 1e-8 * np.abs(np.linalg.det(np.eye(COMMANDS) + L))
            assert doubtful(sensitivity[None], omega, stage)[0, change], name


def test_a_loop_of_small_gain_leaves_no_doubt() -> None:
    L = 0.04 * np.random.default_rng(0).standard_normal((COMMANDS, COMMANDS))
    sensitivity = np.linalg.inv(np.eye(COMMANDS) + L)
    assert not doubtful(sensitivity[None].astype(complex), 700.0, "fsm+pma").any()


@pytest.mark.parametrize("stage", ["fsm", "fsm+pma"])
def test_doubt_is_that_of_the_eigenvalues_of_every_matrix(stage: str) -> None:
    """Sensitivities in radians and newtons, of all sizes: norms of powers in balanced units change no answer.

    That of a delay is the distance from zero of the return difference at 2000 delays up to a tick.
    """
    rng, size = np.random.default_rng(4), 2 if stage == "fsm" else COMMANDS
    units = np.repeat([1e-6, 1.0], [2, 6])
    S = rng.standard_normal((300, COMMANDS, COMMANDS)) + 1j * rng.standard_normal((300, COMMANDS, COMMANDS))
    S = np.eye(COMMANDS) + np.geomspace(1e-2, 1.0, 300)[:, None, None] * S * units[:, None] / units
    omega = rng.uniform(1.0, 3000.0, 300)
    expected = []
    for matrix, w in zip(S[:, :size, :size], omega):
        own, radii = np.diagonal(matrix), [np.abs(np.linalg.eigvals(matrix - k * np.eye(size))).max() for k in (1, 0)]
        T, raised = np.array([radii[0], *np.abs(own - 1.0)]), 0.5 * np.array([radii[1], *np.abs(own)])
        x = np.outer(np.exp(-1j * np.linspace(0.0, w * 1e-3, 2000)) - 1.0, np.linalg.eigvals(matrix - np.eye(size)))
        certain = 0.9 if w > 60.0 else 0.98
        late = np.abs(1.0 - x).min(axis=0) <= (1.0 - certain) * np.maximum(1.0, np.abs(x).max(axis=0))
        expected.append(np.concatenate([[late.any()], np.concatenate([0.5 * T, raised]) >= certain]))
    found = doubtful(S, omega, stage)
    np.testing.assert_array_equal(found, expected)
    assert 0 < found[:, 0].sum() < 300
    np.testing.assert_array_equal(found[7], doubtful(S[7:8], float(omega[7]), stage)[0])


def test_changes_that_make_the_loop_unstable_are_named() -> None:
    """A loop whose first command drives itself: x+ = 0.8 v, v+ = x diverges with a gain of 2 and with nothing else."""
    n = 1
    A = np.zeros((n + COMMANDS + 2, n + COMMANDS + 2))
    A[0, n], A[n, 0] = 0.8, 1.0
    zeros = np.zeros((A.shape[0], 22))
    loop = SampledLoop(A, A, zeros, zeros, np.zeros((2, A.shape[0])), n, loop_rows(2))
    assert loop.spectral_radius() == pytest.approx(math.sqrt(0.8))
    assert unstable_changes(loop, "fsm") == ["gain x2", "gain x2 at mirror 1"]


def test_margins_of_a_peak_of_two() -> None:
    margins = GuaranteedMargins(2.0, 1e-3)
    assert margins.gain_db == pytest.approx(6.0206, abs=1e-4)
    assert margins.phase_deg == pytest.approx(28.955, abs=1e-3)
    assert margins.to_mapping() == {"sensitivity": 2.0, "gain_db": 6.021, "phase_deg": 28.96, "delay_ms": 1.0}
    assert GuaranteedMargins(1.0, 1.0).gain_db == math.inf
