"""The comparison with others that users start: rows that are true, BFGS that minimises, options that are refused."""

from __future__ import annotations

import json
import time

import numpy as np
import pytest

from lftkit import hinf_norm
from lftkit.arrays import FloatArray
from lftkit.benchmarks.bfgs import FixedOrderLoop, bfgs, level_iteration
from lftkit.benchmarks.command_line import main
from lftkit.benchmarks.norms import random_system
from lftkit.tuning.published_plants import PLANTS


def rows(capsys: pytest.CaptureFixture[str], *arguments: str) -> list[dict[str, object]]:
    main(list(arguments))
    return [json.loads(line) for line in capsys.readouterr().out.splitlines()]


def test_bfgs_finds_the_minimum_of_rosenbrocks_valley() -> None:
    def valley(x: FloatArray) -> tuple[float, FloatArray]:
        a, b = 1.0 - x[0], x[1] - x[0] ** 2
        return float(a * a + 100.0 * b * b), np.array([-2.0 * a - 400.0 * x[0] * b, 200.0 * b])

    x, value = bfgs(valley, np.array([-1.2, 1.0]), time.monotonic() + 60.0)
    assert value < 1e-12 and x == pytest.approx([1.0, 1.0], abs=1e-5)


@pytest.mark.parametrize("seed", range(2))
def test_its_norm_is_that_of_the_library_and_its_gradient_that_of_differences(seed: int) -> None:
    """Where the loop is stable: the plant HE1 with a weak controller of order 1."""
    loop, rng = FixedOrderLoop(PLANTS["HE1"](), 1), np.random.default_rng(seed)
    while True:
        x = 0.3 * rng.standard_normal(loop.shape).ravel()
        value, slope = loop.norm(x)
        if np.isfinite(value):
            break
    norm = hinf_norm(*loop.closed(x))
    assert norm.value * (1.0 - 1e-6) <= value <= norm.upper
    direction = rng.standard_normal(len(x))
    ahead, behind = (loop.norm(x + h * direction)[0] for h in (1e-6, -1e-6))
    assert (ahead - behind) / 2e-6 == pytest.approx(float(slope @ direction), rel=1e-3, abs=1e-6)


def test_the_level_iteration_ends_at_the_peak() -> None:
    for seed in range(5):
        A, B, C, D = random_system(np.random.default_rng(seed), 6, discrete=False)
        omega = level_iteration(A, B, C, D, np.abs(np.linalg.eigvals(A)))
        response = D if np.isinf(omega) else C @ np.linalg.solve(1j * omega * np.eye(6) - A, B) + D
        assert np.linalg.norm(response, 2) == pytest.approx(hinf_norm(A, B, C, D).value, rel=1e-6)


def test_rows_of_norms_and_responses(capsys: pytest.CaptureFixture[str]) -> None:
    found = rows(capsys, "norms", "--orders", "1,30", "--samples", "2")
    assert [(row["time"], row["states"]) for row in found] == [
        (kind, states) for kind in ("continuous", "discrete") for states in (1, 30)
    ]
    assert all(row["seconds"] > 0.0 for row in found)  # type: ignore[operator]
    (row,) = rows(capsys, "responses", "--orders", "10")
    assert row["states"] == 10 and row["relative_difference"] < 1e-9  # type: ignore[operator]


def test_a_row_of_tuning(capsys: pytest.CaptureFixture[str]) -> None:
    (row,) = rows(capsys, "tuning", "--plants", "DIS1", "--seconds", "0.5")
    assert row["plant"] == "DIS1" and {"ours", "bfgs", "status", "best_known"} <= row.keys()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ("norms --orders 0", "expected positive whole numbers separated by commas, got '0'"),
        ("tuning --plants AC99", "got AC99"),
        ("tuning --seconds nan", "expected a positive number, got 'nan'"),
        ("tuning --order -1", "expected a whole number from 0 on, got '-1'"),
        ("", "the following arguments are required: command"),
    ],
)
def test_wrong_options_are_one_line(arguments: str, said: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(arguments.split())
    assert ended.value.code == 2 and said in capsys.readouterr().err.splitlines()[-1]
