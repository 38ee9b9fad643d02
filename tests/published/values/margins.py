"""Margins of one loop of the page of published values."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.signal import cont2discrete, tf2ss

from lftkit import Expression, System, loop_margins, s, sensitivity_peaks

Values = Any
WITHOUT_GAIN = 0.002 * (s + 0.02) * (s + 0.05) * (s + 5) * (s + 10)
EXAMPLE_21 = WITHOUT_GAIN / ((s - 0.0005) * (s + 0.0001) * (s + 0.01) * (s + 0.2) * (s + 1) * (s + 100) ** 2)
LAG_WITH_RESONANCES = 8.75 * (4 * s**2 + 0.4 * s + 1) / ((100 * s + 1) * (s**2 + 0.22 * s + 1))
RESONANT = LAG_WITH_RESONANCES / (s**2 / 100 + 0.008 * s + 1)
OMEGA = 2.0 * np.pi


def system(loop: Expression) -> System:
    return loop.system("u", "y")


def sampled(num: list[float], den: list[float], dt: float) -> System:
    A, B, C, D, _ = cont2discrete(tf2ss(num, den), dt)
    return System(A, B, C, D, [("u", 1)], [("y", 1)], dt=dt)


def gain(loop: System, number: int = 0) -> Values:
    """A gain margin and its frequency."""
    omega, factor = loop_margins(loop).gain[number]
    return factor, omega


def phase(loop: System, number: int = 0) -> Values:
    """A phase margin and its frequency."""
    omega, angle = loop_margins(loop).phase[number]
    return angle, omega


def distance(loop: System) -> Values:
    """Least distance of the response to -1, and its frequency."""
    peak = sensitivity_peaks(loop).sensitivity
    return 1.0 / peak.value, peak.omega


def joined(*parts: Values) -> Values:
    return tuple(float(x) for part in parts for x in np.atleast_1d(part))


def of_samples(num: list[float], den: list[float], dt: float) -> Values:
    loop = sampled(num, den, dt)
    return joined(gain(loop), phase(loop), distance(loop))


def crossing(loop: System) -> Values:
    """The real response and its frequency."""
    factor, omega = joined(gain(loop))
    return -1.0 / factor, omega


def example_21(factor: float, number: int) -> Values:
    loop = system(factor * EXAMPLE_21)
    return joined(gain(loop, number), phase(loop))


def first_example() -> Values:
    loop = system(EXAMPLE_21)
    (_, first), _, (_, third), *_ = loop_margins(loop).gain
    return joined(first, 1e-4 * third, phase(loop))


def unstable_plant() -> System:
    return System([[1.0, 4.0], [3.0, 2.0]], [[1.0], [-4.0]], [[1.0, 0.0]], [[0.0]], [("u", 1)], [("y", 1)])


def of_triple_integrator() -> Values:
    loop = system((s + 0.1) ** 2 / (s**3 * (s + 1)))
    return joined(gain(loop), phase(loop)[1])


def both(loop: System) -> Values:
    return joined(gain(loop), distance(loop))


COMPUTED: dict[str, Callable[[], Values]] = {
    "margins of 1 / (s^3 + 2 s^2 + 3 s + 4): gain and distance": lambda: both(
        system(1 / (s**3 + 2 * s**2 + 3 * s + 4))
    ),
    "margins of an unstable plant of two states: phase": lambda: phase(unstable_plant()),
    "margins of a lag with two resonances: gain, frequency of the phase, distance": lambda: joined(
        gain(system(RESONANT)), joined(phase(system(RESONANT)))[1], distance(system(RESONANT))
    ),
    "further crossing of a lag with two resonances": lambda: phase(system(RESONANT), 1),
    "margins of 0.01 (10 - s) / ((s + 2) (s + 1)): gain and distance": lambda: both(
        system(0.01 * (10 - s) / (2 + s) / (1 + s))
    ),
    "frequency at which 2 s / (s + 1) has the gain 1": lambda: joined(phase(system(2 * s / (s + 1))))[1],
    "margin of 2 / (s + 1)^3: gain": lambda: joined(gain(system(2 / (s + 1) ** 3)))[0],
    "margin of (s + 0.1) / (s (s + 1)): phase": lambda: phase(system((s + 0.1) / s / (s + 1))),
    "margin of (s + 0.1) / (s^2 (s + 1)): phase": lambda: phase(system((s + 0.1) / s**2 / (s + 1))),
    "lower gain margin of (s + 0.1)^2 / (s^3 (s + 1)), frequency of the phase": of_triple_integrator,
    "example 21, gain 1: first gain margin, third of them in 10^4, phase": first_example,
    "example 21, gain 1000: frequency of the gain, phase": lambda: joined(example_21(1000.0, 1))[1:],
    "example 21, gain 5000: gain and phase": lambda: example_21(5000.0, 2),
    "margins of 2 / (s (s + 1) (s + 2)) with hold, 0.01 s": lambda: of_samples([2.0], [1.0, 3.0, 2.0, 0.0], 0.01),
    "margins of 2 / (s + 1)^3 with hold, 0.1 s": lambda: of_samples([2.0], [1.0, 3.0, 3.0, 1.0], 0.1),
    "margins of a resonance with hold, 0.05 s": lambda: of_samples(
        [1.1 * OMEGA**2], [1.0, 0.4 * OMEGA, OMEGA**2], 0.05
    ),
    "margins of two resonances with hold, 0.001 s": lambda: of_samples(
        [5e4], [1.0, 101.0, 10101.0, 10100.0, 10000.0], 0.001
    ),
    "response and frequency where three poles on samples are real": lambda: crossing(
        System(*tf2ss([3e-4, 11e-4, 3e-4], [1.0, -2.7145, 2.4562, -0.7408]), [("u", 1)], [("y", 1)], dt=0.1)
    ),
    "response and frequency where 200 / (s (s + 1) (s + 20)) is real": lambda: crossing(
        system(200 / (s * (s + 1) * (s + 20)))
    ),
    "phase margin of 50 / (5 s^3 + 10.25 s^2 + 6.25 s + 1)": lambda: joined(
        phase(system(50 / (5 * s**3 + 10.25 * s**2 + 6.25 * s + 1)))
    )[0],
}
