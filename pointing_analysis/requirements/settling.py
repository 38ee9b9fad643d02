"""Length of the start-up of a run that does not begin in its steady state, measured in its record.

For each requirement the level of its index (the square of its samples, in blocks) is fitted by a constant and
one decaying exponential, the slowest decay that is seen. Until the exponential is below a part of the level that is
left, the run starts up. A tone of the disturbance may build up more slowly than the noise beside it lets the level
show: so its amplitude is compared between the halves of the record, too. Where the start-up reaches into the second
half of the record, or a tone still changes, the requirement is not judged: a longer run, or a start in the steady
state, decides. Judged all the same are a falling level that is within its limit with its start-up, and a rising one
that exceeds it with its quiet beginning: a fault late in a run is no start-up, nor is a level that is higher for a
while only.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from lftkit.support.settings import AlgorithmSettings
from pointing_analysis.arrays import FloatArray
from pointing_analysis.indices import metrics
from pointing_analysis.indices.errors import ErrorSeries
from pointing_analysis.indices.weights import rpe_discrete
from pointing_analysis.read.recording import Recording
from pointing_analysis.requirements.conditions import MEASURED, START_UP
from pointing_analysis.requirements.requirement import Requirement, parse, time_text
from pointing_analysis.requirements.verdict import Verdict, index_samples, judge, not_judged, series_of
from pointing_analysis.spectra.tone_budget import named_tones


@dataclass(frozen=True)
class SettlingSettings(AlgorithmSettings):
    """What is a start-up, and how it is measured.

    Attributes
    ----------
    blocks : into which the samples of an index are cut
    left : part of the level, a square, at which the rest of a decay is small: 5 % of the amplitude
    significant : standard errors at which an exponential, or a change of a tone, is one
    shortest, longest, decays : time constants that are tried, parts of the record, and their number
    first : part of a start-up, at its begin, in which at least this part of the level of a decay is seen
    shortest_record : in a shorter one no start-up is measured [s]
    brief : part of the judged record within which a start-up may end, also where the usual one is half of the run
    segments : parts of the record, in each of which the amplitude of a tone is found
    periods : fewest periods of a tone in a segment; slower ones are not compared
    offsets : bins of a segment on each side of a tone at which the noise of its amplitude is found
    """

    blocks: int = 60
    left: float = 0.1
    significant: float = 4.0
    shortest: float = 1.0 / 60
    longest: float = 3.0
    decays: int = 33
    first: float = 0.25
    shortest_record: float = 4.0
    brief: float = 0.1
    segments: int = 8
    periods: float = 2.0
    offsets: tuple[int, ...] = (3, 4, 5)


SETTINGS = SettlingSettings()


@dataclass(frozen=True)
class Settled:
    """Verdict on a run that may start up.

    Attributes
    ----------
    verdict : Verdict
    remark : str
        What was left out beyond the usual start-up; empty where nothing was.
    """

    verdict: Verdict
    remark: str = ""


def judge_settled(
    requirement: Requirement, run: Recording, transient: float | None = None, settings: SettlingSettings = SETTINGS
) -> Settled:
    """Verdict on one run, its start-up measured and left out where the run begins with one and none is given."""
    if transient is not None or run.parameters.get(START_UP) != MEASURED or requirement.across_runs:
        return Settled(judge(requirement, [run], transient))
    try:
        series = series_of(requirement, run)
        seconds = series.start + start_up(series, requirement, named_tones(run), settings)
    except ValueError:
        return Settled(judge(requirement, [run], None))  # with the reason
    whole = series.start + series.duration
    if seconds > 0.5 * whole and seconds - series.start > settings.brief * series.duration:
        # Whether the level of an index is higher in the second half of a series
        squares = _squares(series, requirement)
        half = len(squares) // 2
        usual, rises = judge(requirement, [run], None), float(squares[half:].mean()) > float(squares[:half].mean())
        if rises and usual.status != "compliant" and not usual.within_limit:
            return Settled(usual)  # the quiet beginning, too, is in what exceeds the limit
        if not rises and math.isfinite(seconds) and (usual.status == "compliant" or usual.within_limit):
            return Settled(usual)  # a falling level is within the limit with its start-up, too
        known = f"until about {seconds:.0f} of" if math.isfinite(seconds) else "through"
        how = f"rises {known}" if rises else f"falls {known}" if math.isfinite(seconds) else "changes within"
        why = f"not settled: its level {how} {whole:g} s (a longer run, or analyse --transient SECONDS)"
        return Settled(not_judged(requirement, why))
    if seconds <= series.start:
        return Settled(judge(requirement, [run], None))
    left = math.ceil(seconds)
    remark = f"{requirement.quantity}: the first {left} s are measured start-up and excluded"
    return Settled(judge(requirement, [run], float(left)), remark)


def start_up(
    series: ErrorSeries,
    requirement: Requirement,
    tones: Sequence[float] | FloatArray = (),
    settings: SettlingSettings = SETTINGS,
) -> float:
    """Seconds from the begin of a series until it is settled; infinite where a tone of the disturbance still changes.

    Parameters
    ----------
    series : ErrorSeries
    requirement : Requirement
        Of an index of one run.
    tones : sequence of float
        Frequencies of the disturbance [rad/s].
    settings : SettlingSettings
    """
    if series.duration < settings.shortest_record:
        return 0.0
    squares = _squares(series, requirement)
    if len(squares) < 2 * settings.blocks or not squares.any():
        return 0.0
    level = math.sqrt(float(squares[len(squares) // 2 :].mean()))
    if _tone_changes(series, requirement, np.asarray(tones, dtype=float), level, settings):
        return math.inf
    return decay(squares, series.duration, settings)


def _squares(series: ErrorSeries, requirement: Requirement) -> FloatArray:
    """Squares of the samples of an index, in the order of time, without those that are missing."""
    if requirement.of_image:
        squares = metrics.windows(series.values, series.dt, requirement.times[0]).variance.sum(axis=1)
    else:
        squares = np.square(index_samples(series, requirement).values)
    return np.asarray(squares[np.isfinite(squares)])


def is_settled(
    series: ErrorSeries,
    window: float,
    tones: Sequence[float] | FloatArray = (),
    settings: SettlingSettings = SETTINGS,
) -> bool:
    """Whether absolute error and relative error in a window [s] are settled in the second half of a series."""
    asked = ("|APE|", f"rms RPE({time_text(window)})") if metrics.holds(window, series.dt) else ("|APE|",)
    half = 0.5 * series.duration
    requirements = [parse(f"prob({index} < 1 arcsec) >= 0.997 at 95 % confidence") for index in asked]
    return all(start_up(series, requirement, tones, settings) <= half for requirement in requirements)


def decay(squares: FloatArray, seconds: float, settings: SettlingSettings = SETTINGS) -> float:
    """Seconds until an exponential in a level is below a part of what is left of it; 0 where there is none.

    Infinite for a level that rises through the whole record: how far, it does not tell. Also for one that is higher for
    a while and not so at the begin: an event is no start-up.

    Parameters
    ----------
    squares : ndarray, shape (n,)
        Squares of the samples of an index, in the order of time.
    seconds : float
        That they take.
    settings : SettlingSettings

    Examples
    --------
    >>> t = np.linspace(0.0, 60.0, 6000)
    >>> round(decay(1.0 + 3.0 * np.exp(-t / 5.0), 60.0)), decay(np.ones(6000), 60.0)  # 5 s ln(3 / 0.1)
    (17, 0.0)
    """
    n = len(squares) // settings.blocks * settings.blocks
    blocks = squares[:n].reshape(settings.blocks, -1).mean(axis=1)
    time = (np.arange(settings.blocks) + 0.5) * seconds / settings.blocks
    time_constants = np.geomspace(settings.shortest, settings.longest, settings.decays)
    best = min((_fit(blocks, time, tau * seconds) for tau in time_constants), key=lambda fit: fit[0])
    _, tau, constant, size, error = best
    left, fit = float(blocks[-settings.blocks // 4 :].mean()), constant + size * np.exp(-time / tau)
    if abs(size) <= settings.significant * error or abs(size) <= settings.left * left:
        return 0.0
    seconds_to_settle = max(0.0, tau * math.log(abs(size) / (settings.left * left)))
    first = slice(max(math.ceil(settings.first * seconds_to_settle / seconds * settings.blocks), 2))
    if seconds_to_settle and size > 0.0 and blocks[first].mean() - left < settings.first * (fit[first].mean() - left):
        return math.inf
    return seconds_to_settle if size > 0.0 or seconds_to_settle < 0.5 * seconds else math.inf


def _fit(blocks: FloatArray, time: FloatArray, tau: float) -> tuple[float, float, float, float, float]:
    """Sum of squares that a constant and an exponential leave, time constant, both sizes, error of the second one."""
    columns = np.column_stack([np.ones(len(time)), np.exp(-time / tau)])
    inverse = linalg.inv(columns.T @ columns)
    size = inverse @ columns.T @ blocks
    rest = blocks - columns @ size
    total = float(rest @ rest)
    alike = min(max(float(rest[1:] @ rest[:-1]) / total, 0.0), 0.95) if total else 0.0
    variance = total / (len(blocks) - 3) * inverse[1, 1] * (1.0 + alike) / (1.0 - alike)
    return total, tau, float(size[0]), float(size[1]), math.sqrt(variance)


def _tone_changes(
    series: ErrorSeries, requirement: Requirement, tones: FloatArray, level: float, settings: SettlingSettings
) -> bool:
    """Whether the amplitude of a tone differs between the halves of a series by more than 5 % of the level."""
    e, dt = series.values, series.dt
    n = len(e) // settings.segments
    seconds = n * dt
    slowest = settings.periods * 2.0 * math.pi / seconds
    for omega in tones[(tones > slowest) & (tones < math.pi / dt)]:
        near = np.abs(tones - omega)
        if (near[near > 0] < 2.0 * slowest).any():
            continue  # not resolved in a segment: their beat is no change
        weight = 1.0
        if requirement.of_windows or requirement.of_image or requirement.index in ("RPE", "RKE"):
            weight = float(rpe_discrete(np.array([omega]), metrics.samples_or_one(requirement.times[0], dt), dt)[0])
        amplitudes = _amplitudes(e, dt, n, omega, settings.segments)
        bins = [sign * k for k in settings.offsets for sign in (-1, 1)]
        beside = [_amplitudes(e, dt, n, omega + 2.0 * math.pi * k / seconds, settings.segments) for k in bins]
        noise = math.sqrt(np.median([np.square(np.abs(one)).sum(axis=1).mean() for one in beside]))
        # of sizes: the phase of a cooler wanders; their scatter in each half is an error, too
        halves = np.sqrt(np.square(np.abs(amplitudes)).sum(axis=1)).reshape(2, -1)
        change = abs(float(np.diff(halves.mean(axis=1))[0]))
        scatter = math.sqrt(float(halves.var(axis=1, ddof=1).sum()))
        error = max(noise * math.sqrt(2.0), scatter) / math.sqrt(settings.segments / 2)
        relevant = weight * change > math.sqrt(settings.left) / 3.0 * level * math.sqrt(2.0)
        if relevant and change > settings.significant * error:
            return True
    return False


def _amplitudes(e: FloatArray, dt: float, n: int, omega: float, segments: int) -> FloatArray:
    """Complex amplitudes (segments, 2) of a frequency in each segment of n samples, Hann weights, one phase for all."""
    window = np.hanning(n + 2)[1:-1]
    parts = np.nan_to_num(e[: segments * n]).reshape(segments, n, 2)
    parts = parts - np.einsum("skc,k->sc", parts, window / window.sum())[:, None, :]
    turn = np.exp(-1j * omega * dt * np.arange(segments * n)).reshape(segments, n)
    return np.asarray(2.0 * np.einsum("skc,sk->sc", parts, turn * window / window.sum()))


__all__ = ["Settled", "SettlingSettings", "decay", "is_settled", "judge_settled", "start_up"]
