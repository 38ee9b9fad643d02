"""Which window, and which part of the instants and windows, the figures of a run have: what is required of it.

The window is that of the strictest requirement on the RPE of windows, without one of that on the RPE of instants; so a
telescope with exposures of 250 ms has its summary, budget, star and pictures of 250 ms. The part of which a quantile is
the largest value is the largest probability that is required of its index, without one that of any index; so a mission
that asks 99.9 % has figures of 99.9 %.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from pointing_analysis.requirements.requirement import Requirement

USUAL = 0.02
"""Window [s] of a recording of which no requirement on the relative error is known."""

USUAL_PROBABILITY = 0.997
"""Part of the instants and windows of a recording of which no requirement is known."""


@dataclass(frozen=True)
class Probabilities:
    """Parts of the instants, windows or exposures that keep the quantiles of a run, between 0 and 1.

    Parameters
    ----------
    ape, rpe, windows, knowledge, image : float
        Of the absolute error, of the relative error at every instant and in windows, of the absolute knowledge error
        and of the figures of a star's image.
    """

    ape: float = USUAL_PROBABILITY
    rpe: float = USUAL_PROBABILITY
    windows: float = USUAL_PROBABILITY
    knowledge: float = USUAL_PROBABILITY
    image: float = USUAL_PROBABILITY


def finest(requirements: Iterable[Requirement]) -> Requirement | None:
    """The strictest requirement on the RPE of both axes, of windows before one of instants; None without one."""
    relative = [r for r in requirements if r.index == "RPE" and not r.axis]
    return min(relative, key=lambda r: (not r.of_windows, r.limit), default=None)


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
    requirement = next(filter(None, map(finest, requirements)), None)
    return USUAL if requirement is None else requirement.times[0]


def probabilities_of(requirements: Iterable[Requirement]) -> Probabilities:
    """Parts that quantiles are computed for.

    Examples
    --------
    >>> from pointing_analysis.requirements.requirement import parse
    >>> tight = parse("prob(|APE| < 1 arcsec) >= 0.999 at 95 % confidence")
    >>> loose = parse("prob(rms RPE(20 ms) < 40 mas) >= 0.95 at 95 % confidence")
    >>> probabilities_of([tight, loose])
    Probabilities(ape=0.999, rpe=0.999, windows=0.95, knowledge=0.999, image=0.999)
    >>> probabilities_of([]) == Probabilities()
    True
    """
    known = list(requirements)
    largest = max((r.probability for r in known), default=USUAL_PROBABILITY)

    def of(*indices: str, windows: bool | None = None) -> float:
        asked = (r for r in known if r.index in indices and windows in (None, r.of_windows))
        return max((r.probability for r in asked), default=largest)

    image = max((r.probability for r in known if r.of_image), default=largest)
    return Probabilities(of("APE"), of("RPE", windows=False), of("RPE", windows=True), of("AKE"), image)


def quantile_key(probability: float) -> str:
    """Name of a quantile in JSON: its digits behind the point.

    Examples
    --------
    >>> quantile_key(0.997), quantile_key(0.9), quantile_key(0.00135)
    ('p997', 'p9', 'p00135')
    """
    return f"p{probability:.15f}".replace("0.", "", 1).rstrip("0")
