"""Each value of the table of docs/lftkit/norms.md, computed, agrees with all digits that are printed."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from mpmath import mp
from scipy.signal import cont2discrete

from lftkit import System, h2_norm, hankel_singular_values, hinf_norm, linf_norm, nu_gap, s
from lftkit.analysis.riccati import riccati
from lftkit.arrays import Matrices
from lftkit.synthesis import h2syn

PAGE = Path(__file__).parents[2] / "docs" / "lftkit" / "norms.md"
ROWS = dict(re.findall(r"^\| ([^|]+?) \| ([-\d. ]+?) \|", PAGE.read_text("utf-8"), re.MULTILINE))
LAG = tuple(np.array([[x]]) for x in (-1.0, 1.0, 1.0, 0.0))
THREE = (
    np.array(
        [
            [-1.017041847539126, -0.224182952826418, 0.042538079149249],
            [-0.310374015319095, -0.516461581407780, -0.119195790221750],
            [-1.452723568727942, 1.7995860837102088, -1.491935830615152],
        ]
    ),
    np.array(
        [
            [0.312858596637428, -0.164879019209038],
            [-0.864879917324456, 0.627707287528727],
            [-0.030051296196269, 1.093265669039484],
        ]
    ),
    np.array(
        [
            [1.109273297614398, 0.077359091130425, -1.113500741486764],
            [-0.863652821988714, -1.214117043615409, -0.006849328103348],
        ]
    ),
    np.zeros((2, 2)),
)


def held(matrices: Matrices) -> Matrices:
    A, B, C, D, _ = cont2discrete(matrices, 0.1)
    return A, B, C, D


def hankel(number: int) -> float:
    given = System([[1.0, -2.0], [3.0, -4.0]], [[5.0], [7.0]], [[6.0, 8.0]], [[9.0]], [("u", 1)], [("y", 1)])
    return float(hankel_singular_values(given)[number])


def optimal() -> System:
    """``z = x + u, y = x + w`` of a lag with ``w + u``."""
    ports = [("w", 1), ("u", 1)], [("z", 1), ("y", 1)]
    return h2syn(System([[-1.0]], [[1.0, 1.0]], [[1.0], [1.0]], [[0.0, 1.0], [1.0, 0.0]], *ports), "y", "u").controller


def at_rest() -> float:
    K = optimal()
    return float((K.D - K.C @ np.linalg.inv(K.A) @ K.B)[0, 0])


def entries() -> tuple[float, ...]:
    X = riccati(np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]]), np.diag([1.0, 2.0]), np.eye(1))
    assert X is not None
    return float(X[0, 0]), float(X[0, 1]), float(X[1, 1])


def gap() -> float:
    return nu_gap((1 / (s - 0.001)).system("u", "y"), (1 / (s + 0.001)).system("u", "y")).value


COMPUTED: dict[str, Callable[[], float | tuple[float, ...]]] = {
    "H2 norm, lag": lambda: h2_norm(*LAG),
    "H2 norm, lag with hold, 0.1 s": lambda: h2_norm(*held(LAG), dt=0.1),
    "H-infinity norm, unstable lag": lambda: linf_norm(-LAG[0], -LAG[1], *LAG[2:]).value,
    "H-infinity norm, three states": lambda: hinf_norm(*THREE, rtol=1e-12).value,
    "H2 norm, three states": lambda: h2_norm(*THREE),
    "H-infinity norm, three states with hold, 0.1 s": lambda: hinf_norm(*held(THREE), dt=0.1, rtol=1e-12).value,
    "H2 norm, three states with hold, 0.1 s": lambda: h2_norm(*held(THREE), dt=0.1),
    "first Hankel singular value, two states": lambda: hankel(0),
    "second Hankel singular value, two states": lambda: hankel(1),
    "pole of the H2-optimal controller": lambda: float(optimal().A[0, 0]),
    "gain at rest of the H2-optimal controller": at_rest,
    "entries of the Riccati solution, double integrator": entries,
    "nu-gap, poles at 0.001 and -0.001": gap,
}


def test_the_held_lag_has_its_exact_norm() -> None:
    """(1 - a)^2 / (1 - a^2) with a = exp(-dt); the table's source differs from it in the ninth digit."""
    with mp.workdps(40):
        assert h2_norm(*held(LAG), dt=0.1) == pytest.approx(float(mp.sqrt(mp.tanh(mp.mpf(1) / 20))), rel=1e-14)


def test_the_table_and_the_test_have_the_same_rows() -> None:
    assert ROWS.keys() == COMPUTED.keys()


@pytest.mark.parametrize("name", COMPUTED)
def test_all_printed_digits_agree(name: str) -> None:
    """To one unit of the last place, as some sources cut digits off; to 1e-12 where there are more of them."""
    printed, found = ROWS[name].split(), np.atleast_1d(COMPUTED[name]())
    assert len(printed) == len(found)
    for digits, value in zip(printed, found):
        unit = 10.0 ** -len(digits.partition(".")[2])
        assert value == pytest.approx(float(digits), rel=1e-12, abs=min(unit, 1e-6) if "." not in digits else unit)
