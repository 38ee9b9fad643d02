"""Problems that the controllers are tuned on: stored designs, samples of the implemented loop, limits out of reach."""

from __future__ import annotations

import json
import time
from dataclasses import replace

import numpy as np
import pytest
from los_testbed.cli.app import main
from scipy import linalg
from support.paper_problem import actuator_structure

from fsm_pma_controller.problem import actuator_plant
from lftkit import SampledSystem
from lftkit.tuning.options import TuningOptions
from lftkit.tuning.problem import Problem, worst_values
from lftkit.tuning.responses import ResponseProblem, parameters_of
from lftkit.tuning.tuner import tune
from los_design.synthesis.options import DesignOptions
from los_design.synthesis.pair_problem import (
    ACTUATORS,
    ALONE,
    BOTH,
    OBSERVER,
    Samples,
    blocks,
    gains,
    limits,
    named,
    noises,
    pair_problem,
    sample,
)
from los_design.synthesis.starts import random_law
from los_design.synthesis.state_space_requirements import implemented_requirements, paper_requirements, requirement
from los_design.synthesis.store import continuous, design_file, load_designs
from los_design.synthesis.unreachable import StageBounds, unreachable_limits
from los_estimator.problem import kalman_start, observer_plant, observer_structure
from los_loop.figures_of_merit import figure
from los_loop.implemented_loop import ImplementedLoop, loop_metrics
from los_loop.noise import noise_covariances, noise_rms
from los_loop.open_loop import OpenLoop
from los_loop.sampled_loop_norms import sampled_loop_metrics
from titop_plant.interface import CAMERA, DT, LOOP_DELAY, MEASURED, MIRROR
from titop_plant.telescope.control_plant import control_loop_plant, loop_plant
from titop_plant.telescope.error_budget import error_budget
from titop_plant.telescope.load import load_telescope
from titop_plant.telescope.weights import rpe_weight
from titop_plant.telescope.window_noise import WindowNoise, combined_level, ramp

IMPLEMENTED = DesignOptions()


def test_kalman_observer_has_the_noise_of_the_paper(telescope) -> None:
    """Accelerometer noise: 0.98 of 10 arcsec in the paper, 145 mas of relative error on a preliminary model."""
    plant = observer_plant(telescope)
    names, weights = ("noise -> RPE", "noise -> APE", "mirror"), telescope.weights
    bounds = weights.rpe_limit, weights.ape_limit, telescope.fsm.authority
    rows = [replace(figure(name), inputs=MEASURED) if "noise" in name else figure(name) for name in names]
    requirements = [requirement(row, telescope, "fsm", bound) for row, bound in zip(rows, bounds)]
    structure = observer_structure(plant)
    problem = Problem([plant({})], requirements, structure)
    start = kalman_start(structure, telescope)
    found = dict(zip((r.name for r in requirements), problem.evaluate(start, gradients=False).values[:, 0]))
    assert 0.85 < found["noise -> APE"] < 1.05
    assert 1.3 < found["noise -> RPE"] < 1.6
    assert found["mirror"] < 1.0


def test_gradients_of_the_observer_problem_equal_differences(telescope) -> None:
    plant = observer_plant(telescope, **IMPLEMENTED.hold_delays)
    requirements = [r for r in implemented_requirements(telescope, "fsm") if r.name in ("fast", "noise -> RPE")]
    structure = observer_structure(plant, camera_hold=True)
    problem = Problem([plant({})], requirements, structure, loop_delay=IMPLEMENTED.delay)
    x = kalman_start(structure, telescope, lead=LOOP_DELAY)
    pieces = problem.evaluate(x, band=0.01).pieces
    rng = np.random.default_rng(0)
    for i in range(len(requirements)):
        best = max((p for p in pieces if p.requirement == i), key=lambda p: p.value)
        # Every entry changes by a random part of itself, uphill: the slope is then large against rounding of the peak.
        direction = rng.uniform(0.5, 1.0, x.size) * (np.abs(x) + 1e-6) * np.sign(best.gradient)
        h = 1e-4
        ends = [problem.evaluate(x + s * h * direction, gradients=False).values[i, 0] for s in (-1.0, 1.0)]
        assert best.gradient @ direction == pytest.approx((ends[1] - ends[0]) / (2.0 * h), rel=1e-6)


def test_a_random_start_is_stable_and_has_a_small_gain(telescope) -> None:
    k_fsm, _ = load_designs("implemented")
    plant = actuator_plant(telescope, continuous(k_fsm), loop_delay=IMPLEMENTED.delay, **IMPLEMENTED.hold_delays)
    start = random_law(0)
    assert np.linalg.eigvals(start.A).real.max() < 0.0
    structure = actuator_structure(plant)
    asked = implemented_requirements(telescope, "fsm+pma")
    problem = Problem([plant({})], asked, structure, loop_delay=IMPLEMENTED.delay)
    assert problem.abscissa(structure.parameters_of(start)) < 0.0


@pytest.mark.parametrize("variant", ["implemented", "implemented_nominal"])
def test_stored_designs_have_the_provenance_of_this_telescope(variant: str, telescope) -> None:
    for system in load_designs(variant):
        assert system.design_basis == telescope.design_basis.to_mapping()
        assert system.provenance["command"].startswith("los-testbed design all")
        assert continuous(system).order == 4


def test_implemented_designs_are_stable_and_within_the_templates_at_nominal(telescope) -> None:
    k_fsm, k_pma = load_designs("implemented")
    plant = control_loop_plant(telescope).at({})
    given = plant, k_fsm, k_pma, telescope
    one, two = (sampled_loop_metrics(*given, loop=loop) for loop in ("fsm", "fsm+pma"))
    assert one.radius < 1.0 and two.radius < 1.0
    assert max(one.ape, one.rpe, one.mirror) < 1.0
    assert max(two.ape, two.rpe_fine, two.force) < 1.0
    assert two.noise_ape < telescope.weights.ape_limit
    assert two.noise_rpe < telescope.weights.rpe_limit


def test_a_controller_without_its_continuous_form_is_named(tmp_path) -> None:
    system, _ = load_designs("implemented")
    bare = SampledSystem(system.A, system.B, system.C, system.D, system.inputs, system.outputs, system.dt, "mine")
    with pytest.raises(ValueError, match="mine: the file holds no continuous controller"):
        continuous(bare)
    with pytest.raises(ValueError, match="must be one of k-fsm, k-pma"):
        design_file("k-xyz")


def test_table_as_json(capsys) -> None:
    assert main(["design", "table", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out.strip().splitlines()[-1])
    assert {row["design"] for row in rows} == {"k-fsm", "k-pma"}
    assert {row["variant"] for row in rows} == {"implemented", "implemented_nominal"}


@pytest.fixture(scope="module")
def open_loop(telescope):
    return OpenLoop(control_loop_plant(telescope), telescope, telescope.loop_ports.used_by())


@pytest.fixture(scope="module")
def pair():
    return load_designs("implemented")


@pytest.fixture(scope="module")
def x(telescope, pair):
    matrices = []
    for system in pair:
        A, B, C, D = continuous(system).at({}).matrices
        matrices.append(np.block([[A, B], [C, D]]))
    return parameters_of(blocks(telescope, (OBSERVER, ACTUATORS)), matrices)


def test_every_gain_is_that_of_the_implemented_loop(telescope, open_loop, pair, x) -> None:
    """Both stages, all requirements, at random points and frequencies on both sides of the bands' edge."""
    rng = np.random.default_rng(3)
    points, omega = rng.uniform(size=(3, 7)), np.array([0.03, 4.3, 64.0, 145.0, 402.0, 690.0, 2000.0])
    samples = sample(open_loop, omega, points)
    problem = ResponseProblem(blocks(telescope, (OBSERVER, ACTUATORS)), samples, gains(telescope, (ALONE, BOTH)))
    found = {gain.name: row for gain, row in zip(problem.gains, problem.values(x))}
    for stage, name in ((ALONE, "fsm"), (BOTH, "fsm+pma")):
        loop = ImplementedLoop(open_loop, *pair, name)
        for metric in loop_metrics(telescope, name, telescope.loop_ports.used_by()).values():
            share = limits(telescope, stage)[metric.name]
            expected = [
                float(loop.gains(loop.at(w), metric, point[None])[0]) * metric.limit / share
                if metric.band[0] <= w < metric.band[1]
                else 0.0
                for w in omega
                for point in points
            ]
            np.testing.assert_allclose(found[named(metric.name, stage)], expected, rtol=1e-7, atol=1e-12)


@pytest.mark.further
def test_noise_is_that_of_the_sampled_loop(telescope, open_loop, pair, x) -> None:
    """The integral over frequency against the periodic Lyapunov equation: within 0.1 %.

    The absolute error has some noise below the lowest frequency of the integral; verification uses the equation.
    """
    problem = ResponseProblem(
        blocks(telescope, (OBSERVER, ACTUATORS)),
        sample(open_loop, np.array([1.0]), np.full((1, 7), 0.5)),
        gains(telescope, (BOTH,)),
        noises(Samples(open_loop), (ALONE, BOTH)),
    )
    plant, budget = open_loop.system.at({}), error_budget(telescope)
    shares = {"fsm": (budget.ape_noise, budget.noise), "fsm+pma": (budget.ape_noise, budget.total_noise)}
    values = np.reshape(problem.noise(x), (2, 2))
    for found, (stage, share) in zip(values, shares.items()):
        exact = noise_rms(noise_covariances(plant, *pair, telescope, loop=stage))
        assert found[1] * share[1] == pytest.approx(exact[1], rel=1e-3)
        assert 0.97 * exact[0] < found[0] * share[0] < exact[0]


def test_samples_are_dense_where_modes_are_narrow(open_loop) -> None:
    """Every slow mode of an added point has samples within half of its width; the nominal point's fast ones, too."""
    samples = Samples(open_loop)
    point = np.random.default_rng(1).uniform(size=7)
    samples.add(point[None])
    samples.add_around(402.0, point)
    omega = samples.all().omega
    for mode in [*open_loop.modes(point, 0.1, 85.0), *open_loop.modes(open_loop.point({}), 130.0, 3000.0)]:
        assert np.abs(omega / mode - 1.0).min() <= 5e-4
    assert np.sum(np.abs(omega / 402.0 - 1.0) < 4e-3) >= 9
    assert len(samples.all()) == len(omega)  # joined once more, nothing is lost or doubled


def test_only_the_tuned_controller_is_free(telescope) -> None:
    for tuned in ((OBSERVER,), (ACTUATORS,), (OBSERVER, ACTUATORS)):
        for k, block in enumerate(blocks(telescope, tuned)):
            assert block.free.any() == (k in tuned)
    observer = blocks(telescope, (OBSERVER,))[OBSERVER]
    assert np.sum(~observer.free) == 4  # no direct path from the camera


def test_the_shares_together_keep_the_limit(telescope) -> None:
    """Slow tones and noise of both stages, together 40 mas for 99.7 % of the windows; alone 100 mas; the APE."""
    budget, both, alone = error_budget(telescope), limits(telescope, BOTH), limits(telescope, ALONE)
    weights = telescope.weights
    assert combined_level(both["slow"], budget.total_noise, 0.997) <= weights.rpe_limit_fine * (1 + 1e-9)
    assert combined_level(alone["slow"], budget.noise, 0.997) <= weights.rpe_limit
    slow_noise = WindowNoise(budget.noise, shape=np.outer(ramp(64), ramp(64)))
    assert combined_level(alone["fast"], slow_noise, 0.997, 5.0) <= weights.rpe_limit
    for stage in (alone, both):
        assert combined_level(stage["APE"], budget.ape_noise, 0.997) <= weights.ape_limit


def test_a_problem_of_one_controller_has_its_stage_only(open_loop) -> None:
    samples = Samples(open_loop)
    problem = pair_problem(samples, (BOTH,), (ACTUATORS,))
    assert all("alone" not in gain.name for gain in problem.gains)
    assert [noise.name for noise in problem.noises] == ["all noise -> APE", "noise -> RPE"]
    assert problem.free.sum() == 100


def open_loop_of(telescope) -> OpenLoop:
    return OpenLoop(loop_plant(telescope, telescope.loop_ports), telescope, telescope.loop_ports)


def noisy(telescope, factor: float):
    """With all sensor noise larger by a factor."""
    base = np.array([0.0012] * 3 + [0.0023] * 3)
    sensors = dict.fromkeys(("camera_noise", "strain_gauge_noise"), 1e-8 * factor)
    return telescope.changed({"sensors": {**sensors, "accelerometer_noise": (factor * base).tolist()}})


@pytest.mark.further
@pytest.mark.parametrize("relative", [True, False])
def test_noises_through_a_loop_have_the_power_that_frequency_responses_give(open_loop, relative: bool) -> None:
    """Static feedback of the camera to the mirror, in the state space and on the samples that are tuned."""
    bounds = StageBounds(open_loop, "fsm", relative)
    plant, tones = bounds.plant_with_noises()
    K = np.zeros((2, open_loop.ports.measurements))
    K[:, CAMERA] = -0.05 / open_loop.telescope.fsm.los_sensitivity * np.eye(2)
    A = plant.A + plant.B @ K @ plant.M
    assert np.abs(linalg.eigvals(A)).max() < 1.0

    heard = plant.B @ K * plant.noises[-1].measurement
    P = linalg.solve_discrete_lyapunov(A, heard @ heard.T)
    by_states = np.sqrt(np.trace(plant.C @ P @ plant.C.T))

    omega = np.unique(np.concatenate([np.geomspace(1e-3, np.pi / DT, 1500), bounds.omega]))
    lft = open_loop.at(omega)
    nominal = np.array([open_loop.closed_over(one, open_loop.point({})[None])[0] for one in lft])
    control = np.zeros((len(omega), open_loop.ports.commands, open_loop.ports.measurements), complex)
    control[:, MIRROR] = K * np.exp(-1j * omega * DT)[:, None, None]
    m = open_loop.disturbances
    y, u = open_loop.ports.measurements, slice(m, None)
    sensed = np.linalg.solve(np.eye(y) - nominal[:, :y, u] @ control, np.broadcast_to(np.eye(y), (len(omega), y, y)))
    to_error = nominal[:, -2:, u] @ control @ sensed * plant.noises[-1].measurement
    weight = rpe_weight(omega, open_loop.telescope.weights.rpe_window) if relative else 1.0
    power = np.sum(np.abs(to_error) ** 2, axis=(1, 2)) * weight**2
    assert by_states == pytest.approx(np.sqrt(np.trapezoid(power, omega) * DT / np.pi), rel=0.02)

    closed = nominal[:, -2:, :m] + nominal[:, -2:, u] @ control @ sensed @ nominal[:, :y, :m]
    gains = np.linalg.norm(closed, ord=2, axis=(1, 2)) * weight / bounds.limits(omega)
    for noise, tone in zip(plant.noises[:-1], tones, strict=True):
        P = linalg.solve_discrete_lyapunov(A, noise.process @ noise.process.T)
        worst = gains[(omega > 0.05 * tone) & (omega < 20.0 * tone)].max()
        assert np.sqrt(np.trace(plant.C @ P @ plant.C.T)) <= worst


@pytest.mark.parametrize("stage", [pytest.param("fsm", marks=pytest.mark.further), "fsm+pma"])
def test_the_reference_has_no_unreachable_limit(open_loop, stage: str) -> None:
    """Its stored controllers keep them all."""
    lines: list[str] = []
    assert not unreachable_limits(open_loop, (stage,), lines.append) and not lines


@pytest.mark.further
def test_noise_that_hides_the_tones_is_named_with_what_would_do(telescope) -> None:
    lines: list[str] = []
    (found,) = unreachable_limits(open_loop_of(noisy(telescope, 200.0)), ("fsm+pma",), lines.append)
    assert lines == [str(found)] and found.names == ("slow", "noise -> RPE") and found.error == "relative error"
    assert 1.1 < found.factor < 2.0 and found.noise is not None and 0.02 < found.noise < 0.5
    advice = f"of the relative error must be at least {40 * found.factor:.3g} mas, got 40 mas, or sensor noise"
    assert advice in lines[0]


@pytest.mark.slow
def test_with_the_advised_noise_nothing_is_unreachable(telescope) -> None:
    found = StageBounds(open_loop_of(noisy(telescope, 200.0)), "fsm+pma", relative=True).conflict()
    assert found is not None and found.noise is not None
    advised = noisy(telescope, 200.0 * found.noise)
    assert StageBounds(open_loop_of(advised), "fsm+pma", relative=True).conflict() is None


@pytest.mark.further
def test_a_mirror_without_authority_does_not_reach(telescope) -> None:
    """At low frequency the mirror moves the line of sight by its sensitivity, and tones move it by more than both."""
    weak = StageBounds(open_loop_of(telescope.changed({"fsm": {"authority": 1e-5}})), "fsm", relative=False)
    found = weak.reach()
    assert found is not None and found.names == ("APE", "mirror") and found.noise is None
    strong = StageBounds(open_loop_of(telescope), "fsm", relative=False)
    assert strong.reach() is None
    moved = np.linalg.norm(strong.responses[:, :, : strong.open_loop.disturbances], ord=2, axis=(1, 2)).max()
    kept = strong.limits(np.array([found.tones[0]]))[0] + 0.1 * 0.985e-5
    assert found.factor == pytest.approx(moved / kept, rel=0.02)


def test_a_disturbance_without_amplitude_changes_nothing_else(telescope) -> None:
    """One moment of the wheels is zero at all frequencies, where the others are not."""
    without = telescope.changed({"weights": {"wheel_imbalance": [0.4, 0.4, 0.35, 0.3, 0.0]}})
    plant, tones = StageBounds(open_loop_of(without), "fsm", relative=True).plant_with_noises()
    assert len(tones) == 10 and all(np.isfinite(noise.process).all() for noise in plant.noises)
    assert np.isfinite(plant.A).all() and np.isfinite(plant.M).all()


def test_no_time_is_no_bound_and_is_said(open_loop) -> None:
    lines: list[str] = []
    assert unreachable_limits(open_loop, ("fsm",), lines.append, time.monotonic() - 1.0) == []
    assert lines == ["fsm, relative error: no bound for all controllers within the time limit"]


@pytest.mark.slow
def test_the_kalman_start_is_left_or_the_status_does_not_promise_an_optimum() -> None:
    stiffness = [0.25 * k for k in load_telescope().isolator.stiffness]
    telescope = load_telescope().changed({"isolator": {"stiffness": stiffness}})
    plant = observer_plant(telescope)
    structure = observer_structure(plant)
    requirements = paper_requirements(telescope, "fsm")
    model = plant({name: p.nominal for name, p in telescope.uncertain.items()})
    start = kalman_start(structure, telescope)
    problem = Problem([model], requirements, structure)
    first, _ = worst_values(problem, problem.evaluate(start, gradients=False))
    result = tune([model], requirements, structure, initial=[start], options=TuningOptions(starts=0, iterations=12))
    assert result.certificate is not None and result.certificate.stable
    assert result.soft < 0.9 * first, "the smooth phase alone lowers the start's value"
    if result.status == "converged":
        assert result.certificate.upper.max() == pytest.approx(result.soft, rel=1e-3)
