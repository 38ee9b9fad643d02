"""A reduction whose Hankel singular values are printed."""

from __future__ import annotations

import pytest
from published.values.norms import slicot_reduction

from lftkit import balred, hankel_singular_values, hinf_norm


def test_the_example_of_slicot() -> None:
    """Five of seven states are kept; the values are on the page of published values."""
    given = slicot_reduction()
    found = balred(given, 5)
    assert found.tail_bound == pytest.approx(2.0 * (0.0253 + 0.0246), abs=2e-4)
    assert found.error_bound == pytest.approx(hinf_norm(*(given - found.system).matrices).value, rel=1e-6)
    # what any five states lose is at least the next value
    assert 2.0 * hankel_singular_values(given)[5] <= found.error_bound * (1.0 + 1e-6)
