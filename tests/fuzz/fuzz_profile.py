"""Two ways to fuzz: a few fixed examples in `make test`, and random ones for a time (`make fuzz MINUTES=10`)."""

import os

from hypothesis import HealthCheck, Phase, settings

EXAMPLES = int(os.environ.get("FUZZ_EXAMPLES", "0"))
QUIET = (HealthCheck.function_scoped_fixture, HealthCheck.too_slow, HealthCheck.data_too_large)
PHASES = (Phase.explicit, Phase.reuse, Phase.generate)
"""Without shrinking: it takes minutes at a second for each example, and the examples are small."""


def examples(fixed: int, times: int = 1) -> settings:
    """Settings of a test: this number of examples, always the same, or `times` FUZZ_EXAMPLES random ones."""
    if EXAMPLES:
        return settings(
            max_examples=times * EXAMPLES, deadline=None, print_blob=True, phases=PHASES, suppress_health_check=QUIET
        )
    return settings(
        max_examples=fixed, deadline=None, derandomize=True, database=None, phases=PHASES, suppress_health_check=QUIET
    )
