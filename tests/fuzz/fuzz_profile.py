"""Two ways to fuzz: a few fixed examples in `make test`, and random ones for a time (`make fuzz MINUTES=10`)."""

import os

from hypothesis import HealthCheck, settings

EXAMPLES = int(os.environ.get("FUZZ_EXAMPLES", "0"))
QUIET = (HealthCheck.function_scoped_fixture, HealthCheck.too_slow, HealthCheck.data_too_large)


def examples(fixed: int) -> settings:
    """Settings of a test: this number of examples, always the same, or FUZZ_EXAMPLES random ones."""
    if EXAMPLES:
        return settings(max_examples=EXAMPLES, deadline=None, print_blob=True, suppress_health_check=QUIET)
    return settings(max_examples=fixed, deadline=None, derandomize=True, database=None, suppress_health_check=QUIET)
