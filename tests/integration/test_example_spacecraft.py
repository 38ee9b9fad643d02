"""The CubeSat of the examples: low-frequency inertia of the rigid bodies, a wheel that turns the other way."""

from __future__ import annotations

import runpy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.fixture(scope="module")
def example() -> dict[str, Any]:
    return runpy.run_path(str(EXAMPLES / "cubesat_boom_and_wheel.py"))


def rigid_inertia(example: dict[str, Any]) -> np.ndarray:
    """Tensor about the common centre of mass: hub, tube, tip and the wheel, which turns freely about z."""
    outer, inner = 0.006, 0.006 - 0.0004
    tube = 2700.0 * np.pi * (outer**2 - inner**2) * 1.0  # [kg], 1 m long
    across = tube * (1.0 / 12.0 + (outer**2 + inner**2) / 4.0)
    wheel = example["WHEEL"]
    parts = (
        (12.0, [0.0, 0.0, 0.0], [0.12, 0.08, 0.13]),
        (tube, [0.0, 0.17 + 0.5, 0.05], [across, tube * (outer**2 + inner**2) / 2.0, across]),
        (0.15, [0.0, 0.17 + 1.0, 0.05], [2e-5] * 3),
        (wheel.mass, [0.0, 0.0, -0.05], [wheel.radial_inertia, wheel.radial_inertia, 0.0]),
    )
    centre = sum(m * np.array(r) for m, r, _ in parts) / sum(m for m, _, _ in parts)
    total = np.zeros((3, 3))
    for m, r, own in parts:
        d = np.array(r) - centre
        total += np.diag(own) + m * (d @ d * np.eye(3) - np.outer(d, d))
    return total


def test_a_torque_of_the_wheel_turns_hub_and_wheel_in_opposite_senses(example: dict[str, Any]) -> None:
    """Below the modes the hub has the acceleration J^-1 [0; 0; u], the wheel -u / J_w less that of the hub."""
    still = example["cubesat"]().at({"wheel.speed": 0.0})
    s = 0.05j
    gain = (still.C @ np.linalg.solve(s * np.eye(still.A.shape[0]) - still.A, still.B) + still.D).real
    rows, columns = still.output_indices, still.input_indices
    hub = gain[rows(["accel_G"])[5], columns(["wheel_torque"])[0]]
    wheel = gain[rows(["wheel_accel"])[0], columns(["wheel_torque"])[0]]
    assert hub == pytest.approx(np.linalg.inv(rigid_inertia(example))[2, 2], rel=1e-4)
    assert wheel == pytest.approx(-1.0 / example["WHEEL"].axial_inertia - hub, rel=1e-9)


@pytest.mark.slow
def test_the_figures_of_the_closed_loop_are_drawn(tmp_path: Path) -> None:
    from los_design.figures.figures import draw

    paths = draw(tmp_path, 0, names=["controllers", "stages_implemented"])
    assert [path.name for path in paths] == [
        f"{name}.{suffix}" for name in ("controllers", "stages_implemented") for suffix in ("png", "svg")
    ]
    assert all(path.stat().st_size > 10_000 for path in paths)


def test_the_stewart_platform_has_the_modes_of_its_legs() -> None:
    """Poles of the block against energies: the stiffness along any motion is the sum over the legs."""
    example = runpy.run_path(str(EXAMPLES / "stewart_platform_isolator.py"))
    J, k = example["leg_matrix"](), example["LEG_STIFFNESS"]
    motion = np.random.default_rng(0).standard_normal(6)
    stretch = J.T @ motion  # of each leg
    system = example["platform"](0.0).at({})
    stored = motion @ system.C[:6, :6] @ motion
    assert stored == pytest.approx(k * float(stretch @ stretch), rel=1e-12)
    poles = np.linalg.eigvals(system.A)
    modes = np.linalg.eigvals(np.linalg.solve(example["PAYLOAD"], k * J @ J.T))
    np.testing.assert_allclose(np.sort(np.abs(poles))[::2] ** 2, np.sort(modes.real), rtol=1e-9)
    vertical = k * float(J[2] @ J[2]) / 60.0  # symmetric legs: the mode along z is that of mass and vertical stiffness
    assert np.abs(np.sort(modes.real) / vertical - 1.0).min() < 1e-9
    example["main"]()
