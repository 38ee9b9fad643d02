"""The LFT of the telescope against kinematic elimination, for every pair of ports.

Agreement is 1e-9 relative (norm of the block of a pair of ports, at each frequency). Below 0.01 rad/s paths of the
LFT cancel and the double-precision matrices determine fewer digits. The test measures how many, by changing each
entry by one unit in the last digit, and allows ten times this difference in addition, at most 1e-8.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from oracles import accurate_response as exact
from oracles import kinematic_elimination as oracle
from scipy.linalg import eigvals

from titop_plant.telescope.assembly import AssembledTelescope, build_telescope
from titop_plant.telescope.load import load_telescope
from titop_plant.telescope.telescope import Telescope

Values = dict[str, float]
TOLERANCE, CANCELLATION_BELOW, MAX_ALLOWANCE = 1e-9, 1e-2, 1e-8
INTERNAL = ("sadm_torque", "fsm_command", "pma_force")


@dataclass(frozen=True)
class Case:
    """The telescope and the inputs of the oracle."""

    telescope: Telescope
    assembled: AssembledTelescope
    nominal: Values
    inertia: np.ndarray

    def second_order(self, values: Values, **options: bool) -> oracle.SecondOrder:
        tables = self.telescope.to_mapping()
        return oracle.assemble(tables, *self.assembled.bodies, values, control_inertia=self.inertia, **options)


PAPER = Path(__file__).parents[3] / "examples" / "paper" / "telescope.toml"


@pytest.fixture(scope="module", params=[None, PAPER], ids=["reference", "paper"])
def case(request: pytest.FixtureRequest) -> Case:
    telescope = load_telescope(request.param)
    assembled = build_telescope(telescope)
    nominal = {name: p.nominal for name, p in telescope.uncertain.items()}
    inertia = oracle.total_inertia(oracle.assemble(telescope.to_mapping(), *assembled.bodies, nominal).M)
    return Case(telescope, assembled, nominal, inertia)


def spread(rng: np.random.Generator, count: int, low: float = 1e-3, high: float = 1e4) -> np.ndarray:
    """Random frequencies, one in each of `count` - 2 equal parts of the logarithmic axis, and both ends."""
    edges = np.linspace(np.log(low), np.log(high), count - 1)
    return np.exp(np.concatenate([edges[:1], rng.uniform(edges[:-1], edges[1:]), edges[-1:]]))


def disagreement(system: Any, model: oracle.SecondOrder, omega: np.ndarray, internal: bool = True) -> dict[Any, Any]:
    """Relative difference of each pair of ports at each frequency, minus the allowance for rounding."""
    inputs, outputs = (oracle.index_slices({p.name: p.size for p in side}) for side in (system.inputs, system.outputs))
    assert {p.name: p.size for p in system.inputs} == oracle.INPUTS
    assert {p.name: p.size for p in system.outputs} == oracle.OUTPUTS
    columns = np.concatenate([np.arange(40)[inputs[name]] for name in INTERNAL]) if internal else ()
    matrices = (system.A, system.B, system.C, system.D)
    found, truth = exact.accurate_response(*matrices, omega, columns), model.frequency_response(omega)
    low = omega < CANCELLATION_BELOW
    rng = np.random.default_rng(5)
    perturbed = [m * (1.0 + np.finfo(float).eps * rng.uniform(-1, 1, m.shape)) for m in matrices]
    changed = exact.accurate_response(*perturbed, omega[low], columns)
    result = {}
    for (y, rows), (u, cols) in itertools.product(outputs.items(), inputs.items()):
        expected = truth[:, oracle.index_slices(oracle.OUTPUTS)[y], oracle.index_slices(oracle.INPUTS)[u]]
        scale = np.sqrt(np.sum(np.abs(expected) ** 2, axis=(1, 2)))
        error = np.sqrt(np.sum(np.abs(found[:, rows, cols] - expected) ** 2, axis=(1, 2))) / scale
        difference = np.abs(changed[:, rows, cols] - found[low][:, rows, cols])
        rounding = np.sqrt(np.sum(difference**2, axis=(1, 2))) / scale[low]
        error[low] = np.maximum(error[low] - np.minimum(10.0 * rounding, MAX_ALLOWANCE), 0.0)
        result[y, u] = error
    return result


def worst(errors: dict[Any, Any]) -> tuple[float, Any]:
    return max((float(error.max()), pair) for pair, error in errors.items())


def test_nominal(case: Case) -> None:
    """60 frequencies over 1e-3..1e4 rad/s and every tenth natural frequency, all 72 pairs of ports."""
    model = case.second_order(case.nominal)
    resonances = np.sort(np.abs(eigvals(model.state_matrix())))[5::20]
    omega = np.sort(np.concatenate([spread(np.random.default_rng(0), 60), resonances]))
    error, pair = worst(disagreement(case.assembled.system.at({}), model, omega))
    assert error < TOLERANCE, pair


def test_random_parameter_values(case: Case) -> None:
    rng = np.random.default_rng(1)
    for values in case.assembled.system.sample_values(rng, 6):
        errors = disagreement(case.assembled.system.at(values), case.second_order(values), spread(rng, 12))
        error, pair = worst(errors)
        assert error < TOLERANCE, (pair, values)


def corners(case: Case) -> list[Values]:
    limits = {name: (p.lower, p.upper) for name, p in case.telescope.uncertain.items()}
    return [dict(zip(limits, choice)) for choice in itertools.product(*limits.values())]


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_all_corners(case: Case) -> None:
    rng = np.random.default_rng(3)
    for values in corners(case):
        errors = disagreement(case.assembled.system.at(values), case.second_order(values), spread(rng, 12))
        error, pair = worst(errors)
        assert error < TOLERANCE, (pair, values)


def test_without_isolator(case: Case) -> None:
    rng = np.random.default_rng(4)
    system = build_telescope(case.telescope, isolated=False).system
    inertia = oracle.total_inertia(case.second_order(case.nominal, isolated=False).M)
    assert system.order == case.assembled.system.order - 12
    values = system.sample_values(rng)[0]
    tables = case.telescope.to_mapping()
    model = oracle.assemble(tables, *case.assembled.bodies, values, isolated=False, control_inertia=inertia)
    error, pair = worst(disagreement(system.at(values), model, spread(rng, 30)))
    assert error < TOLERANCE, pair


def test_without_attitude_control(case: Case) -> None:
    """Free attitude: inputs of internal forces above 100 rad/s only (there is no equilibrium to subtract)."""
    rng = np.random.default_rng(6)
    system = build_telescope(case.telescope, attitude_controlled=False).system
    values = system.sample_values(rng)[0]
    model = case.second_order(values, controlled=False)
    slow = disagreement(system.at(values), model, spread(rng, 20, high=100.0), internal=False)
    fast = disagreement(system.at(values), model, spread(rng, 20, low=100.0), internal=False)
    error, pair = worst({pair: e for pair, e in slow.items() if pair[1] not in INTERNAL})
    assert error < TOLERANCE, pair
    error, pair = worst(fast)
    assert error < TOLERANCE, pair
