"""The budget of the relative error: noise, slow tones, fast tones and their total, of one run beside its allowances.

Tones are those that the recording names and those that stand out of its noise
(:mod:`pointing_analysis.spectra.line_search`), whatever they come from.

A limit of the relative error is asked of 99.7 % of the windows, noise and tones together. A tone of amplitude a along
one axis with noise of r rms (norm of both axes) keeps a limit L for about ``a + 2 r <= L``. Slow tones are
those on which the proof-mass actuators have no effect.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from pointing_analysis.arrays import FloatArray
from pointing_analysis.files.structured_text import is_number
from pointing_analysis.formatting.number_text import number, percent
from pointing_analysis.indices import metrics, weights
from pointing_analysis.indices.confidence import effective_number
from pointing_analysis.indices.errors import RAD_PER_MAS, ErrorSeries
from pointing_analysis.read.mapped_arrays import by_parts
from pointing_analysis.read.mcap.bag_metadata import BUDGET, BUDGET_EDGE
from pointing_analysis.read.recording import Recording
from pointing_analysis.spectra import spectra
from pointing_analysis.spectra.line_search import SETTINGS
from pointing_analysis.spectra.record_lines import unnamed_lines
from pointing_analysis.spectra.sidebands import FoundLine

BAND_EDGE = 85.0
"""Between slow and fast tones [rad/s] where the bag does not say."""

PARTS = ("noise", "slow", "fast", "total")
UNRESOLVED = "tones cannot be distinguished from the rest: their sum would exceed the total (a drift or a pulse?)"
GAPS = "tones cannot be looked for: too many samples are missing"


def _short(value: float) -> str:
    """Three digits without an exponent.

    Examples
    --------
    >>> [_short(value) for value in (4779.2, 18.66, 0.0, 1e-5)]
    ['4779', '18.7', '0', '< 0.01']
    """
    if value >= 1000.0:
        return f"{value:.0f}"
    return "< 0.01" if 0.0 < value < 0.01 else f"{value:.3g}"


@dataclass(frozen=True)
class ToneBudget:
    """Parts of the relative error of one run [mas].

    Attributes
    ----------
    noise : rms of what the tones leave, norm of both axes; NaN, as are the tones, if they cannot be resolved
    slow, fast : amplitude of the slow and of the fast tones, norm of both axes; of several the root sum of squares
    total : quantile of the rms in each window, both axes
    allowances : allowed values of the same parts; empty if not stated
    noise_error : standard error of the noise, by the scatter and the correlation of its windows; NaN where unknown
    found : lines among the tones that the recording does not name
    part : of the windows, that the total holds for
    spectrum : frequencies [Hz] and powers of the noise in the relative error, both axes; None where it is not known
    unresolved : why there are no tones, where noise and tones are NaN
    """

    noise: float
    slow: float
    fast: float
    total: float
    allowances: Mapping[str, float]
    noise_error: float = math.nan
    found: tuple[FoundLine, ...] = ()
    spectrum: tuple[FloatArray, FloatArray] | None = None
    part: float = 0.997
    unresolved: str = UNRESOLVED

    def __str__(self) -> str:
        texts, whole = [], f"total ({percent(self.part, 10)}) {{}}"
        if math.isnan(self.slow) and math.isnan(self.fast):
            limit = f" of {self.allowances['total']:.3g}" if "total" in self.allowances else ""
            return f"budget of the RPE [mas]: {self.unresolved}; {whole.format(_short(self.total))}{limit}"
        for part, name in zip(PARTS, ("noise {} rms", "slow tones {}", "fast tones {}", whole)):
            value, allowed = getattr(self, part), self.allowances.get(part)
            texts.append(name.format(_short(value)) + (f" of {allowed:.3g}" if allowed is not None else ""))
        return f"budget of the RPE [mas]: {', '.join(texts)}"

    def as_dict(self) -> dict[str, Any]:
        """Values for JSON; NaN becomes None."""
        values = {part: float(getattr(self, part)) for part in PARTS}
        values["noise_error"] = self.noise_error
        shown = {part: number(x) for part, x in values.items()}
        return {**shown, "allowances": dict(self.allowances), "lines_found": [_as_row(line) for line in self.found]}


def named_tones(run: Recording) -> FloatArray:
    """Frequencies of the tones that a recording names [rad/s]."""
    tones = run.parameters.get("tones_rad_s", [])
    return np.array([w for w in tones if _number(w)] if isinstance(tones, list) else [], dtype=float)


def tone_budget(run: Recording, series: ErrorSeries, window: float, total: float, part: float) -> ToneBudget:
    """Budget of a run; without tones all of the error is noise.

    Where the parts exceed the whole (:func:`pointing_analysis.spectra.spectra.exceeds`), they are NaN.

    Parameters
    ----------
    run : Run
    series : ErrorSeries
        Performance error of the run, at least one window long.
    window : float
        [s].
    total : float
        Quantile of the rms in each window, both axes [mas].
    part : float
        Of the windows, that the total holds for.
    """
    stated = run.parameters.get(BUDGET)
    allowances = {k: float(v) for k, v in stated.items() if _number(v)} if isinstance(stated, dict) else {}
    edge = allowances.pop(BUDGET_EDGE, BAND_EDGE)
    allowed = {part: allowances[part] for part in PARTS if part in allowances}
    present = by_parts(lambda rows: ~np.isnan(rows).any(axis=1), series.values, dtype=bool)
    values = series.values[: len(present) - int(np.argmax(present[::-1]))]  # without the lost end of a recording
    named = spectra.lines(values, series.dt, named_tones(run), window)
    if not named and np.count_nonzero(present) < (1.0 - SETTINGS.most_missing) * len(values):  # no line is looked for
        return ToneBudget(math.nan, math.nan, math.nan, total, allowed, part=part, unresolved=GAPS)
    unnamed, rest = unnamed_lines(values, series.dt, named)
    samples = metrics.samples_or_one(window, series.dt)
    factor = weights.rpe_discrete(np.array([line.omega for line in unnamed]), samples, series.dt) if unnamed else ()
    powers = [(line.omega, line.rpe**2) for line in named]
    powers += [(line.omega, line.power * float(weight) ** 2) for line, weight in zip(unnamed, factor)]
    if spectra.exceeds(values, rest, [one for _, one in powers], series.dt, window):
        return ToneBudget(math.nan, math.nan, math.nan, total, allowed, found=unnamed, part=part)
    noise, noise_error = _rms(metrics.windows(rest, series.dt, window).variance.sum(axis=1) / RAD_PER_MAS**2)
    slow, fast = (
        math.sqrt(2.0 * sum(one for omega, one in powers if (omega > edge) == above)) / RAD_PER_MAS
        for above in (False, True)
    )
    return ToneBudget(noise, slow, fast, total, allowed, noise_error, unnamed, _spectrum(rest, series.dt, window), part)


def _spectrum(rest: FloatArray, dt: float, window: float) -> tuple[FloatArray, FloatArray] | None:
    try:
        spectrum = spectra.psd(rest, dt)
    except ValueError:  # too short a record, or none without a gap
        return None
    hertz = spectrum.frequency[1:]
    power = spectrum.density[1:].sum(axis=1) * weights.rpe_exact(2.0 * math.pi * hertz, window) ** 2
    return (hertz, power) if power.any() else None


def _as_row(line: FoundLine) -> dict[str, Any]:
    """A found line for JSON."""
    mas = {
        name: [float(f"{x / RAD_PER_MAS:.6g}") for x in values]
        for name, values in (("amplitude", line.amplitude), ("lower", line.lower), ("upper", line.upper))
    }
    return {
        "hz": float(f"{line.omega / (2.0 * math.pi):.9g}"),
        **{f"{name}_mas": values for name, values in mas.items()},
        "above_noise_db": float(f"{line.level:.3g}"),
        "sideband_of_hz": float(f"{line.carrier / (2.0 * math.pi):.9g}") if line.is_sideband else None,
    }


def _rms(power: FloatArray) -> tuple[float, float]:
    """Rms from the power of each window (m,), and its standard error."""
    if not len(power):
        return math.nan, math.nan
    rms = math.sqrt(float(power.mean()))
    if len(power) < 2 or rms == 0.0:
        return rms, 0.0 if rms == 0.0 else math.nan
    relative = float(power.std(ddof=1)) / float(power.mean()) / math.sqrt(effective_number(power))
    return rms, 0.5 * rms * relative


def _number(value: Any) -> bool:
    return is_number(value) and math.isfinite(value)
