"""Cases of the campaign on signed bags, among them those in which an old reader took what nobody had signed."""

from __future__ import annotations

import pytest
from fuzz.forged_bag_campaign import KINDS, TOLD, Signed, case, make_signed

from pointing_analysis.read.mcap.records import OP_CHUNK, OP_MESSAGE

FOUND = (408, 412, 444, 646, 744)
"""Messages and chunks in front of the first manifest, which 6a8cdd82 read without a contradiction."""


@pytest.fixture(scope="module")
def signed(tmp_path_factory: pytest.TempPathFactory) -> Signed:
    return make_signed(tmp_path_factory.mktemp("signed"))


@pytest.mark.parametrize("number", [*range(3), *FOUND])
def test_nothing_is_read_that_was_not_signed(signed: Signed, number: int) -> None:
    assert case(signed, f"20261 {number}") == "", TOLD
    assert TOLD and {OP_MESSAGE, OP_CHUNK} < set(KINDS)
