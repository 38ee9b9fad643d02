"""Each value of docs/lftkit/published_values.csv, computed, agrees with all digits that are printed."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from mpmath import mp, mpc, mpf
from published.values import margins, norms, robustness, synthesis

from lftkit import h2_norm, s
from lftkit.synthesis import h2syn

FOLDER = Path(__file__).parents[2] / "docs" / "lftkit"
SUMMARY = (FOLDER / "published_values.md").read_text("utf-8").split("## Values that differ")[0]
TABLE = list(csv.DictReader((FOLDER / "published_values.csv").read_text("utf-8").splitlines()))
ROWS = {row["quantity"]: row["printed"] for row in TABLE}
OTHERS = csv.DictReader((FOLDER / "values_that_differ.csv").read_text("utf-8").splitlines())
DIFFERENT = {row["quantity"]: (row["printed"], row["here"]) for row in OTHERS}
COMPUTED = {**norms.COMPUTED, **margins.COMPUTED, **robustness.COMPUTED, **synthesis.COMPUTED}
RESONANT = margins.system(margins.RESONANT)
TRIPLE = margins.system((s + 0.1) ** 2 / (s**3 * (s + 1)))
"""Quantities of both tables: what this library says, and the same with 40 digits, a closed form or a proven value."""


def crossing(loop: Callable[[object], object], sign: Callable[[object], object], near: float) -> object:
    """Frequency at which the sign of a response is zero, with 40 digits."""
    return mp.findroot(lambda omega: sign(loop(mpc(0, omega))), mpf(near))


def angle(loop: Callable[[object], object], near: float) -> float:
    """Phase margin [deg] at the crossing of the gain 1 near a frequency, with 40 digits."""
    omega = crossing(loop, lambda value: abs(value) - 1, near)
    return float(mp.degrees(mp.arg(-loop(mpc(0, omega)))))


def example_21(p: object) -> object:
    num = mpf("0.002") * (p + mpf("0.02")) * (p + mpf("0.05")) * (p + 5) * (p + 10)
    den = (p - mpf("0.0005")) * (p + mpf("0.0001")) * (p + mpf("0.01")) * (p + mpf("0.2")) * (p + 1) * (p + 100) ** 2
    return num / den


def resonant(p: object) -> object:
    num = mpf("8.75") * (4 * p**2 + mpf("0.4") * p + 1)
    return num / ((100 * p + 1) * (p**2 + mpf("0.22") * p + 1) * (p**2 / 100 + mpf("0.008") * p + 1))


def second_margin() -> float:
    omega = crossing(example_21, lambda value: value.imag / abs(value), 0.024341)
    return float(-1 / example_21(mpc(0, omega)).real)


def integrators(p: object) -> object:
    return (p + mpf("0.1")) ** 2 / (p**3 * (p + 1))


def lag_gain() -> float:
    return -float(h2syn(synthesis.example_19_1(), "y", "u").controller.C[0, 1])


COMPLEX, DISKS = "robust stability, two complex gains", "H-infinity optimum, four disks"
TRIANGULAR = "disk margin of the spinning satellite with a triangular gain, both loops"
GOLDEN = (np.sqrt(5.0) - 1.0) / 2.0
EXACT: dict[str, tuple[Callable[[], float], Callable[[], float]]] = {
    "H2 norm, lag with hold, 0.1 s": (
        lambda: h2_norm(*norms.held(norms.LAG), dt=0.1),
        lambda: float(mp.sqrt(mp.tanh(mpf(1) / 20))),
    ),
    "further crossing of a lag with two resonances, phase at 1.0919 rad/s": (
        lambda: margins.joined(margins.phase(RESONANT, 2))[0],
        lambda: angle(resonant, 1.0919),
    ),
    "phase margin of a lag with two resonances": (
        lambda: margins.joined(margins.phase(RESONANT))[0],
        lambda: angle(resonant, 0.085),
    ),
    "frequency at which 2 / (s + 1)^3 has the gain 1": (
        lambda: margins.joined(margins.phase(margins.system(2 / (s + 1) ** 3)))[1],
        lambda: float(np.sqrt(np.cbrt(4.0) - 1.0)),
    ),
    "example 21, gain 1000, second gain margin": (
        lambda: margins.joined(margins.gain(margins.system(1000 * margins.EXAMPLE_21), 1))[0],
        lambda: 1e-3 * second_margin(),
    ),
    "phase margin of 2 s / (s + 1)": (
        lambda: margins.joined(margins.phase(margins.system(2 * s / (s + 1))))[0],
        lambda: -120.0,
    ),
    "gain margin of 0.8 / (s + 1)^3": (
        lambda: margins.joined(margins.gain(margins.system(0.8 / (s + 1) ** 3)))[0],
        lambda: 10.0,
    ),
    "phase margin of 2 / (s + 1)^3": (
        lambda: margins.joined(margins.phase(margins.system(2 / (s + 1) ** 3)))[0],
        lambda: angle(lambda p: 2 / (p + 1) ** 3, 0.766),
    ),
    "phase margin of (s + 0.1)^2 / (s^3 (s + 1))": (
        lambda: margins.joined(margins.phase(TRIPLE))[0],
        lambda: angle(integrators, 0.795),
    ),
    "example 21, gain 1, second gain margin": (
        lambda: margins.joined(margins.gain(margins.system(margins.EXAMPLE_21), 1))[0],
        second_margin,
    ),
    "frequency at which 1 / (s (s + 1)) has the gain 1": (
        lambda: margins.joined(margins.phase(margins.system(1 / (s * (s + 1)))))[1],
        lambda: float(np.sqrt(GOLDEN)),
    ),
    "gain of the H2-optimal controller, example 19.1": (lag_gain, lambda: 2.0 + np.sqrt(5.0)),
}


def test_the_tables_and_the_tests_have_the_same_rows() -> None:
    assert ROWS.keys() == COMPUTED.keys()
    assert DIFFERENT.keys() == EXACT.keys() | {COMPLEX, TRIANGULAR, DISKS}


def test_there_are_150_values() -> None:
    """As many of each topic as the page counts."""
    of_topic = Counter(row["topic"] for row in TABLE for _ in row["printed"].split())
    assert re.findall(r"^\|[^|]+\| (\d+) \|", SUMMARY, re.MULTILINE) == [str(count) for count in of_topic.values()]
    assert f"The {of_topic.total()} values of" in SUMMARY and of_topic.total() + len(DIFFERENT) >= 150


@pytest.mark.parametrize("name", COMPUTED)
def test_all_printed_digits_agree(name: str) -> None:
    """To one unit of the last place, as some sources cut digits off; to 1e-12 where there are more of them."""
    printed, found = ROWS[name].split(), np.atleast_1d(COMPUTED[name]())
    assert len(printed) == len(found)
    for digits, value in zip(printed, found):
        unit = 10.0 ** -len(digits.partition(".")[2])
        assert value == pytest.approx(float(digits), rel=1e-12, abs=unit * (1.0 + 1e-9) if unit < 1.0 else 1e-6)


@pytest.mark.parametrize("name", EXACT)
def test_what_differs_is_right_here(name: str) -> None:
    """The value with 40 digits is that of the library, is printed beside the other one, and is not the other one."""
    printed, here = DIFFERENT[name]
    with mp.workdps(40):
        exact = EXACT[name][1]()
    assert EXACT[name][0]() == pytest.approx(exact, rel=1e-8)
    digits = len(here.partition(".")[2])
    assert f"{exact:.{digits}f}" == here and abs(float(printed) - exact) > 10.0 ** -len(printed.partition(".")[2])


def test_what_is_proven_contradicts_the_other_value() -> None:
    printed, here = map(float, DIFFERENT[COMPLEX])
    assert printed < here <= robustness.two_complex_gains() + 5e-5
    printed, here = map(float, DIFFERENT[TRIANGULAR])
    lower, upper = robustness.triangular()
    assert printed < 0.3758 <= lower <= here <= upper
    printed, here = map(float, DIFFERENT[DISKS])
    assert synthesis.optimum_of_four_disks() == pytest.approx(here, abs=6e-5) and here < printed
