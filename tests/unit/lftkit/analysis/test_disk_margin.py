"""Disk margins: published numbers, the factor at the edge, and random factors inside the disk."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import linalg

from lftkit import System, s, sampled
from lftkit.analysis.disk_margin import disk_margin
from lftkit.proofs import disk_margins, worst_case_disk_margin


def loop(expression: Any) -> System:
    made: System = expression.system("u", "y")
    return made


LOOPS = [
    25 / (s**3 + 10 * s**2 + 10 * s + 10),
    3 / (s * (0.2 * s + 1)),
    2 * (1 - 0.1 * s) / ((s - 1) * (1 + 0.1 * s)),
    (s + 2) / (s**2 + 0.3 * s + 4),
]


def poles_with(L: System, factor: complex) -> np.ndarray[Any, Any]:
    """Poles of the loop with a complex factor of its gain."""
    A, B, C, D = L.matrices
    found: np.ndarray[Any, Any] = linalg.eigvals(A - factor * B @ C / (1.0 + factor * D.item()))
    return found


@pytest.mark.parametrize("expression", LOOPS)
@pytest.mark.parametrize("skew", [-0.5, 0.0, 1.0])
def test_every_factor_in_the_disk_is_borne_and_one_at_its_edge_is_not(expression: Any, skew: float) -> None:
    L = loop(expression)
    found = disk_margin(L, skew)
    assert found.size > 0.0
    rng = np.random.default_rng(0)
    z = np.sqrt(rng.uniform(size=400)) * np.exp(2j * np.pi * rng.uniform(size=400))
    a = min(found.size, 1.9 / (1.0 + abs(skew))) * 0.999
    for factor in (2.0 + (1.0 - skew) * a * z) / (2.0 - (1.0 + skew) * a * z):
        assert poles_with(L, factor).real.max() < 0.0
    edge = poles_with(L, found.factor)
    assert np.abs(edge - 1j * found.omega).min() < 1e-6 * max(1.0, found.omega)
    back = 2.0 * (found.factor - 1.0) / ((1.0 - skew) + (1.0 + skew) * found.factor)
    assert abs(back) == pytest.approx(found.size, rel=1e-5), "the edge of the disk"


def test_gains_and_phases_alone_are_those_of_the_disk() -> None:
    found = disk_margin(loop(LOOPS[0]))
    low, high = found.gain
    assert low == pytest.approx(1.0 / high) and found.gain_db[1] == pytest.approx(-found.gain_db[0])
    assert found.phase == pytest.approx(2.0 * np.degrees(np.arctan(found.size / 2.0)))
    L = loop(LOOPS[0])
    for factor in (low * 1.001, high * 0.999, np.exp(1j * np.radians(found.phase) * 0.999)):
        assert poles_with(L, factor).real.max() < 0.0


def test_a_sampled_loop_has_the_margin_of_its_fast_sampling() -> None:
    L = loop(LOOPS[0])
    fine = disk_margin(sampled(L, 1e-4))
    assert fine.size == pytest.approx(disk_margin(L).size, rel=1e-2)


def test_an_unstable_loop_has_none_and_several_channels_are_refused() -> None:
    assert disk_margin(loop(100 / (s + 1) ** 3)).size == 0.0
    many = System([[-1.0]], [[1.0, 0.0]], [[1.0]], [[0.0, 0.0]], [("u", 2)], [("y", 1)])  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="must have one input and one output, got 2 and 1"):
        disk_margin(many)


@pytest.mark.parametrize("skew", [1e7, -1e300, np.inf, np.nan])
def test_a_skew_that_leaves_no_digits_is_refused(skew: float) -> None:
    """For large skews the disk is a half plane; with 1e12 it had factors up to 3.4, of a loop that bears 1.919."""
    assert disk_margin(loop(LOOPS[0]), 1e6).gain[1] == pytest.approx(disk_margin(loop(LOOPS[0]), 1e5).gain[1], rel=1e-4)
    for margin in (disk_margin, disk_margins):
        with pytest.raises(ValueError, match=r"skew must be from -1e\+06 to 1e\+06"):
            margin(loop(LOOPS[0]), skew)
    with pytest.raises(ValueError, match="skew must be from"):
        worst_case_disk_margin(loop(LOOPS[0]), skew=skew)
