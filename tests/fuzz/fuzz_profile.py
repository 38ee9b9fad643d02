"""Two ways to fuzz: a few fixed examples in `make test`, and random ones for a time (`make fuzz MINUTES=10`)."""

from __future__ import annotations

import functools
import os
import select
from collections import Counter
from collections.abc import Callable
from typing import Any, ClassVar

import pytest
from hypothesis import HealthCheck, Phase, settings

EXAMPLES = int(os.environ.get("FUZZ_EXAMPLES", "0"))
STOP = int(os.environ.get("FUZZ_STOP", "-1"))
"""Reading end of a pipe: no example begins after the other end is closed (`tests/fuzz/fuzz_for.py`)."""
QUIET = (HealthCheck.function_scoped_fixture, HealthCheck.too_slow, HealthCheck.data_too_large)
PHASES = (Phase.explicit, Phase.reuse, Phase.generate)
"""Without shrinking: it takes minutes at a second for each example, and the examples are small."""
Test = Callable[..., None]


def over() -> bool:
    """Whether no further example may begin."""
    return STOP >= 0 and bool(select.select([STOP], [], [], 0)[0])


class Count:
    """How many examples this process has started, by the name of the test."""

    examples: ClassVar[Counter[str]] = Counter()


def _one_more(test: Test) -> Test:
    """The test; each of its examples is counted, or skipped if no further one may begin."""

    @functools.wraps(test)
    def example(*values: Any, **named: Any) -> None:
        if over():
            pytest.skip("the time of the fuzzing is over")
        Count.examples[test.__name__] += 1
        test(*values, **named)

    return example


def examples(fixed: int, times: int = 1) -> Callable[[Test], Test]:
    """Settings of a test: this number of examples, always the same, or `times` FUZZ_EXAMPLES random ones."""
    if EXAMPLES:
        # hypothesis takes the same examples for every seed where the variable CI is set, unless it is told otherwise
        random = settings(
            max_examples=times * EXAMPLES,
            derandomize=False,
            deadline=None,
            print_blob=True,
            phases=PHASES,
            suppress_health_check=QUIET,
        )
        return lambda test: random(_one_more(test))
    return settings(
        max_examples=fixed, deadline=None, derandomize=True, database=None, phases=PHASES, suppress_health_check=QUIET
    )
