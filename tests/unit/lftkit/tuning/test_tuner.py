"""Statuses with advice, hard requirements, starts, seeds, limits."""

from __future__ import annotations

import time

import numpy as np
import pytest

from lftkit.systems.ports import Port
from lftkit.systems.system import System
from lftkit.tuning import HinfGain, TuningOptions, gain, tune
from lftkit.tuning.certificate import certify
from lftkit.tuning.published_plants import PLANTS, published_plant
from lftkit.tuning.requirements import ClosedLoopPoles, ControllerPoles, H2Gain
from lftkit.tuning.status import TuningStatus
from lftkit.tuning.structures.stable_state_space import StableStateSpace
from lftkit.tuning.structures.structures import gain_matrix_of, state_space


def lag(pole: float = -1.0, name: str = "lag") -> System:
    """1 / (s - pole) with the disturbance at its input; effort is the command."""
    D = [[0, 0], [0, 1], [0, 0]]
    return System(
        [[pole]], [[1, 1]], [[1], [0], [1]], D, [("w", 1), ("u", 1)], [("z", 1), ("effort", 1), ("y", 1)], name
    )


def integrators() -> System:
    """1 / s^2: no static gain of the position stabilises it."""
    A, B = [[0, 1], [0, 0]], [[0, 0], [1, 1]]
    return System(
        A, B, [[1, 0], [1, 0]], np.zeros((2, 2)), [("w", 1), ("u", 1)], [("z", 1), ("y", 1)], "double integrator"
    )


STATIC = gain([("y", 1)], [("u", 1)])
QUICK = TuningOptions(starts=1)


def test_hard_requirement_is_active_at_the_optimum() -> None:
    result = tune([lag()], [HinfGain("w", "z"), HinfGain("w", "effort", bound=0.8, hard=True)], STATIC, options=QUICK)
    assert result.status == "converged" and result.feasible
    # k / (1 + k) = 0.8 and 1 / (1 + k) = 0.2
    assert result.controller.D.item() == pytest.approx(-4.0, rel=1e-4)
    assert result.soft == pytest.approx(0.2, rel=1e-4)


def test_uncontrollable_undamped_mode_is_no_crash() -> None:
    """A mode on the axis that the command does not reach can never be stabilised."""
    A = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, -1]])
    plant = System(
        A,
        [[0, 0], [1, 0], [1, 1]],
        [[1, 0, 1], [1, 0, 1]],
        np.zeros((2, 2)),
        [("w", 1), ("u", 1)],
        [("z", 1), ("y", 1)],
    )
    result = tune([plant], [HinfGain("w", "z")], STATIC, options=TuningOptions(starts=1, iterations=20))
    assert result.status is TuningStatus.NOT_STABILISED and result.certificate is None


@pytest.mark.slow
def test_converged_means_certified_within_a_thousandth() -> None:
    plant = PLANTS["AC15"]()
    ports = {p.name: p for p in (*plant.inputs, *plant.outputs)}
    result = tune([plant], [HinfGain("w", "z")], gain([ports["y"]], [ports["u"]]), options=QUICK)
    assert result.certificate is not None
    if result.status is TuningStatus.CONVERGED:
        assert result.certificate.values.max() == pytest.approx(result.soft, rel=1e-3)
        assert result.certificate.upper.max() == pytest.approx(result.soft, rel=1e-3)
    assert result.status in (TuningStatus.CONVERGED, TuningStatus.STALLED, TuningStatus.ITERATIONS)


def test_many_models_share_one_controller() -> None:
    models = [lag(p, f"pole {p}") for p in (-2.0, 0.5, 1.0)]
    hard = HinfGain("w", "effort", bound=1.25, hard=True)
    result = tune(models, [HinfGain("w", "z", bound=0.1), hard], STATIC, options=QUICK)
    # worst effort k / (k - 1) needs k >= 5, and any larger gain is better: the infimum of the soft value is zero
    assert result.values.shape == (2, 3)
    assert result.soft < 1e-6 and result.hard <= 1.0 + 1e-6
    assert result.certificate is not None and result.certificate.stable


def test_h2_optimum_is_the_lqg_cost() -> None:
    """u = k y on 1 / (s + 1), z and effort to white noise: min (1 + k^2) / (2 (1 + k)), at k = sqrt(2) - 1."""
    plant = System(
        [[-1]], [[1, 1]], [[1], [0], [1]], [[0, 0], [0, 1], [0, 0]], [("w", 1), ("u", 1)], [("z", 2), ("y", 1)], "lqg"
    )
    result = tune([plant], [H2Gain("w", "z")], STATIC, options=QUICK)
    k = np.sqrt(2) - 1
    assert result.soft**2 == pytest.approx((1 + k * k) / (2 * (1 + k)), rel=1e-6)
    assert result.controller.D.item() == pytest.approx(-k, rel=1e-2)


def test_not_stabilised_says_what_to_do() -> None:
    result = tune([integrators()], [HinfGain("w", "z")], STATIC, options=TuningOptions(starts=2, iterations=40))
    assert result.status == "not_stabilised"
    assert "order" in result.advice and result.soft == np.inf and result.abscissa >= -1e-6
    assert result.certificate is None


def test_stabilises_what_a_dynamic_controller_can() -> None:
    structure = state_space([("y", 1)], [("u", 1)], 1)
    result = tune([integrators()], [HinfGain("w", "z")], structure, options=TuningOptions(starts=4, target=1e6))
    assert result.abscissa < 0 and np.isfinite(result.soft)


def test_unstabilisable_plant() -> None:
    """An unstable pole that the command does not reach."""
    A, B = [[1, 0], [0, -1]], [[1, 0], [0, 1]]
    plant = System(A, B, [[1, 1], [1, 1]], np.zeros((2, 2)), [("w", 1), ("u", 1)], [("z", 1), ("y", 1)])
    result = tune([plant], [HinfGain("w", "z")], STATIC, options=TuningOptions(starts=2, iterations=30))
    assert result.status == "not_stabilised" and result.abscissa == pytest.approx(1.0, abs=1e-6)


@pytest.mark.slow
def test_infeasible_gives_the_least_violation() -> None:
    """Effort at most 0.3 and gain at most 0.5 contradict each other: k / (1 + k) <= 0.3, 1 / (1 + k) <= 0.5."""
    hard = [HinfGain("w", "z", bound=0.5, hard=True, name="gain"), HinfGain("w", "effort", bound=0.3, hard=True)]
    result = tune([lag()], [HinfGain("w", "z"), *hard], STATIC, options=TuningOptions(starts=1))
    assert result.status == "infeasible" and not result.feasible
    assert "hard requirement" in result.advice
    # 2 / (1 + k) = (k / (1 + k)) / 0.3 at k = 0.6: violation 1.25
    assert result.hard == pytest.approx(1.25, rel=1e-3)


def test_only_hard_requirements() -> None:
    result = tune([lag(1.0)], [HinfGain("w", "z", bound=0.5, hard=True)], STATIC, options=QUICK)
    assert result.feasible and result.hard <= 1.0 + 1e-6


class SimulatedClock:
    """Stands in for ``time.monotonic``: each look at the clock takes 10 ms, on every machine."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        self.now += 0.01
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> SimulatedClock:
    simulated = SimulatedClock()
    monkeypatch.setattr(time, "monotonic", simulated)
    return simulated


def test_wall_limit_gives_the_best_so_far(clock: SimulatedClock) -> None:
    plant = PLANTS["AC6"]()
    structure = state_space([("y", 4)], [("u", 2)], 4)
    result = tune([plant], [HinfGain("w", "z")], structure, options=TuningOptions(starts=50, wall_limit=1.0))
    assert clock.now < 1.1
    assert result.status in ("out_of_time", "converged", "iterations", "stalled")
    assert len(result.starts) < 50
    assert np.isfinite(result.soft), "the best point so far"


@pytest.mark.usefixtures("clock")
def test_wall_limit_in_the_first_start_is_told() -> None:
    structure = state_space([("y", 4)], [("u", 2)], 4)
    options = TuningOptions(starts=1, wall_limit=0.05)
    result = tune([PLANTS["AC6"]()], [HinfGain("w", "z")], structure, options=options)
    assert result.status == "out_of_time" and "allow more time" in result.advice


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
    result = tune([PLANTS["AC4"]()], [HinfGain("w", "z")], gain([("y", 2)], [("u", 1)]), options=QUICK)
    assert result.status == "interrupted"
    assert np.isfinite(result.soft) and result.certificate is not None and result.certificate.stable


def test_target_stops_early() -> None:
    options = TuningOptions(starts=2, target=1.5)
    result = tune([PLANTS["AC4"]()], [HinfGain("w", "z")], gain([("y", 2)], [("u", 1)]), options=options)
    assert result.status == "target" and 0.9 < result.soft < 1.5


def test_same_seed_same_bits_and_workers_change_nothing() -> None:
    def run(workers: int, seed: int) -> tuple[bytes, tuple[float, ...]]:
        options = TuningOptions(starts=2, seed=seed, workers=workers, iterations=3)
        result = tune([lag(0.5)], [HinfGain("w", "z"), HinfGain("w", "effort")], STATIC, options=options)
        return result.x.tobytes(), result.starts

    first = run(1, 7)
    assert first == run(2, 7), "processes give the same bits"
    assert first[1] != run(1, 8)[1], "other random starts"


def test_given_start_is_used_and_never_made_worse() -> None:
    plant = PLANTS["AC4"]()
    structure = gain([("y", 2)], [("u", 1)])
    first = tune([plant], [HinfGain("w", "z")], structure, options=TuningOptions(starts=1))
    assert first.status is TuningStatus.CONVERGED and first.certificate is not None
    assert first.certificate.values.max() == pytest.approx(first.soft, rel=1e-3)
    assert first.certificate.upper.max() == pytest.approx(first.soft, rel=1e-3), "converged means certified"
    again = tune([plant], [HinfGain("w", "z")], structure, initial=[first.x], options=TuningOptions(starts=0))
    (start,) = again.starts
    assert again.soft <= start, "not worse than the value of the start itself"
    assert start == pytest.approx(first.soft, rel=1e-9), "which is found again as far as a search locates its peak"


def test_stable_controller_on_request() -> None:
    """By structure or by requirement; p(K) of a plant that would like an unstable one stays stable."""
    plant = integrators()
    by_structure = StableStateSpace((Port("y", 1),), (Port("u", 1),), 2, min_decay=0.01)
    options = TuningOptions(starts=1, target=1e6)
    a = tune([plant], [HinfGain("w", "z")], by_structure, options=options)
    assert np.linalg.eigvals(a.controller.A).real.max() <= -0.01
    free = state_space([("y", 1)], [("u", 1)], 2)
    b = tune([plant], [HinfGain("w", "z"), ControllerPoles(min_decay=0.01)], free, options=options)
    assert b.feasible and np.linalg.eigvals(b.controller.A).real.max() <= -0.01 * (1 - 1e-6)


def test_pole_requirements_hold_on_the_closed_loop() -> None:
    poles = ClosedLoopPoles(min_decay=0.3, min_damping=0.5, max_frequency=20.0)
    free = state_space([("y", 1)], [("u", 1)], 2)
    result = tune([integrators()], [HinfGain("w", "z"), poles], free, options=TuningOptions(starts=1, target=1e6))
    assert result.feasible and result.certificate is not None
    closed = result.certificate.abscissae.max()
    assert closed <= -0.3 * (1 - 1e-6)
    assert result.certificate.values[1, 0] <= 1 + 1e-6


def test_delay_limits_the_gain() -> None:
    """k / s with a delay T: the smallest peak of the disturbance response 1 / (s + k e^{-sT}) needs a finite k."""
    plant = System([[0]], [[1, 1]], [[1], [1]], np.zeros((2, 2)), [("w", 1), ("u", 1)], [("z", 1), ("y", 1)])
    result = tune([plant], [HinfGain("w", "z")], STATIC, loop_delay=0.5, options=QUICK)
    k = -result.controller.D.item()
    w = np.geomspace(1e-3, 1e2, 20001)
    peaks = {g: np.abs(1 / (1j * w + g * np.exp(-0.5j * w))).max() for g in np.linspace(0.3, 2.5, 221)}
    best = min(peaks, key=peaks.__getitem__)
    assert k == pytest.approx(best, abs=0.02)
    assert result.soft == pytest.approx(peaks[best], rel=1e-4)
    assert result.certificate is not None and result.certificate.values.max() == pytest.approx(result.soft, rel=1e-4)


def test_certificate_is_independent_and_sees_a_wrong_controller() -> None:
    wrong = System.static([[3.0]], [("y", 1)], [("u", 1)])
    found = certify([lag()], wrong, [HinfGain("w", "z")])
    assert not found.stable and found.values[0, 0] == np.inf


def test_gain_matrix_of_round_trips() -> None:
    model = System([[-1, 2], [0, -3]], [[1], [2]], [[3, 4]], [[5]], [("y", 1)], [("u", 1)])
    structure = state_space([("y", 1)], [("u", 1)], 2)
    assert np.array_equal(structure.gain_matrix(structure.parameters_of(model)), gain_matrix_of(model))


PLANT = published_plant("AC17")
STRUCTURE = gain([PLANT.outputs[1]], [PLANT.inputs[1]])


def test_values_of_a_result_are_those_of_its_certificate() -> None:
    options = TuningOptions(starts=0)
    x0 = np.zeros(STRUCTURE.size)
    result = tune([PLANT], [HinfGain("w", "z")], STRUCTURE, initial=[x0], options=options)
    assert result.certificate is not None
    assert result.values.tolist() == result.certificate.values.tolist()
    assert result.soft <= result.certificate.upper.max()


def test_starts_that_agree_end_a_search() -> None:
    """Those of a convex problem end at one value: no further ones are begun."""
    result = tune([PLANT], [HinfGain("w", "z")], STRUCTURE, options=TuningOptions(starts=24, iterations=100))
    assert 1 < len(result.starts) < 24 and max(result.starts) <= min(result.starts) * (1.0 + 1e-3)


def test_search_ends_where_the_value_vanishes() -> None:
    """AC1: the disturbance can be rejected completely."""
    plant = published_plant("AC1")
    result = tune([plant], [HinfGain("w", "z")], gain([plant.outputs[1]], [plant.inputs[1]]))
    assert result.soft < 1e-6
    assert len(result.starts) <= 4, "no random start after that"


def test_the_order_that_is_asked_for_is_looked_at_first() -> None:
    """Its first random start meets the target: none of a lower order is begun."""
    plant = PLANTS["HE1"]()
    structure = state_space([plant.outputs[1]], [plant.inputs[1]], 1)
    result = tune([plant], [HinfGain("w", "z")], structure, options=TuningOptions(target=10.0))
    assert result.status == "target" and len(result.starts) == 1


@pytest.mark.parametrize("kind", ["soft gains", "a hard limit"])
def test_out_of_time_is_said_when_the_time_is_over(kind: str) -> None:
    """Not when a part of it is that one order was given: the orders below it have the rest."""
    plant, limit = PLANTS["HE1"](), 1.5
    ports = {p.name: p for p in (*plant.inputs, *plant.outputs)}
    needs = [HinfGain("w", "z")] + [ControllerPoles(min_decay=1e-3, hard=True)] * (kind != "soft gains")
    result = tune([plant], needs, state_space([ports["y"]], [ports["u"]], 3), options=TuningOptions(wall_limit=limit))
    assert result.status != "out_of_time" or result.seconds > 0.95 * limit
