"""The ticks of a bag as a trace for Perfetto or Chrome: when each node sent, from the messages' own times.

A message of the bag has its time of acquisition, or tick, as stamp and the time at which its publisher sent it. A tick
is the span of its period; the plant's part goes from the tick to its last sample, the observer's from there to the
estimate, the controller's from there to the command. It costs a run nothing.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader

from lftkit.errors import InputError
from lftkit.support.atomic_output import atomic_file
from los_testbed.bags.cdr import stamp_of
from los_testbed.config.topics import FSM_COMMAND, LOS_ESTIMATE, PMA_COMMAND, SENSORS
from pointing_analysis.read.mcap.bag_files import bag_files
from pointing_analysis.read.run import Run
from titop_plant.interface import TICK_NS

TRIGGER = SENSORS[-1].name
"""Topic of the sample that is sent last in a tick, and wakes the observer."""

STEPS = ("plant", "estimator", "controller: mirror", "controller: forces")
TOPICS = (TRIGGER, LOS_ESTIMATE.name, FSM_COMMAND.name, PMA_COMMAND.name)
MISSED = "missed tick"
US = 1000.0


def sent_times(run: Run, namespace: str, start: float, stop: float) -> tuple[dict[int, list[float]], int]:
    """For each tick of a part the times at which the messages of `TOPICS` were sent [ns]; first stamp of the run [ns].

    Ticks are given by their stamps [ns]; a missing message is NaN.
    """
    names = {f"{namespace}/{name}": k for k, name in enumerate(TOPICS)}
    by_stamp: dict[int, list[float]] = {}
    for file in bag_files(run.path).files:
        with file.open("rb") as stream:
            for _, channel, message in make_reader(stream).iter_messages(topics=list(names)):
                row = by_stamp.setdefault(stamp_of(message.data), [np.nan] * len(TOPICS))
                row[names[channel.topic]] = float(message.publish_time)
    first = min(by_stamp, default=0)
    return {k: by_stamp[k] for k in sorted(by_stamp) if start <= (k - first) * 1e-9 < stop}, first


def events(sent: dict[int, list[float]], first: int) -> Iterator[dict[str, Any]]:
    """Events of the trace: names of the tracks, then for each tick its period and the part of each node.

    The stamps of a run count ticks from `first`; the wall-clock time of that is taken from the fastest tick.
    """
    for track, name in enumerate(("ticks", *STEPS)):
        yield {"ph": "M", "name": "thread_name", "pid": 1, "tid": track, "args": {"name": name}}
    offset = min((row[0] - stamp for stamp, row in sent.items() if np.isfinite(row[0])), default=0.0)
    for stamp, row in sent.items():
        number, begin = (stamp - first) // TICK_NS, float(stamp - first)
        yield _span(f"tick {number}", 0, begin, begin + TICK_NS)
        times = [time - offset - first for time in row]
        plant, estimate, *commands = times
        starts, ends = (begin, plant, estimate, estimate), (plant, estimate, *commands)
        for track, (name, start, end) in enumerate(zip(STEPS, starts, ends), start=1):
            if np.isfinite(start) and np.isfinite(end):
                yield _span(f"{name} {number}", track, start, end)
        if not all(time < begin + TICK_NS for time in commands):  # NaN: none at all
            yield {"ph": "i", "s": "t", "name": MISSED, "pid": 1, "tid": 0, "ts": (begin + TICK_NS) / US}


def _span(name: str, track: int, start: float, end: float) -> dict[str, Any]:
    return {"ph": "X", "name": name, "pid": 1, "tid": track, "ts": start / US, "dur": max(0.0, end - start) / US}


def write_trace(run: Run, output: Path, start: float = 0.0, stop: float = np.inf) -> tuple[int, int]:
    """Write the trace of a part of a run [s]; ticks, and those whose commands came after their period.

    Raises
    ------
    ValueError
        A run that was not in real time, or a bag without messages of the loop in that part.
    """
    if run.parameters.get("mode") != "realtime":
        raise InputError(f"{run.path}: a trace must be of a run in real time, got mode {run.parameters.get('mode')}")
    namespace = str(run.parameters.get("namespace", "")).rstrip("/")
    sent, first = sent_times(run, namespace, start, stop)
    if not sent:
        raise InputError(f"{run.path}: the bag must hold {TRIGGER} between {start:g} and {stop:g} s, got none")
    traced = list(events(sent, first))
    with atomic_file(output) as path:
        path.write_text(json.dumps({"displayTimeUnit": "ns", "traceEvents": traced}), "utf-8")
    return len(sent), sum(event["name"] == MISSED for event in traced)
