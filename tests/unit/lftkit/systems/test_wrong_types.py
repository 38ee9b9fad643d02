"""Arguments of other types than the documented ones are one line, not a fault of the program."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from lftkit import InputError, RealParameter, System, balred, sampled, to_json, to_scipy

P = RealParameter("p", 0.0, -1.0, 1.0)
MATRICES = [[-1.0]], [[1.0, 1.0]], [[1.0], [1.0]], [[0.0, 0.0], [0.0, 0.0]], [("u", 1)], [("y", 1)]
UNCERTAIN = System(*MATRICES, channels=("p",), elements=(P,))
NOMINAL = UNCERTAIN.nominal()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda wrong: NOMINAL(wrong), "point must be a finite number"),
        (lambda wrong: UNCERTAIN.sorted_channels(wrong), "order must name p"),
        (lambda wrong: System(*MATRICES, channels=wrong, elements=(P,)), "channels must be a sequence of names"),
        (lambda wrong: System(*MATRICES, channels=("p",), elements=wrong), "elements must be a sequence of elements"),
        (lambda wrong: sampled(NOMINAL, 0.1, provenance=wrong), "provenance must be a mapping"),
        (to_json, "system must be a System"),
        (to_scipy, "system must be a System"),
    ],
)
@pytest.mark.parametrize("wrong", [object(), [None], ["q", 3]])
def test_another_type_is_a_line(call: Callable[[Any], Any], message: str, wrong: Any) -> None:
    with pytest.raises(InputError, match=message):
        call(wrong)


def test_a_message_is_one_line_whatever_came() -> None:
    """The text of a system has several."""
    with pytest.raises(InputError) as caught:
        balred(NOMINAL, NOMINAL)
    assert "\n" not in str(caught.value)
