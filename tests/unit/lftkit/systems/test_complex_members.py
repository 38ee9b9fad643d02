"""Members with complex elements outside of their disks."""

from __future__ import annotations

import numpy as np
import pytest

from lftkit import complex_gain, s
from lftkit.proofs import robust_stability


def test_the_unstable_member_of_a_margin_can_be_looked_at() -> None:
    """c within 0.2 of 1 in ``1 / (s + c)``: five radii away there is a pole at zero."""
    lag = (1 / (s + complex_gain("c", 1.0, 0.2))).system("u", "y")
    margin = robust_stability(lag)
    assert margin.upper == pytest.approx(5.0)
    assert abs(lag.at(margin.point, beyond_range=True).poles()).max() < 1e-6
    assert lag.at({"c": 2.0}, beyond_range=True).poles() == [-2.0]
    beyond = lag.response([1.0], {"c": 1.0 + 1j}, beyond_range=True)
    assert beyond.ravel() == pytest.approx([1 / (1.0 + 2j)])
    with pytest.raises(ValueError, match=r"element 'c' must be within 0\.2 of 1, got 2"):
        lag.at({"c": 2.0})
    with pytest.raises(ValueError, match=r"element 'c' must be within 0\.2 of 1, got nan"):
        lag.at({"c": np.nan}, beyond_range=True)
    with pytest.raises(ValueError, match="value of 'c' must be real"):
        lag.at({"c": 1.0 + 2.0j}, beyond_range=True)
