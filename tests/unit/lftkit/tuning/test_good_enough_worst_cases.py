"""Worst cases of tune_robust that are good enough."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest

from lftkit import System
from lftkit.tuning import HinfGain, RobustOptions, TuningOptions, WorstCaseOptions, gain, tune_robust


def build(p: Mapping[str, float]) -> System:
    """x' = -x + w + u, z = p x, y = x: the gain is p / (1 - k)."""
    return System(
        [[-1.0]], [[1.0, 1.0]], [[p["p"]], [1.0]], [[0.0, 0.0]] * 2, [("w", 1), ("u", 1)], [("z", 1), ("y", 1)]
    )


def test_options_of_a_tuning_are_refused() -> None:
    options: Any = TuningOptions(starts=0)
    with pytest.raises(ValueError, match=r"^options must be RobustOptions, got TuningOptions$"):
        tune_robust(build, {"p": (1.0, 1.2)}, [HinfGain("w", "z")], gain([("y", 1)], [("u", 1)]), options=options)


@pytest.mark.parametrize(
    ("field", "value"), [("slack", -0.1), ("max_rounds", 0), ("carried", 0), ("first_share", 0.0), ("round_share", 1.1)]
)
def test_bad_options_are_a_line(field: str, value: Any) -> None:
    with pytest.raises(ValueError, match=rf"^[^\n]*{field}[^\n]*{value}"):
        RobustOptions(**{field: value})


@pytest.mark.parametrize(("met", "models"), [(0.65, 1), (-float("inf"), 2)])
def test_worst_cases_up_to_the_value_given_end_the_rounds(met: float, models: int) -> None:
    """With k >= -1 the nominal model reaches 1/2 and the worst parameter 0.6, which is above what was tuned."""
    free = gain([("y", 1)], [("u", 1)])
    result = tune_robust(
        build,
        {"p": (1.0, 1.2)},
        [HinfGain("w", "z")],
        free.with_bounds(dict.fromkeys(free.names, (-1.0, 0.0))),
        active=[{"p": 1.0}],
        initial=[[0.0]],
        options=RobustOptions(TuningOptions(starts=0, met=met), WorstCaseOptions(samples=4, climbs=1, iterations=4)),
    )
    (worst,) = result.worst
    assert str(result.status) == "converged" and len(result.active) == models
    assert worst.value == pytest.approx(0.6, rel=1e-3)
