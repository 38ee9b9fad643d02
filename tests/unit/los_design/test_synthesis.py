"""Designs from end to end with very small effort: what the returned file holds, screening, trade-off."""

from __future__ import annotations

import itertools
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from small_loop import SmallFamily, small_controllers, small_plant

from fsm_pma_controller.problem import actuator_plant, actuator_requirements, actuator_structure
from los_design import starts, synthesis, trade_off
from los_design.options import LOOP_DELAY, DesignOptions
from los_design.rounds import Effort
from los_design.sampled_loop import sampled_loop
from los_design.sampled_loop_norms import weighted_response
from los_design.starts import screened, zero_controller
from los_design.store import continuous, load_designs
from los_design.trade_off import TradeOffPoint, undominated
from los_design.worst_points import SearchOptions
from los_estimator.problem import observer_plant, observer_requirements, observer_structure
from lti import StateSpace
from robust_design import certify
from titop_plant.interface import CAMERA, K_FSM_INPUTS, K_FSM_OUTPUTS, K_PMA_INPUTS, K_PMA_OUTPUTS, MEASURED
from titop_plant.simulation import telescope
from titop_plant.telescope.budget import error_budget
from titop_plant.telescope.parameters import design_basis, load_parameters

MAS = np.pi / 648e6
NOISE_SHARE = error_budget(load_parameters()).noise / MAS
PORTS = {"k-fsm": (K_FSM_INPUTS, K_FSM_OUTPUTS), "k-pma": (K_PMA_INPUTS, K_PMA_OUTPUTS)}
STATUSES = {
    "converged",
    "rounds",
    "target",
    "iterations",
    "stalled",
    "infeasible",
    "wall_limit",
    "out_of_time",
    "inaccurate",
}


@pytest.fixture(scope="module")
def parameters():
    return load_parameters()


def check_file(system, kind: str, options: DesignOptions, parameters, tmp_path) -> None:
    """Ports, period, provenance; written and read back without a change."""
    system.require(*PORTS[kind], 1e-3)
    provenance = system.provenance
    nominal = " --nominal" if options.nominal else ""
    assert provenance["command"] == f"los-testbed design {kind}{nominal} --loop-delay 0.0015 --seed {options.seed}"
    assert (provenance["seed"], provenance["loop_delay"]) == (options.seed, LOOP_DELAY)
    assert system.design_basis == design_basis(parameters).to_mapping()
    assert provenance["status"] in STATUSES
    assert provenance["commit"]
    system.to_file(tmp_path / "design.json")
    again = type(system).from_file(tmp_path / "design.json")
    assert all(np.array_equal(getattr(system, key), getattr(again, key)) for key in "ABCD")
    assert again.provenance == provenance and again.design_basis == system.design_basis and again.name == system.name
    assert continuous(again).order == 4


def certified(system, plant, measured, requirements, options: DesignOptions, points) -> dict[str, float]:
    """Worst norms of the continuous controller by the certificate, which shares no code with the tuner."""
    data = continuous(system).data_at({})
    K = StateSpace(*data.matrices, tuple(plant.system.output_port(m) for m in measured), data.outputs, "K")
    found = certify([plant(values) for values in points], K, requirements, options.delay)
    assert found.stable
    return dict(zip((r.name for r in requirements), found.values.max(axis=1)))


def test_designs_of_the_nominal_model_from_end_to_end(parameters, tmp_path, monkeypatch) -> None:
    """Two iterations each: files fit the runtime, their provenance is whole, their gammas are the certified ones."""
    monkeypatch.setattr(synthesis, "MAX_NOMINAL_ITERATIONS", 2)
    assembled, options = telescope(), DesignOptions(nominal=True, seed=3)
    k_fsm = synthesis.design_observer(assembled, parameters, options)
    check_file(k_fsm, "k-fsm", options, parameters, tmp_path)
    plant = observer_plant(assembled, parameters, **options.hold_delays)
    requirements = observer_requirements(parameters, implemented=True)
    found = certified(k_fsm, plant, MEASURED, requirements, options, [{}])
    assert k_fsm.provenance["tuned_values"] == pytest.approx(found, rel=2e-3)
    assert not continuous(k_fsm).data_at({}).D[:, CAMERA].any()  # no direct path from a zero-order-hold camera

    k_pma = synthesis.design_actuators(assembled, parameters, k_fsm, options)
    check_file(k_pma, "k-pma", options, parameters, tmp_path)
    plant = actuator_plant(assembled, parameters, continuous(k_fsm), loop_delay=options.delay, **options.hold_delays)
    requirements = actuator_requirements(parameters, implemented=True)
    found = certified(k_pma, plant, ("accel_Ip",), requirements, options, [{}])
    assert k_pma.provenance["tuned_values"] == pytest.approx(found, rel=2e-3)


SMALL = SearchOptions(frequencies=12, points=4, ascents=2, iterations=2)


@pytest.mark.slow
def test_a_robust_observer_from_end_to_end(parameters, tmp_path, monkeypatch) -> None:
    """One round with a small search: active points and worst cases are in the file, the values hold at the points."""
    monkeypatch.setattr(synthesis, "EFFORT", Effort(rounds=1, iterations=1, quick=SMALL, thorough=SMALL))
    monkeypatch.setattr(synthesis, "FIRST_SEARCH", SMALL)
    monkeypatch.setattr(synthesis, "FIRST_POINTS", 1)
    assembled, options = telescope(), DesignOptions(seed=4)
    lines: list[str] = []
    k_fsm = synthesis.design_observer(assembled, parameters, options, lines.append)
    check_file(k_fsm, "k-fsm", options, parameters, tmp_path)
    assert lines[-1].startswith("round 1: 2 models, tuned")
    active = k_fsm.provenance["active_models"]
    assert active[0] == {} and len(active) == 2
    plant = observer_plant(assembled, parameters, **options.hold_delays)
    requirements = observer_requirements(parameters, implemented=True)
    found = certified(k_fsm, plant, MEASURED, requirements, options, active)
    assert k_fsm.provenance["tuned_values"] == pytest.approx(found, rel=2e-3)
    worst = {case["requirement"]: case for case in k_fsm.provenance["worst_cases"]}
    assert set(worst) == {"APE", "slow", "fast", "mirror", "sensitivity"}
    case = worst["mirror"]  # the continuous problem has the same value, its delays being approximations
    at = certified(k_fsm, plant, MEASURED, requirements, options, [case["parameters"]])
    assert at["mirror"] == pytest.approx(case["value"], rel=0.03)


def test_what_a_design_is_started_with(parameters, monkeypatch) -> None:
    """The implemented problem starts from the stored controllers, on the first points; the paper's on the screened."""
    calls = []

    def stop(*args, **kwargs):
        calls.append((args, kwargs))
        raise InterruptedError

    for name in ("tune", "tune_robust", "design_in_rounds"):
        monkeypatch.setattr(synthesis, name, stop)
    monkeypatch.setattr(synthesis, "screened", lambda *args: [{"seed": args[-1]}])
    monkeypatch.setattr(synthesis, "_first_points", lambda search: [{"wheel_1.speed": 100.0}])
    monkeypatch.setattr(synthesis.Search, "run", lambda self, names: {name: [] for name in names})
    k_fsm, _ = load_designs("implemented")
    for options in (DesignOptions(nominal=True), DesignOptions(seed=5), DesignOptions(loop_delay=0.0)):
        with pytest.raises(InterruptedError):
            synthesis.design_observer(telescope(), parameters, options)
        with pytest.raises(InterruptedError):
            synthesis.design_actuators(telescope(), parameters, k_fsm, options)
    nominal, nominal_actuators, observer, actuators, paper, paper_actuators = calls
    assert len(nominal[1]["initial"]) == len(nominal_actuators[1]["initial"]) == 1
    assert nominal[1]["options"].iterations == 250 and nominal[1]["loop_delay"] == pytest.approx(1e-3)
    for (task, start, active, effort, tuning, _), _ in (observer, actuators):
        assert active == [{}, {"wheel_1.speed": 100.0}] and effort is synthesis.EFFORT
        assert tuning.target == synthesis.GOAL and task.loop_delay == pytest.approx(1e-3)
        assert set(task.bounds) >= {"APE", "slow", "fast", "mirror", "sensitivity, mirror"}
        assert {name for name, _ in task.bounds.values()} <= {r.name for r in task.requirements}
        assert start.shape == (task.structure.size,)
    assert paper[1]["active"] == paper_actuators[1]["active"] == [{"seed": 0}]
    assert paper[1]["loop_delay"] == 0.0 and paper[1]["options"].iterations == 40


def test_a_start_that_does_not_stabilise_is_replaced_by_the_kalman_observer(parameters, monkeypatch) -> None:
    """In steps of relaxed requirements: each begins where the one before ended."""
    start_points, lines = [], []

    def tuned(models, requirements, structure, *, initial, loop_delay, options):
        start_points.append((requirements[-2].bound, initial[0]))
        return SimpleNamespace(x=initial[0] + 1.0, soft=2.0)

    def stop(task, start, *_):
        start_points.append((None, start))
        raise InterruptedError

    monkeypatch.setattr(synthesis, "tune", tuned)
    monkeypatch.setattr(synthesis, "design_in_rounds", stop)
    monkeypatch.setattr(synthesis, "stabilises", lambda *_: False)
    monkeypatch.setattr(synthesis, "_first_points", lambda search: [])
    monkeypatch.setattr(synthesis.Search, "run", lambda self, names: {name: [] for name in names})
    with pytest.raises(InterruptedError):
        synthesis.design_observer(telescope(), parameters, DesignOptions(), lines.append)
    noise = [bound for bound, _ in start_points[:-1]]
    assert noise == sorted(noise, reverse=True) and len(noise) == len(synthesis.RELAXATIONS)
    assert all(np.array_equal(later, before + 1.0) for (_, before), (_, later) in itertools.pairwise(start_points))
    assert lines[0].startswith("the stored start does not stabilise") and lines[1].endswith("tuned 2.000")


@pytest.mark.parametrize("kind", ["k-fsm", "k-pma"])
def test_the_stored_starts_stabilise_the_reference_telescope(kind: str, parameters) -> None:
    options = DesignOptions()
    if kind == "k-fsm":
        plant = observer_plant(telescope(), parameters, **options.hold_delays)
        structure = observer_structure(plant, camera_hold=True)
    else:
        k_fsm, _ = load_designs("implemented")
        plant = actuator_plant(
            telescope(), parameters, continuous(k_fsm), loop_delay=options.delay, **options.hold_delays
        )
        structure = actuator_structure(plant)
    x = structure.parameters_of(starts.stored_start(kind, plant.system))
    assert starts.stabilises(x, [plant({})], structure, options.delay)
    assert not starts.stabilises(-1e3 * x, [plant({})], structure, options.delay)


def test_options_name_variant_and_delays() -> None:
    assert DesignOptions().hold_delays == {"camera_period": 0.02, "command_hold": 0.5e-3}
    assert DesignOptions().delay == pytest.approx(1e-3)
    paper = DesignOptions(loop_delay=0.0, nominal=True)
    assert (paper.hold_delays, paper.delay, paper.variant) == ({}, 0.0, "paper_nominal")
    assert (DesignOptions().variant, DesignOptions(nominal=True).variant) == ("implemented", "implemented_nominal")
    assert DesignOptions(loop_delay=2e-4).hold_delays["command_hold"] == 2e-4


CANDIDATES = [{"stiffness": k} for k in (1.0, 40.0, 64.0, 9.0, 130.0, 70.0)]


@pytest.mark.parametrize("with_observer", [False, True])
def test_screened_points_are_the_worst_in_their_bands(with_observer: bool, parameters, monkeypatch) -> None:
    """Four corners and two random points, compared one by one in each band."""
    family = SmallFamily()
    drawn = []

    def sample_values(rng, count: int):
        drawn.append((rng.integers(1 << 30), count))
        return CANDIDATES[4:]

    stand_in = SimpleNamespace(data_at=family.data_at, sample_values=sample_values)
    monkeypatch.setattr(starts, "control_loop_plant", lambda *_: stand_in)
    monkeypatch.setattr(starts, "parameter_corners", lambda _: CANDIDATES[:4])
    k_fsm = small_controllers()[0] if with_observer else None
    found = screened(None, parameters, k_fsm, 7)
    assert drawn == [(np.random.default_rng(7).integers(1 << 30), 32)]
    best = []
    for low, high in ((50.0, 300.0), (300.0, 430.0), (430.0, 520.0), (520.0, 800.0)):
        peaks = []
        for values in CANDIDATES:
            plant = small_plant(values["stiffness"])
            pair = k_fsm or zero_controller("k-fsm"), zero_controller("k-pma")
            loop = sampled_loop(plant, *pair, loop="fsm" if with_observer else "isolator", frame_ticks=20)
            omega, _, relative = weighted_response(loop, plant, parameters, 50.0)
            peaks.append(relative[(omega > low) & (omega <= high)].max())
        best.append(CANDIDATES[int(np.argmax(peaks))])
    assert len({v["stiffness"] for v in best}) >= 3
    assert sorted(v["stiffness"] for v in found) == sorted({v["stiffness"] for v in best})


@pytest.mark.parametrize("kind", ["k-fsm", "k-pma"])
def test_a_zero_controller_fits_the_runtime_and_does_nothing(kind: str) -> None:
    system = zero_controller(kind)
    system.require(*PORTS[kind], 1e-3)
    assert system.order == 0 and not system.D.any()


@pytest.mark.slow
def test_one_level_of_the_trade_off(parameters, monkeypatch) -> None:
    """Two iterations on one model: values are those of the tuner, the stored design comes first, ticks are counted."""
    monkeypatch.setattr(trade_off, "MAX_ITERATIONS", 2)
    monkeypatch.setattr(trade_off, "MAX_POINTS", 1)
    results, ticks, tune = [], [], trade_off.tune

    def recorded(models, requirements, *args, **kwargs):
        results.append((requirements, kwargs, tune(models, requirements, *args, **kwargs)))
        return results[-1][2]

    monkeypatch.setattr(trade_off, "tune", recorded)
    stored, point = trade_off.trade_off([0.5], lambda: ticks.append(1))
    assert len(ticks) == len(results) == 2
    assert (stored.bound, stored.status, point.bound) == (None, "stored", 0.5)
    names = [r.name for r in results[0][0]]
    candidates = []
    for requirements, _, result in results:
        assert [r.name for r in requirements if not r.hard] == ["noise -> RPE"]
        values = dict(zip(names, result.values.max(axis=1)))
        # 1 is 50 mas for slow and fast tones, the share of the budget for the noise
        tones = 50.0 * max(values["slow"], values["fast"])
        candidates.append((not result.feasible, NOISE_SHARE * values["noise -> RPE"], tones))
    best = min(candidates)
    assert (point.infeasible, point.noise, point.disturbance) == pytest.approx(best, rel=1e-12)
    if results[0][2].feasible:  # the second one starts from the first
        assert np.array_equal(results[1][1]["initial"][0], results[0][2].x)
    plant = observer_plant(telescope(), parameters, **DesignOptions().hold_delays)
    k_fsm, _ = load_designs("implemented")
    at = k_fsm.provenance["active_models"][:1]
    requirements = observer_requirements(parameters, implemented=True)
    known = certified(k_fsm, plant, MEASURED, requirements, DesignOptions(), at)
    shares = error_budget(parameters)
    tones = max(known["slow"] * shares.slow, known["fast"] * shares.fast_mirror)
    assert stored.disturbance == pytest.approx(tones / MAS, rel=2e-3)
    assert stored.noise == pytest.approx(NOISE_SHARE * known["noise -> RPE"], rel=2e-3)


def test_undominated_points_are_those_no_other_one_beats() -> None:
    points = [TradeOffPoint(0.1 * k, d, n, s) for k, (d, n, s) in enumerate([
        (10.0, 50.0, "converged"), (20.0, 40.0, "converged"), (25.0, 45.0, "converged"), (15.0, 10.0, "infeasible"),
        (30.0, 30.0, "iterations"), (30.0, 35.0, "converged"),
    ])]  # fmt: skip
    assert [(p.disturbance, p.noise) for p in undominated(list(reversed(points)))] == [(10, 50), (20, 40), (30, 30)]
    assert undominated([replace(points[3])]) == []
