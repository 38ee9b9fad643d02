"""Statuses with advice, hard requirements, starts, seeds, limits."""

from __future__ import annotations

import numpy as np
import pytest
from support.counted_time import Clock, counted_evaluations
from support.tuned_plants import STATIC, double_integrator, first_order, lag, tuned_plant

from lftkit.systems.system import System
from lftkit.tuning import HinfGain, TuningOptions, TuningRequirement, TuningResult, tune
from lftkit.tuning.certificate import certify
from lftkit.tuning.published_plants import published_plant
from lftkit.tuning.requirements import ControllerPoles, H2Gain
from lftkit.tuning.status import TuningStatus
from lftkit.tuning.structures.stable_state_space import StableStateSpace
from lftkit.tuning.structures.structures import gain_matrix_of, state_space

GAIN = HinfGain("w", "z")
ONE = TuningOptions(starts=0)
"""The given start alone: a random one is preceded by those of full order."""


def descent(plant: System, *needs: TuningRequirement, **more: float) -> TuningResult:
    """From the gain -1/2."""
    return tune([plant], needs, STATIC, initial=[[-0.5]], options=ONE, **more)


def published(name: str, order: int = 0, initial: object = (), **options: object) -> TuningResult:
    """The H-infinity problem of a published plant."""
    plant = published_plant(name)
    structure = state_space([plant.outputs[1]], [plant.inputs[1]], order)
    return tune([plant], [GAIN], structure, initial=initial, options=TuningOptions(**options))  # type: ignore[arg-type]


UNDAMPED = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, -1]])


@pytest.mark.parametrize(
    ("plant", "abscissa", "advice"),
    [
        (double_integrator(), 0.0, "raise the order"),
        (tuned_plant(UNDAMPED, [[0, 0], [1, 0], [1, 1]], [[1, 0, 1]] * 2), 0.0, "the commands do not reach it"),
        (tuned_plant([[1, 0], [0, -1]], np.eye(2), np.ones((2, 2))), 1.0, "the commands do not reach it"),
    ],
    ids=["no damping by position", "an undamped mode out of reach", "an unstable pole out of reach"],
)
def test_what_no_gain_stabilises_is_said(plant: System, abscissa: float, advice: str) -> None:
    result = tune([plant], [GAIN], STATIC, options=TuningOptions(starts=2, iterations=20))
    assert result.status is TuningStatus.NOT_STABILISED and result.certificate is None and result.soft == np.inf
    assert result.abscissa == pytest.approx(abscissa, abs=1e-6) and advice in result.advice


def test_many_models_share_one_controller() -> None:
    models = [lag(p, name=f"pole {p}") for p in (-2.0, 0.5, 1.0)]
    hard = HinfGain("w", "effort", bound=1.25, hard=True)
    result = tune(models, [HinfGain("w", "z", bound=0.1), hard], STATIC, initial=[[-3.0]], options=ONE)
    # worst effort k / (k - 1) needs k >= 5, and any larger gain is better: the infimum of the soft value is zero
    assert result.values.shape == (2, 3)
    assert result.soft < 1e-6 and result.hard <= 1.0 + 1e-6
    assert result.certificate is not None and result.certificate.stable


def test_h2_optimum_is_the_lqg_cost() -> None:
    """u = k y on 1 / (s + 1), z and effort to white noise: min (1 + k^2) / (2 (1 + k)), at k = sqrt(2) - 1."""
    result = descent(lag(), H2Gain("w", ("z", "effort")))
    k = np.sqrt(2) - 1
    assert result.soft**2 == pytest.approx((1 + k * k) / (2 * (1 + k)), rel=1e-6)
    assert result.controller.D.item() == pytest.approx(-k, rel=1e-2)


def test_stabilises_what_a_dynamic_controller_can() -> None:
    structure = state_space([("y", 1)], [("u", 1)], 1)
    result = tune([double_integrator()], [GAIN], structure, options=TuningOptions(starts=4, target=1e6))
    assert result.abscissa < 0 and np.isfinite(result.soft)


def test_interrupt_keeps_the_best_point(monkeypatch: pytest.MonkeyPatch) -> None:
    from lftkit.tuning.problem import Problem

    calls = {"n": 0}
    true = Problem.evaluate

    def counted(self: Problem, x: np.ndarray, **more: object) -> object:
        calls["n"] += 1
        if calls["n"] == 6:
            raise KeyboardInterrupt
        return true(self, x, **more)  # type: ignore[arg-type]

    monkeypatch.setattr(Problem, "evaluate", counted)
    result = published("AC4", starts=1)
    assert result.status == "interrupted"
    assert np.isfinite(result.soft) and result.certificate is not None and result.certificate.stable


def test_same_seed_same_bits_and_workers_change_nothing() -> None:
    structure = StableStateSpace([("y", 1)], [("u", 1)], 1)  # type: ignore[arg-type]

    def run(workers: int = 1, seed: int = 7, **limits: float) -> tuple[bytes, tuple[float, ...]]:
        options = TuningOptions(starts=2, seed=seed, workers=workers, iterations=1, tolerance=0.1, **limits)
        result = tune([lag()], [GAIN, HinfGain("w", "effort")], structure, options=options)
        return result.x.tobytes(), result.starts

    assert run() == run(workers=2), "processes give the same bits"
    first, other = (run(seed=seed, target=1e6)[0] for seed in (7, 8))
    assert first != other, "random starts that meet the target are the result, and those of another seed are others"


@pytest.mark.further
def test_given_start_is_used_and_never_made_worse() -> None:
    first = published("AC4", starts=1)
    assert first.status is TuningStatus.CONVERGED and first.certificate is not None
    assert first.values.tolist() == first.certificate.values.tolist()
    assert first.certificate.values.max() == pytest.approx(first.soft, rel=1e-3)
    assert first.certificate.upper.max() == pytest.approx(first.soft, rel=1e-3), "converged means certified"
    again = published("AC4", initial=[first.x], starts=0)
    (start,) = again.starts
    assert again.soft <= start, "not worse than the value of the start itself"
    assert start == pytest.approx(first.soft, rel=1e-9), "which is found again as far as a search locates its peak"


def test_stable_controller_on_request() -> None:
    """By structure or by requirement; p(K) of a plant that would like an unstable one stays stable."""
    by_structure = StableStateSpace([("y", 1)], [("u", 1)], 2, min_decay=0.01)  # type: ignore[arg-type]
    options = TuningOptions(starts=1, target=1e6)
    a = tune([double_integrator()], [GAIN], by_structure, options=options)
    assert np.linalg.eigvals(a.controller.A).real.max() <= -0.01
    free = state_space([("y", 1)], [("u", 1)], 2)
    b = tune([double_integrator()], [GAIN, ControllerPoles(min_decay=0.01)], free, options=options)
    assert b.feasible and np.linalg.eigvals(b.controller.A).real.max() <= -0.01 * (1 - 1e-6)


def test_delay_limits_the_gain() -> None:
    """k / s with a delay T: the smallest peak of the disturbance response 1 / (s + k e^{-sT}) needs a finite k."""
    result = descent(first_order(0.0), GAIN, loop_delay=0.5)
    k = -result.controller.D.item()
    w = np.geomspace(1e-3, 1e2, 20001)
    peaks = {g: np.abs(1 / (1j * w + g * np.exp(-0.5j * w))).max() for g in np.linspace(0.3, 2.5, 221)}
    best = min(peaks, key=peaks.__getitem__)
    assert k == pytest.approx(best, abs=0.02)
    assert result.soft == pytest.approx(peaks[best], rel=1e-4)
    assert result.certificate is not None and result.certificate.values.max() == pytest.approx(result.soft, rel=1e-4)


def test_certificate_is_independent_and_sees_a_wrong_controller() -> None:
    found = certify([lag()], System.static([[3.0]], [("y", 1)], [("u", 1)]), [GAIN])
    assert not found.stable and found.values[0, 0] == np.inf


def test_gain_matrix_of_round_trips() -> None:
    model = System([[-1, 2], [0, -3]], [[1], [2]], [[3, 4]], [[5]], [("y", 1)], [("u", 1)])
    structure = state_space([("y", 1)], [("u", 1)], 2)
    assert np.array_equal(structure.gain_matrix(structure.parameters_of(model)), gain_matrix_of(model))


@pytest.mark.further
def test_starts_that_agree_end_a_search() -> None:
    """Those of a convex problem end at one value: no further ones are begun."""
    result = published("AC17", gap=0.0)
    assert 1 < len(result.starts) < 24 and max(result.starts) <= min(result.starts) * (1.0 + 1e-3)


@pytest.mark.further
def test_few_starts_that_agree_run_to_their_end_once() -> None:
    """A convex problem: two more starts cost two smooth phases."""
    one, three = (published("AC17", starts=starts, gap=0.0) for starts in (1, 3))
    assert one.status == three.status == "converged" and three.soft == pytest.approx(one.soft, rel=1e-9)
    assert three.evaluations < 1.3 * one.evaluations


def test_search_ends_where_the_value_vanishes() -> None:
    """AC1: the disturbance can be rejected completely."""
    result = published("AC1")
    assert result.soft < 1e-6
    assert len(result.starts) <= 4, "no random start after that"


def test_the_order_that_is_asked_for_is_looked_at_first() -> None:
    """Its first random start meets the target: none of a lower order is begun."""
    result = published("HE1", 1, target=10.0)
    assert result.status == "target" and len(result.starts) == 1


@pytest.mark.parametrize("kind", ["soft gains", "a hard limit"])
def test_out_of_time_is_said_when_the_time_is_over(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not when a part of it is that one order was given: the orders below it have the rest. Time is evaluations."""
    clock, limit = Clock(), 100.0
    counted_evaluations(clock, monkeypatch)
    plant = published_plant("HE1")
    needs = [GAIN, *([ControllerPoles(min_decay=1e-3, hard=True)] if kind == "a hard limit" else [])]
    structure = state_space([plant.outputs[1]], [plant.inputs[1]], 3)
    result = tune([plant], needs, structure, options=TuningOptions(wall_limit=limit))
    assert result.status == "out_of_time" and clock.now > 0.95 * limit
