"""Which window the figures of the relative error have where no requirement names one: that of an exposure.

It is the window of the strictest requirement on the RPE of windows, without one of that on the RPE of instants; so a
telescope with exposures of 250 ms has its summary, budget, star and pictures of 250 ms.
"""

from __future__ import annotations

from collections.abc import Iterable

from pointing_analysis.requirements.requirement import Requirement

USUAL = 0.02
"""Window [s] of a recording of which no requirement on the relative error is known."""


def finest(requirements: Iterable[Requirement]) -> Requirement | None:
    """The strictest requirement on the RPE of both axes, of windows before one of instants; None without one."""
    own = [r for r in requirements if r.index == "RPE" and not r.axis]
    return min(own, key=lambda r: (not r.of_windows, r.limit), default=None)


def exposure_of(*requirements: Iterable[Requirement]) -> float:
    """Window [s] of the strictest requirement on the relative error, or :data:`USUAL`.

    Parameters
    ----------
    requirements : of several sources the first one with such a requirement counts

    Examples
    --------
    >>> from pointing_analysis.requirements.requirement import parse
    >>> long = parse("prob(rms RPE(1 s) < 90 mas) >= 0.997 at 95 % confidence")
    >>> short = parse("prob(rms RPE(5 ms) < 9 mas) >= 0.997 at 95 % confidence")
    >>> exposure_of([long, short]), exposure_of([], [long]), exposure_of([])
    (0.005, 1.0, 0.02)
    """
    found = next(filter(None, map(finest, requirements)), None)
    return USUAL if found is None else found.times[0]
