"""Disk margins, robust stability and structured singular values of the page of published values."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from lftkit import System, complex_gain, disk_margin, dynamic, feedback, hinf_norm, matrix, real, s
from lftkit.proofs import BoundOptions, complex_block, disk_margins, full_block, mu, real_block, robust_stability

Values = Any
CLOSE = BoundOptions(gap=1e-3)
SLICOT = np.array(
    [
        [-1 + 6j, 2 - 3j, 3 + 8j, 3 + 8j, -5 - 9j, -6 + 2j],
        [4 + 2j, -2 + 5j, -6 - 7j, -4 + 11j, 8 - 7j, 12 - 1j],
        [5 - 4j, -4 - 8j, 1 - 3j, -6 + 14j, 2 - 5j, 4 + 16j],
    ]
    * 2
)
SATELLITE = System(
    [[0.0, 10.0], [-10.0, 0.0]], np.eye(2), [[1.0, 10.0], [-10.0, 1.0]], np.zeros((2, 2)), [("u", 2)], [("y", 2)]
)


def third_order() -> Values:
    found = disk_margin((25 / (s**3 + 10 * s**2 + 10 * s + 10)).system("u", "y"))
    return found.size, *found.gain, found.phase


def satellite(gain: list[list[float]]) -> System:
    """Loop at the output of the plant."""
    law = System(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((2, 0)), gain, [("e", 2)], [("v", 2)])
    return SATELLITE @ law


def together(gain: list[list[float]]) -> tuple[float, float]:
    """Bounds of the size of the disk of both loops, within 0.1 %."""
    found = disk_margins(satellite(gain), options=CLOSE).together
    assert found.upper <= 1.001 * found.lower
    return found.lower, found.upper


def triangular() -> tuple[float, float]:
    return together([[1.0, -2.0], [0.0, 1.0]])


def with_dynamics() -> System:
    """The PID loop, whose dynamics are of norm one."""
    plant = (1 / (s**2 + 0.2 * s + 1)) * (1 + 0.2 * dynamic("d"))
    return feedback(plant.system("u", "y") @ (1 + 2 / s + 0.9 * s / (0.1 * s + 1)).system("e", "u"))


def seen_by_dynamics() -> float:
    loop = with_dynamics()
    return hinf_norm(loop.A, loop.B[:, :1], loop.C[:1], loop.D[:1, :1]).value


def two_real_gains() -> float:
    plant = System(
        [[0.0, 1.0], [-1.0, -1.0]], np.eye(2), [[1.0, 1.0], [0.0, 1.0]], np.zeros((2, 2)), [("u", 2)], [("y", 2)]
    )
    first, second = real("first", 0.0, -1.0, 1.0), real("second", 0.0, -1.0, 1.0)
    found = robust_stability(
        feedback(plant @ matrix([[1 + first, 0], [0, 1 + second]]).system("v", "u")), options=CLOSE
    )
    assert found.upper <= 1.001 * found.lower
    return found.upper


def two_complex_gains() -> float:
    """What is proven."""
    plant = System([[0.0, 1.0], [0.0, 0.0]], np.eye(2), [[1.0, 0.0]], np.zeros((1, 2)), [("u", 2)], [("y", 1)])
    first, second = complex_gain("first", 0.0, 1.0), complex_gain("second", 0.0, 1.0)
    law = System(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((2, 0)), [[1.0], [1.0]], [("e", 1)], [("v", 2)])
    loop = plant @ matrix([[1 + first, 0], [0, 1 + second]]).system("v", "u") @ law
    return robust_stability(feedback(loop), options=CLOSE).lower


def robust_pid() -> float:
    found = robust_stability(with_dynamics(), options=CLOSE)
    assert found.upper <= 1.001 * found.lower
    return found.lower


def slicot_bounds() -> tuple[float, float]:
    blocks = [real_block(), real_block(), full_block(2), complex_block(), complex_block()]
    bounds = mu(SLICOT, blocks, rtol=1e-8)
    return bounds.lower, bounds.upper


def rank_one(blocks: list) -> float:
    return mu([[2.0, 2.0], [-1.0, -1.0]], blocks, rtol=1e-7).upper


COMPUTED: dict[str, Callable[[], Values]] = {
    "disk margin of 25 / (s^3 + 10 s^2 + 10 s + 10): size, gains, phase": third_order,
    "disk margin of the spinning satellite, one loop: size and phase": lambda: (
        (one := disk_margins(satellite([[1.0, 0.0], [0.0, 1.0]])).each[0]).size,
        one.phase,
    ),
    "disk margin of the spinning satellite, both loops": lambda: together([[1.0, 0.0], [0.0, 1.0]])[1],
    "robust stability of a PID loop with 20 % of dynamics": robust_pid,
    "largest gain of a PID loop seen by 20 % of dynamics": seen_by_dynamics,
    "robust stability, two real gains": two_real_gains,
    "structured singular value of 5.34, real": lambda: mu([[5.34]], [real_block()]).upper,
    "structured singular value of [[2, 2], [-1, -1]], full block and two scalars": lambda: (
        rank_one([full_block(2)]),
        rank_one([complex_block(), complex_block()]),
    ),
    "structured singular value, six by six, lower and upper bound": slicot_bounds,
}
