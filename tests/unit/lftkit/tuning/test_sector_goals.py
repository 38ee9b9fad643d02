"""Passivity and conic sectors against closed forms, as values of the certificate and as goals of the tuner."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import linalg, optimize

from lftkit.analysis.norms import hinf_norm
from lftkit.systems.connection.filters import transfer
from lftkit.systems.system import System
from lftkit.tuning import (
    ConicSector,
    Goal,
    HinfGain,
    Passivity,
    TuningOptions,
    WorstCaseOptions,
    certify,
    gain,
    state_space,
    tune,
    worst_case,
)
from lftkit.tuning.goals import resolved
from lftkit.tuning.problem import Problem
from lftkit.tuning.robust.closed_loop_evaluator import ClosedLoopEvaluator

NOTHING = System.static(np.zeros((0, 0)), [], [])
LAG = transfer([1.0], [1.0, 1.0])


def value(goal: Goal, channel: System) -> float:
    """Value of a goal for a channel that no controller changes; the evaluator of worst cases must agree."""
    (ready,), needs = resolved([channel], [goal])
    certificate = certify([ready], NOTHING, needs, rtol=1e-9)
    evaluated = ClosedLoopEvaluator(ready, NOTHING).values(needs)[0].item()
    assert evaluated == pytest.approx(certificate.values.item(), rel=1e-4)
    return float(certificate.values.item())


def test_a_lag_is_passive_and_two_lags_are_not() -> None:
    """1/(s+1): |s/(s+2)|, at most 1. 1/(s^2+s+1): |F|^2 = (u^2+u)/(u^2-3u+4), u = w^2, largest at u = 1 + sqrt 2."""
    assert value(Passivity("in", "out"), LAG) == pytest.approx(1.0, abs=1e-9)
    root = np.sqrt(2.0)
    expected = np.sqrt((4.0 + 3.0 * root) / (4.0 - root))
    assert value(Passivity("in", "out"), transfer([1.0], [1.0, 1.0, 1.0])) == pytest.approx(expected, rel=1e-8)


@pytest.mark.parametrize("unit", [0.1, 1.0, 20.0])
def test_indices_are_those_of_the_closed_forms(unit: float) -> None:
    """Re (1/(s+1) + 0.3) is at least 0.3; with s shifted by a, 1/(s+a) has Re (1/T) = a: z'w >= a z'z."""
    shifted = System(LAG.A, LAG.B, LAG.C, [[0.3]], LAG.inputs, LAG.outputs)
    assert value(Passivity("in", "out", input_index=0.3, unit=unit), shifted) == pytest.approx(1.0, abs=1e-9)
    assert value(Passivity("in", "out", input_index=0.29, unit=unit), shifted) < 1.0
    assert value(Passivity("in", "out", input_index=0.31, unit=unit), shifted) > 1.0 + 1e-4
    slow = transfer([1.0], [1.0, 0.7])
    assert value(Passivity("in", "out", output_index=0.7, unit=unit), slow) == pytest.approx(1.0, abs=1e-9)
    assert value(Passivity("in", "out", output_index=0.71, unit=unit), slow) > 1.0 + 1e-4


def random_channel(seed: int, size: int = 3, order: int = 6) -> System:
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((order, order))
    A -= (linalg.eigvals(A).real.max() + 0.2) * np.eye(order)
    matrices = (rng.standard_normal(shape) for shape in ((order, size), (size, order), (size, size)))
    return System(A, *matrices, [("in", size)], [("out", size)])


@pytest.mark.parametrize("seed", range(3))
def test_a_conic_sector_is_a_gain_after_a_loop_transformation(seed: int) -> None:
    channel, low, high = random_channel(seed), -1.5, 4.0
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    expected = hinf_norm(channel.A, channel.B, channel.C, channel.D - middle * np.eye(3), rtol=1e-9).value / half
    assert value(ConicSector("in", "out", low, high), channel) == pytest.approx(expected, rel=1e-7)


@pytest.mark.parametrize("seed", range(3))
def test_indices_change_sign_where_the_smallest_eigenvalue_of_the_form_does(seed: int) -> None:
    """The largest index nu of ``T + T^H - 2 nu``, found on a dense grid, divides values below and above 1."""
    channel = random_channel(seed)
    omega = np.concatenate([[0.0], np.geomspace(1e-3, 1e3, 4000)])
    T = channel.D + channel.C @ linalg.inv(1j * omega[:, None, None] * np.eye(6) - channel.A) @ channel.B
    least = float(np.array([linalg.eigvalsh(0.5 * (t + t.conj().T))[0] for t in T]).min())
    assert value(Passivity("in", "out", input_index=least - 0.02), channel) < 1.0
    assert value(Passivity("in", "out", input_index=least + 0.02), channel) > 1.0
    assert value(ConicSector("in", "out", least - 0.02, np.inf), channel) < 1.0
    assert value(ConicSector("in", "out", least + 0.02, np.inf), channel) > 1.0


def test_one_sided_sectors_are_those_of_the_shifted_channel() -> None:
    channel = random_channel(5)
    turned = System(channel.A, channel.B, -channel.C, 2.0 * np.eye(3) - channel.D, channel.inputs, channel.outputs)
    assert value(ConicSector("in", "out", -np.inf, 2.0), channel) == pytest.approx(
        value(Passivity("in", "out"), turned)
    )


def test_only_frequencies_of_the_band_count() -> None:
    """1/(s^2+s+1): Re T = (1-u)/|..|^2 is positive below 1 rad/s."""
    channel = transfer([1.0], [1.0, 1.0, 1.0])
    assert value(Passivity("in", "out", band=(0.0, 0.99)), channel) < 1.0
    assert value(Passivity("in", "out", band=(0.0, 1.01)), channel) > 1.0
    assert value(Passivity("in", "out", band=(1.1, 100.0)), channel) > 1.0


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("size", [1, 2, 3])
def test_gradients_are_differences(seed: int, size: int) -> None:
    channel, rng = random_channel(seed, size, 5), np.random.default_rng(seed + 50)
    columns, rows = rng.standard_normal((5, 2)), rng.standard_normal((2, 5))
    D = linalg.block_diag(channel.D, np.zeros((2, 2)))
    model = System(
        channel.A, np.hstack([channel.B, columns]), np.vstack([channel.C, rows]), D,
        [("w", size), ("u", 2)], [("z", size), ("y", 2)],
    )  # fmt: skip
    goals = [Passivity("w", "z", 0.2, 0.1, unit=1.5), ConicSector("w", "z", low=-1.0, name="sector")]
    (ready,), needs = resolved([model], goals)
    problem = Problem([ready], needs, state_space([("y", 2)], [("u", 2)], 1))
    x = 0.05 * rng.standard_normal(problem.structure.size)
    x[0] = -1.0
    found = problem.evaluate(x)
    assert found.abscissa < 0.0
    for i in range(2):
        piece = max((p for p in found.pieces if p.requirement == i), key=lambda p: p.value, default=None)
        if piece is None:
            continue
        for k in range(len(x)):
            step = np.zeros(len(x))
            step[k] = 1e-6
            ends = [problem.evaluate(x + s * step, gradients=False).values[i, 0] for s in (-1.0, 1.0)]
            slope = (ends[1] - ends[0]) / 2e-6
            assert piece.gradient[k] == pytest.approx(slope, rel=2e-4, abs=2e-5 * np.abs(piece.gradient).max())


def test_a_hard_sector_is_kept_where_it_costs_performance() -> None:
    """T = 1/(s + 1 - k) for u = k y, largest at 0, where the mismatch T - 2.5 wants more than the edge of 2."""
    A, B = [[-1.0]], [[1.0, 1.0]]
    C, D = [[1.0], [1.0], [1.0]], [[0.0, 0.0], [-2.5, 0.0], [0.0, 0.0]]
    model = System(A, B, C, D, [("w", 1), ("u", 1)], [("z", 1), ("mismatch", 1), ("y", 1)])
    goals = [
        HinfGain("w", "mismatch", band=(0.0, 1e-3), name="mismatch"),
        ConicSector("w", "z", low=-1.0, high=2.0, hard=True),
    ]
    options = TuningOptions(starts=1, seed=0)
    result = tune([model], goals, gain([("y", 1)], [("u", 1)]), options=options)
    assert str(result.status) == "converged"
    assert result.controller.D.item() == pytest.approx(0.5, abs=1e-4)
    assert result.hard == pytest.approx(1.0, abs=5e-5)
    assert result.certificate is not None
    assert np.all(result.certificate.upper >= result.certificate.values)


def driven(output: list[float], feedthrough: float = 0.0) -> System:
    """x'' = -x - x'/5 + w + u, z = output x (+ feedthrough w); noise on x and x', which are measured; u is seen."""
    A, B = [[0.0, 1.0], [-1.0, -0.2]], [[0.0, 0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 1.0]]
    C = [output, [0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]
    D = np.zeros((4, 4))
    D[0, 0], D[1, 3], D[2, 1], D[3, 2] = feedthrough, 1.0, 1.0, 1.0
    return System(A, B, C, D, [("w", 1), ("noise", 2), ("u", 1)], [("z", 1), ("effort", 1), ("y", 2)])


QUIET = HinfGain("noise", "effort", band=(0.0, 1e-3), name="effort")
FEEDBACK = gain([("y", 2)], [("u", 1)])


def test_a_channel_is_made_passive_by_the_least_feedback() -> None:
    """T = 1/10 + 1/(s^2 + c s + k): Re T is least at w^2 = k + c sqrt k, and at least 0 where c^2 + 2 c sqrt k >= 10.

    The effort at frequency 0 is |(k1, k2)| / k.
    """
    goals = [QUIET, Passivity("w", "z", hard=True)]
    result = tune([driven([1.0, 0.0], 0.1)], goals, FEEDBACK, options=TuningOptions(starts=2, seed=0))
    assert str(result.status) == "converged" and result.feasible
    k1, k2 = result.controller.D[0]
    c, k = 0.2 - k2, 1.0 - k1
    assert c**2 + 2.0 * c * np.sqrt(k) == pytest.approx(10.0, rel=1e-4)

    def effort(stiffness: float) -> float:
        damping = np.sqrt(stiffness + 10.0) - np.sqrt(stiffness)
        return float(np.hypot(1.0 - stiffness, 0.2 - damping) / stiffness)

    least = optimize.minimize_scalar(effort, bounds=(0.1, 100.0), method="bounded", options={"xatol": 1e-10})
    assert result.soft == pytest.approx(least.fun, rel=1e-3)
    assert result.certificate is not None
    assert np.all(result.certificate.upper >= result.certificate.values)


def test_worst_parameters_of_passivity_are_found() -> None:
    """(s + a)/(s^2 + c s + 1) is passive for a <= c only: worst at the largest a and the smallest c."""

    def build(p: Any) -> System:
        return transfer([1.0, p["a"]], [1.0, p["c"], 1.0])

    options = WorstCaseOptions(samples=20, climbs=1, seed=0)
    (found,) = worst_case(build, {"a": (0.2, 0.6), "c": (0.5, 1.0)}, NOTHING, [Passivity("in", "out")], options=options)
    assert found.value > 1.0
    assert found.parameters == pytest.approx({"a": 0.6, "c": 0.5})
    (within,) = worst_case(
        build, {"a": (0.2, 0.5), "c": (0.5, 1.0)}, NOTHING, [Passivity("in", "out")], options=options
    )
    assert within.value == pytest.approx(1.0, abs=1e-6)
