"""Columns of metrics of a campaign: names of those of a requirement, and short descriptions."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

from pointing_analysis.indices.errors import RAD_PER_ARCSEC, RAD_PER_MAS
from pointing_analysis.requirements.exposure import USUAL
from pointing_analysis.requirements.requirement import NYQUIST, Requirement, SpatialFrequency

MEANINGS = {
    "ape_max_arcsec": "largest absolute error [arcsec]",
    "ape_p997_arcsec": "absolute error, 99.7 % of the instants [arcsec]",
    "rpe_rms_mas": "relative error in windows, rms [mas]",
    "rpe_p997_mas": "relative error, 99.7 % of the instants [mas]",
    "ake_p997_arcsec": "absolute knowledge error, 99.7 % of the instants [arcsec]",
    "rke_rms_mas": "relative knowledge error, rms [mas]",
    "mirror_max_mrad": "largest mirror command [mrad]",
    "force_max_n": "largest force command of all actuators [N]",
    "rpe_window_max_mas": "relative error, rms of the worst window [mas]",
    "rpe_window_p997_mas": "relative error, rms of a window, 99.7 % of the windows [mas]",
    "ape_gain": "largest absolute error of a tone of unit norm over its limit",
    "slow_tone_mas": "relative error of the worst slow tone of unit norm [mas]",
    "fast_tone_mas": "relative error of the worst fast tone of unit norm [mas]",
    "rpe_fine_gain": "the larger of both over the limit of the stage with all actuators",
    "mirror_gain": "largest mirror angle of a tone of unit norm over its authority",
    "force_gain": "largest forces of a tone of unit norm over their authority",
    "noise_ape_arcsec_rms": "absolute error from sensor noise [arcsec rms]",
    "noise_rpe_mas_rms": "relative error from sensor noise [mas rms]",
    "total_mas": "quantile of the windows at the required probability, with the worst tone and the noise [mas]",
    "sensitivity_mirror": "peak sensitivity of the mirror loop",
    "sensitivity_forces": "peak sensitivity of the force loop",
    "rpe_peak_rad_s": "frequency of the worst tone [rad/s]",
}

TOTAL = "total_mas"
"""Metric by which members of the depth ``model`` are ranked."""

WITHOUT_LIMIT = "rpe_window_p997_mas"
"""Metric by which simulated members are ranked where nothing is required of the relative error."""

SCENARIOS = {
    "unit_norm": "several tones act at once, at the frequencies where the telescope on its isolator is worst. Their "
    "shares are random and add up to norm 1. The controllers are designed and proven for this norm",
    "design": "several tones act at once, each of norm 1: more than the controllers are designed for",
    "imbalance": "the harmonics of the wheels act, as measured on wheels, at the speeds of the member",
    "worst_case": "one tone of norm 1 acts, the worst one of the member",
    "none": "no tones of a scenario act",
}
"""Disturbances of the members of a simulated campaign."""


def scenario_text(scenario: str, depth: str, sources: Sequence[str] = ()) -> str:
    """Disturbances of the members of a campaign, with the sources of the parameter file.

    Examples
    --------
    >>> scenario_text("worst_case", "time")
    'In each member one tone of norm 1 acts, the worst one of the member. Sensor noise is on.'
    """
    if depth == "model":
        return "Each member has its worst tone of norm 1 and the noise of its sensors. Both come from its matrices."
    text = f"In each member {SCENARIOS.get(scenario, scenario)}. Sensor noise is on."
    return f"{text} Sources of the parameter file act: {', '.join(sources)}." if sources else text


ABSOLUTE = ("APE", "MPE", "AKE", "MKE")
"""Indices whose columns are in arcsec; those of other angles are in mas."""

QUANTITIES = {
    "ape": "absolute error",
    "mpe": "mean error of a window",
    "rpe": "relative error",
    "pde": "drift between two windows",
    "ake": "absolute knowledge error",
    "mke": "mean knowledge error of a window",
    "rke": "relative knowledge error",
    "mtf": "MTF of the motion in an exposure",
    "strehl": "Strehl ratio of the motion in an exposure",
    "ee50": "radius with 50 % of the energy in an exposure",
    "ee80": "radius with 80 % of the energy in an exposure",
    "ellipticity": "ellipticity of the image in an exposure",
}
"""Index in a column to its words."""

SAMPLES = {"mpe": "windows", "mke": "windows", "pde": "pairs of windows"}
SAMPLES |= dict.fromkeys(("mtf", "strehl", "ee50", "ee80", "ellipticity"), "exposures")
"""Index to its samples; of the others each instant is one, and of root mean squares each window."""

_NUMBER = r"\d[\d.]*(?:e[+-]?\d+)?"
_COLUMN = re.compile(
    rf"(?P<index>{'|'.join(QUANTITIES)})(?P<rms>_window)?(?P<times>(?:_{_NUMBER}m?s)*)"
    rf"(?:_(?P<frequency>(?:{_NUMBER})?nyquist|{_NUMBER}cycles_per_[a-z]+))?(?:_(?P<axis>[xy]))?"
    rf"_(?P<what>max|min|p(?P<part>\d[\d.e+-]*)|(?P<side>above|below)_(?P<limit>{_NUMBER}))"
    r"(?:_(?P<unit>mas|arcsec))?(?P<weight>_effective|_unseen)?"
)

_SOURCE = re.compile(r"source_(?P<name>\w+)_(?P<metric>ape_p997_arcsec|rpe_rms_mas)")


@dataclass(frozen=True)
class RequirementColumns:
    """Names of the columns that a member has for a requirement, made of index, window, axis, limit and unit.

    Parameters
    ----------
    worst : str
        Worst sample: the largest, under a lower limit the smallest.
    quantile : str
        Quantile of the samples at the required probability.
    share : str
        Share of the samples that exceed the limit; missing ones are among them.
    effective : str
        Independent samples that those beyond the limit weigh as much as.
    unseen : str
        Share of the samples that larger clusters than those of the run may exceed.
    scale : float
        Radians per unit of the columns; 1 for numbers.
    unit : str
        Of the columns; empty for numbers.
    lower : bool
        Whether the limit is a lower one.

    Examples
    --------
    >>> from pointing_analysis.requirements.requirement import parse
    >>> drift = RequirementColumns.of(parse("prob(|PDE_x(1 s, 10 s)| < 1 arcsec) >= 95 % at 90 % confidence"))
    >>> drift.worst, drift.quantile, drift.share
    ('pde_1s_10s_x_max_mas', 'pde_1s_10s_x_p95_mas', 'pde_1s_10s_x_above_1000_mas')
    >>> RequirementColumns.of(parse("prob(MTF(20 ms, Nyquist) > 0.9) >= 99.7 % at 95 % confidence")).quantile
    'mtf_20ms_nyquist_p003'
    """

    worst: str
    quantile: str
    share: str
    effective: str
    unseen: str
    scale: float
    unit: str
    lower: bool

    @classmethod
    def of(cls, requirement: Requirement, exposure: float = USUAL) -> RequirementColumns:
        """Columns of a requirement of a telescope with an exposure [s], whatever others there are."""
        stem, lower = _stem(requirement, exposure), requirement.lower
        unit, scale = column_unit(requirement)
        end = f"_{unit}" if unit else ""
        part = _digits(round(1.0 - requirement.probability, 14) if lower else requirement.probability, 10, 1e-15)
        limit = _digits(requirement.limit / scale, 6, math.inf if stem in ("ape", "rpe_window") else 1e-9)
        share = f"{stem}_{'below' if lower else 'above'}_{limit}{end}"
        return cls(
            worst=f"{stem}_{'min' if lower else 'max'}{end}",
            quantile=f"{stem}_p{part.removeprefix('0.')}{end}",
            share=share,
            effective=f"{share}_effective",
            unseen=f"{share}_unseen",
            scale=scale,
            unit=unit,
            lower=lower,
        )

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns."""
        return self.share, self.quantile, self.worst, self.effective, self.unseen

    @property
    def values(self) -> tuple[str, str]:
        """Names of those that hold values of the index."""
        return self.quantile, self.worst


def column_unit(requirement: Requirement) -> tuple[str, float]:
    """Unit of the columns of a requirement and radians in it; empty and 1 for numbers."""
    unit = "" if not requirement.unit else "arcsec" if requirement.index in ABSOLUTE else "mas"
    return unit, {"": 1.0, "arcsec": RAD_PER_ARCSEC, "mas": RAD_PER_MAS}[unit]


def _stem(r: Requirement, exposure: float) -> str:
    """Index with its windows, spatial frequency and axis; the RPE of both axes in an exposure needs no window."""
    times = () if r.index == "RPE" and not r.axis and r.times == (exposure,) else r.times
    shown = [f"{_digits(1e3 * t, 6, 1e-9)}ms" if t < 1 else f"{_digits(t, 6, 1e-9)}s" for t in times]
    frequency = [] if r.frequency is None else [_frequency(r.frequency)]
    return "_".join((r.index.lower(), *(["window"] if r.of_windows else []), *shown, *frequency, *r.axis))


def _frequency(frequency: SpatialFrequency) -> str:
    if frequency.unit == NYQUIST:
        return "nyquist" if frequency.value == 1.0 else f"{_digits(frequency.value, 6, 1e-9)}nyquist"
    return f"{_digits(frequency.value, 6, 1e-9)}cycles_per_{frequency.unit}"


def _digits(value: float, places: int, tolerance: float) -> str:
    """A few significant digits, or as many as distinguish it from others beyond a tolerance."""
    short = f"{value:.{places}g}"
    return short if math.isclose(float(short), value, rel_tol=tolerance) else f"{value:.15g}"


def meaning(column: str) -> str:
    """Meaning of a column.

    Examples
    --------
    >>> meaning("rpe_window_above_25_mas")
    'relative error, rms of a window: share of the windows above 25 mas'
    >>> meaning("ape_p95_arcsec")
    'absolute error, 95 % of the instants [arcsec]'
    >>> meaning("mtf_20ms_nyquist_p003")
    'MTF of the motion in an exposure of 20 ms, at Nyquist, 99.7 % of the exposures are above'
    >>> meaning("source_cooler_rpe_rms_mas")
    'source cooler alone: relative error in windows, rms [mas]'
    """
    if source := _SOURCE.fullmatch(column):
        return f"source {source['name']} alone: {MEANINGS[source['metric']]}"
    matched = _COLUMN.fullmatch(column)
    if column in MEANINGS or not matched:
        return MEANINGS.get(column, column.replace("_", " "))
    index, unit = matched["index"], f" [{matched['unit']}]" if matched["unit"] else ""
    samples = "windows" if matched["rms"] else SAMPLES.get(index, "instants")
    quantity = QUANTITIES[index] + _conditions(matched)
    if matched["limit"]:
        limit = f"{matched['limit']} {matched['unit'] or ''}".strip()
        share = f"share of the {samples}"
        weights = {
            "_effective": f"independent {samples} for the share",
            "_unseen": f"further {share} in larger clusters,",
        }
        what = weights.get(matched["weight"], share)
        return f"{quantity}: {what} {matched['side']} {limit}"
    if matched["part"]:
        part = float(matched["part"] if "e" in matched["part"] else f"0.{matched['part']}")
        if index in ("mtf", "strehl"):
            return f"{quantity}, {100 - 100 * part:.10g} % of the {samples} are above"
        return f"{quantity}, {100 * part:.10g} % of the {samples}{unit}"
    return f"{quantity}, {'largest' if matched['what'] == 'max' else 'smallest'} of the {samples}{unit}"


def _conditions(matched: re.Match[str]) -> str:
    """Windows, spatial frequency and axis in words."""
    times = [re.sub(r"(m?s)$", r" \1", time) for time in matched["times"].split("_")[1:]]
    text = ", rms of a window" if matched["rms"] else ""
    if matched["index"] == "pde":
        text += f" of {times[0]}, {times[1]} apart"
    elif times:
        text += f" {'of' if text or matched['index'] in SAMPLES else 'in windows of'} {times[0]}"
    if frequency := matched["frequency"]:
        shown = re.sub(r"^([\d.e+-]+)", r"\1 ", frequency.replace("_per_", "/")).replace("nyquist", NYQUIST)
        text += f", at {shown}"
    return text + (f", axis {matched['axis']}" if matched["axis"] else "")
