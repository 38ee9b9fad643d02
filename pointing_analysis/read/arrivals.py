"""When the messages of a topic came: lost messages, gaps, stalls and clock steps, from stamps and times of recording.

A message has the time of its stamp, on the sender's clock, and that at which it was recorded. Their difference is the
delay, which a queue or a busy machine raises for a while and a step of one of the clocks for good:

===========  ===========================  ==================================================================
finding      between two messages          evidence
===========  ===========================  ==================================================================
gap          stamps of several periods     messages in between were lost, or not sent
stall        recorded late                 the delay rises and falls back: the messages came, together
clock step   delay with another level      the stamps or the recorder's clock jumped, also backwards
===========  ===========================  ==================================================================

Without stamps a gap in the times of recording may be any of these. Topics without a period have no gaps.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

import numpy as np

from lftkit.support.settings import AlgorithmSettings
from pointing_analysis.arrays import BoolArray, IntArray
from pointing_analysis.read.mapped_arrays import SortedValues, by_parts, parts

Kind = Literal["gap", "stall", "clock step"]
KINDS: tuple[Kind, ...] = ("gap", "stall", "clock step")
NANO = 1e9


@dataclass(frozen=True)
class ArrivalSettings(AlgorithmSettings):
    """What is a gap, a stall and a step of a clock.

    Attributes
    ----------
    fewest : fewest messages whose times are judged
    regular : least share of the steps within half a period of the period, of a topic that has one
    gap : step above which messages are missing [periods]
    step, stall : least clock step and least stall [s], or `gap` and twice `gap` periods where these are longer
    before : messages whose least delay is the level before and after
    usual : part of the messages whose delays above the least one are the jitter
    """

    fewest: int = 10
    regular: float = 0.8
    gap: float = 1.5
    step: float = 0.01
    stall: float = 0.1
    before: int = 50
    usual: float = 0.9


SETTINGS = ArrivalSettings()


@dataclass(frozen=True)
class Event:
    """Something between two messages.

    Attributes
    ----------
    kind : what
    at : time of recording of the message before, from the first message of the topic [s]
    size : of a gap and a stall its length, of a clock step the change of the delay [s]; **positive: the stamps fell
        behind, or the clock of the recorder went ahead**
    lost : messages that are missing
    """

    kind: Kind
    at: float
    size: float
    lost: int = 0


@dataclass(frozen=True)
class Arrivals:
    """Times of a topic.

    Attributes
    ----------
    messages : number
    stamped : whether they have stamps
    period : median step [s]; None with too few messages, or where the steps have none
    events : in the order of the recording
    """

    messages: int
    stamped: bool
    period: float | None
    events: tuple[Event, ...] = ()

    def of(self, kind: Kind) -> tuple[Event, ...]:
        """Events of a kind."""
        return tuple(event for event in self.events if event.kind == kind)

    @property
    def lost(self) -> int | None:
        """Messages missing between others by their stamps; None where no stamps show it."""
        return sum(event.lost for event in self.events) if self.stamped and self.period is not None else None


NO_STAMPS: IntArray = np.zeros(0, np.int64)


def arrivals(logged: IntArray, stamps: IntArray = NO_STAMPS, settings: ArrivalSettings = SETTINGS) -> Arrivals:
    """What the times of the messages of a topic show.

    Parameters
    ----------
    logged : (n,) times of recording [ns], in the order of the file
    stamps : (n,) of the headers [ns]; empty where there are none
    settings : ArrivalSettings

    Examples
    --------
    100 Hz, three messages lost, and 20 messages that came together after a stall:

    >>> stamps = np.delete(np.arange(400) * 10_000_000, [100, 101, 102])
    >>> logged = stamps + 1_000_000
    >>> logged[200:220] = logged[220]
    >>> found = arrivals(logged, stamps)
    >>> found.lost, [(event.kind, event.size) for event in found.events]
    (3, [('gap', 0.04), ('stall', 0.2)])
    """
    stamped = stamps.size == logged.size > 0
    if stamped and _where(_steps(logged), lambda steps: steps < 0).size:
        order = np.argsort(logged, kind="stable")
        if not _where(_steps(stamps[order]), lambda steps: steps < 0).size:  # messages changed places in the file
            logged, stamps = logged[order], stamps[order]
    if logged.size < settings.fewest:
        return Arrivals(logged.size, stamped, None)
    steps = _steps(stamps if stamped else logged)
    ahead = SortedValues(by_parts(lambda part: np.where(part > 0, part, np.nan), steps))
    period = ahead.quantile(0.5) if ahead.size else 0.0
    near = sum(int((np.abs(steps[part] - period) <= 0.5 * period).sum()) for part in parts(len(steps)))
    regular = period > 0 and near >= settings.regular * len(steps)
    if stamped:
        jumps = _delays(logged, stamps, period if regular else 0.0, settings)
    else:  # of the steps of the recorder's clock those to earlier times are seen
        back = _where(steps, lambda part: part < -settings.step * NANO)
        jumps = {int(i): ("clock step", float(steps[i])) for i in back}

    def since(i: int) -> float:
        return float((logged[i] - logged[0]) / NANO)

    events = [Event(kind, since(i), size / NANO) for i, (kind, size) in jumps.items()]
    if regular:
        stepped = any(kind == "clock step" for kind, _ in jumps.values())
        if stamped and not stepped and _where(steps, lambda part: part < 0).size:
            steps = _steps(np.sort(stamps))  # messages that changed places are not missing
        for i, (kind, _) in jumps.items():
            if kind == "clock step":  # the clock that did not step counts what is missing: the shorter of the two
                both = [step for step in (steps[i], logged[i + 1] - logged[i]) if step > -settings.step * NANO]
                shorter = min(both, default=period)  # with the jitter of the recorder
                steps[i] = shorter if shorter > max(settings.gap * period, settings.step * NANO) else period
        least = settings.gap * period if stamped else max(2.0 * settings.gap * period, settings.stall * NANO)
        for i in _where(steps, lambda part: part > least).tolist():
            lost = round(float(steps[i]) / period) - 1 if stamped else 0
            events.append(Event("gap", since(i), float(steps[i]) / NANO, lost))
    events.sort(key=lambda event: event.at)
    return Arrivals(logged.size, stamped, period / NANO if regular else None, tuple(events))


def _steps(times: IntArray) -> IntArray:
    """Differences (n - 1,) of times (n,)."""
    return np.asarray(by_parts(np.subtract, times[1:], times[:-1], dtype=np.int64))


def _where(values: IntArray, holds: Callable[[IntArray], BoolArray]) -> IntArray:
    """Rows of which something holds."""
    return np.flatnonzero(by_parts(holds, values, dtype=bool))


def _delays(
    logged: IntArray, stamps: IntArray, period: float, settings: ArrivalSettings
) -> Mapping[int, tuple[Kind, float]]:
    """Stalls and clock steps by the message before them, sizes [ns]."""
    delay = np.asarray(by_parts(np.subtract, logged, stamps, dtype=np.int64))
    least = max(settings.step * NANO, settings.gap * period)
    longest = max(settings.stall * NANO, 2.0 * settings.gap * period)
    delays: dict[int, tuple[Kind, float]] = {}
    start = caught_up = 0  # of the present level; end of a stall
    for i in _where(_steps(delay), lambda steps: np.abs(steps) > least).tolist():
        if i < caught_up:
            continue
        level = int(delay[max(start, i + 1 - settings.before) : i + 1].min())
        rise = float(delay[i + 1] - level)
        if abs(rise) <= least:
            continue
        after, until = delay[i + 1 :], logged[i + 1] + 2.0 * abs(rise) + NANO
        end = logged.size  # the first one whose delay is back in time
        for part in parts(len(after)):
            back = (after[part] - level <= max(0.1 * rise, least)) & (logged[i + 1 :][part] <= until)
            if back.any():
                end = i + 1 + part.start + int(back.argmax())
                break
        if rise > 0 and (end < logged.size or after.size < settings.before):
            if rise > longest:
                delays[i] = ("stall", rise)
            falls = end < logged.size and level - delay[end] > least  # below the level: a step
            caught_up = end - 1 if falls else end
        elif period > 0:  # of a topic without one, several nodes may send, each with its own delay
            few = after[: settings.before]
            change = float(few.min() - level)
            jitter = float(np.quantile(few, settings.usual) - few.min())
            if change > least or change < -least - jitter:  # the few messages before may all have come late
                start = i + 1
                delays[i] = ("clock step", change)
    return MappingProxyType(delays)
