"""The tuner on published and structural problems, beside general optimisers on the same functions.

    python benchmarks/tuning.py [--quick] [--json]

For each problem: seconds, function evaluations and final value of one start, with the value certified on the
assembled loop. In the
same run SciPy's BFGS (same values and gradients of the worst requirement, a large value outside the domain; Lewis
and Overton 2013
found BFGS good on such functions) and COBYQA (a public derivative-free trust-region method, in SciPy since 1.14)
start from the same
stabilised point with the same number of evaluations or more.
"""

from __future__ import annotations

import argparse
import json
import time
from contextlib import suppress
from typing import Any

import numpy as np
import scipy.optimize
from threadpoolctl import threadpool_limits

from lti import StateSpace, transfer
from robust_design import H2Gain, HinfGain, TuningOptions, certify, controller, gain, state_space
from robust_design.problem import Problem, worst_values
from robust_design.published_plants import PLANTS
from robust_design.starts import starts_of
from robust_design.tuner import tune_from

BUDGET = 400


def static(name: str) -> Problem:
    """Static output feedback of a published plant."""
    plant = PLANTS[name]()
    return Problem([plant], [HinfGain("w", "z")], gain([plant.outputs[1]], [plant.inputs[1]]))


def dynamic(name: str, order: int) -> Problem:
    """Controller of fixed order of a published plant."""
    plant = PLANTS[name]()
    return Problem([plant], [HinfGain("w", "z")], state_space([plant.outputs[1]], [plant.inputs[1]], order))


def flexible(models: int, modes: int) -> Problem:
    """Vibration control of a lightly damped structure: several models, H-infinity and H2 requirements, order 4."""
    return Problem(
        [_structure(0.02 * k, modes) for k in range(models)], _needs(), state_space([("y", 3)], [("u", 3)], 4)
    )


def _needs() -> list[Any]:
    weight = transfer([1, 0], [1, 1], 2)
    return [HinfGain("w", "z", weight_out=weight, bound=10.0, name="peak"), H2Gain("w", "z", bound=10.0, name="rms")]


def _structure(shift: float, modes: int) -> StateSpace:
    rng = np.random.default_rng(1)
    w = np.sort(10 ** rng.uniform(0, 2.5, modes)) * (1 + shift * rng.uniform(-1, 1, modes))
    zeta = 10 ** rng.uniform(-3, -1.7, modes)
    A = np.zeros((2 * modes, 2 * modes))
    i = np.arange(modes)
    A[2 * i, 2 * i + 1], A[2 * i + 1, 2 * i], A[2 * i + 1, 2 * i + 1] = w, -w, -2 * zeta * w
    Bu, Bw = rng.normal(size=(modes, 3)), rng.normal(size=(modes, 4))
    B, C = np.zeros((2 * modes, 7)), np.zeros((5, 2 * modes))
    B[1::2] = np.hstack([Bw, Bu])
    C[:2, ::2] = rng.normal(size=(2, modes)) / w
    C[2:, 1::2] = Bu.T  # collocated rates
    return StateSpace(A, B, C, np.zeros((5, 7)), [("w", 4), ("u", 3)], [("z", 2), ("y", 3)], f"shift {shift}")


PROBLEMS: dict[str, Any] = {
    **{f"{n} static": (lambda n=n: static(n)) for n in ("AC2", "AC3", "AC15", "AC17", "HE1", "HE2", "REA1", "DIS3")},
    "AC4 order 2": lambda: dynamic("AC4", 2),
    "REA2 order 2": lambda: dynamic("REA2", 2),
    "structure, 20 states, 3 models": lambda: flexible(3, 10),
    "structure, 200 states, 3 models": lambda: flexible(3, 100),
}


def penalised(problem: Problem, x: np.ndarray, counter: list[int]) -> tuple[float, np.ndarray]:
    """Worst value and its gradient; far above everything outside the domain."""
    counter[0] += 1
    found = problem.evaluate(x)
    value = worst_values(problem, found)[0]
    if not np.isfinite(value):
        return 1e6 * (1.0 + found.abscissa), np.zeros(len(x))
    best = max(found.pieces, key=lambda p: p.value)
    return value, best.gradient


def reference(problem: Problem, x0: np.ndarray, method: str, budget: int) -> dict[str, Any]:
    """A general optimiser from the same point."""
    counter, best = [0], [np.inf]

    def value(x: np.ndarray) -> Any:
        if counter[0] >= budget:
            raise _BudgetSpentError
        f, g = penalised(problem, x, counter)
        best[0] = min(best[0], f)
        return f if method == "COBYQA" else (f, g)

    start = time.perf_counter()
    options = {"maxfev": budget} if method == "COBYQA" else {"maxiter": budget}
    with suppress(_BudgetSpentError):
        scipy.optimize.minimize(value, x0, jac=method != "COBYQA", method=method, options=options)
    return {"value": best[0], "evaluations": counter[0], "seconds": time.perf_counter() - start}


class _BudgetSpentError(Exception):
    pass


def stabilised(problem: Problem) -> np.ndarray:
    """The point from which everybody starts: the second random start, made stable."""
    for x, seed in starts_of([], 8, 0, problem):
        run = tune_from(problem, x, seed, TuningOptions(iterations=60, target=np.inf), time.monotonic() + 60)
        if np.isfinite(run.soft):
            return run.x
    raise RuntimeError("no start was stabilised")


def measure(problem: Problem) -> dict[str, Any]:
    """One problem, three methods."""
    x0 = stabilised(problem)
    start = time.perf_counter()
    run = tune_from(problem, x0, 0, TuningOptions(iterations=BUDGET), time.monotonic() + 300)
    seconds = time.perf_counter() - start
    K = controller(problem.structure, run.x)
    certified = certify(problem.models, K, problem.requirements, problem.loop_delay)
    budget = max(run.evaluations, BUDGET)
    return {
        "start": worst_values(problem, problem.evaluate(x0, gradients=False))[0],
        "value": run.soft,
        "certified": float(certified.values.max()),
        "evaluations": run.evaluations,
        "seconds": seconds,
        "status": run.status,
        "scipy_bfgs": reference(problem, x0, "BFGS", budget),
        "cobyqa": reference(problem, x0, "COBYQA", budget) if problem.structure.size < 40 else None,
    }


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="four problems only")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    chosen = list(PROBLEMS)[:4] if arguments.quick else list(PROBLEMS)
    results = {}
    with threadpool_limits(1):
        for name in chosen:
            results[name] = found = measure(PROBLEMS[name]())
            if not arguments.json:
                other = found["cobyqa"] or {"value": float("nan")}
                print(
                    f"{name:32s} from {found['start']:10.4g}: ours {found['value']:10.5g} "
                    f"({found['evaluations']} evaluations, {found['seconds']:.1f} s, {found['status']}), "
                    f"BFGS {found['scipy_bfgs']['value']:10.5g}, "
                    f"COBYQA {other['value']:10.5g}",
                    flush=True,
                )
    if arguments.json:
        print(json.dumps(results))


if __name__ == "__main__":
    main()
