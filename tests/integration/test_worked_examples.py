"""The three worked examples of docs/lftkit/tuning.md run and say what the page says."""

from __future__ import annotations

import runpy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

EXAMPLES = Path(__file__).parents[2] / "examples"


def run(name: str) -> Any:
    return runpy.run_path(str(EXAMPLES / f"{name}.py"))


@pytest.mark.slow
def test_robust_mass_spring_damper() -> None:
    example = run("robust_mass_spring_damper")
    result = example["main"]()
    assert result.status == "converged"
    assert result.rounds[0].worst_soft > 1.5 * result.rounds[0].soft, "the nominal design is fragile"
    assert all(w.value <= 1.01 for w in result.worst), "the robust one keeps every requirement in the box"
    # an independent look at 200 random plants and the corners
    from lftkit.tuning import certify

    rng = np.random.default_rng(5)
    low, high = np.array(list(example["BOX"].values())).T
    corners = [low + (high - low) * np.array([i & 1, i >> 1 & 1, i >> 2]) for i in range(8)]
    points = [*corners, *rng.uniform(low, high, size=(200, 3))]
    models = [example["build"](dict(zip(example["BOX"], p))) for p in points]
    found = certify(models, result.controller, example["REQUIREMENTS"])
    assert found.stable
    assert found.values.max() <= 1.01


@pytest.mark.slow
def test_fixed_order_missile_autopilot() -> None:
    example = run("fixed_order_missile_autopilot")
    results = example["main"]()
    bound = example["FULL_ORDER_OPTIMUM"]
    assert results[0].soft == pytest.approx(0.93547, abs=1e-5)
    for order in (1, 2, 4):
        assert bound * (1 - 1e-6) <= results[order].soft <= 1.02 * bound
        assert results[order].certificate.upper.max() == pytest.approx(results[order].soft, rel=2e-5)


@pytest.mark.further
def test_multi_requirement_pid() -> None:
    example = run("multi_requirement_pid")
    result = example["main"]()
    assert result.feasible and result.certificate.stable
    assert result.certificate.values[1:].max() <= 1 + 1e-4
    assert result.certificate.values == pytest.approx(result.values, rel=1e-3)
    # the load rejection cannot be had without touching a margin
    assert result.values[1:].max() == pytest.approx(1.0, abs=1e-4)
    # time simulation of the sensitivity peak's meaning: an open-loop distance of 1 / 1.7 from -1, with the exact delay
    plant, K = example["process"](), result.controller
    w = np.geomspace(1e-3, 1e2, 4000)
    distance = []
    for x in w:
        P = plant.C[[3]] @ np.linalg.solve(1j * x * np.eye(4) - plant.A, plant.B[:, [3]])
        C = K.D + K.C @ np.linalg.solve(1j * x * np.eye(K.order) - K.A, K.B)
        distance.append(abs(1 - (P * C).item() * np.exp(-1j * x * example["DELAY"])))
    assert min(distance) >= 0.45
