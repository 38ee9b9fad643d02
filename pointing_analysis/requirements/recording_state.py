"""What is missing in a recording: lost samples, defects of its topics, dropped frames of cameras."""

from __future__ import annotations

from lftkit.support.counted_nouns import counted
from pointing_analysis.read.arrivals import arrivals
from pointing_analysis.read.messages.topic_columns import CAMERA, KNOWN
from pointing_analysis.read.recorded_sensors import sensors_of
from pointing_analysis.read.recording import Recording
from pointing_analysis.read.run import Run
from pointing_analysis.read.run_end import FAILURE, run_end, statistics_of
from pointing_analysis.read.unsent import lost_gaps, unsent


def recording_state(run: Recording) -> tuple[dict[str, int], list[str], int]:
    """Lost samples by topic, defects of the recording as lines of text, dropped frames of all cameras.

    Samples that are missing by the stamps count as lost also where the clock was stepped: what moved meanwhile is not
    known. The line says so.
    """
    lost: dict[str, int] = {}
    problems = list(run.problems)
    stamps = {}
    sensors = sensors_of(run)
    known = {*KNOWN, *(sensor.topic for sensor in sensors)}
    message, empty = ("message", "with NaN") if run.kind == "bag" else ("sample", "without a value: missing")
    cameras = [sensor.topic for sensor in sensors if sensor.held] or [name for name in (CAMERA,) if name in run]
    for name in (n for n in run.topics if n in known):
        topic = run[name]
        state, shown = topic.integrity, run.shown(name)
        ends = topic.lost_before + topic.lost_after
        if len(topic) and topic.period > 0:
            after = round(topic.lost_after * topic.period * 1e9)
            stamps[name] = (topic.grid_start, int(topic.stamp[-1]) + after, topic.period)
        missing = state.missing - min(state.missing, unsent(run, name))
        lost[name] = missing + ends + (state.nan if name not in cameras else 0)
        stepped = missing > 0 and arrivals(topic.published, topic.stamp).of("clock step")
        by_clock = " by their stamps, whose clock, or the recorder's, was stepped" if stepped else ""
        if topic.open_end:
            problems.append(
                f"{shown}: the recording is truncated: the number of missing samples at its end is not known"
            )
        for count, noun, rest in (
            (missing, "sample", f" missing in {counted(lost_gaps(run, name, missing), 'gap')}{by_clock}"),
            (ends, "sample", " missing before the first and after the last one"),
            (state.duplicates, "stamp", " twice"),
            (state.conflicts, "stamp", " with two different values (two publishers, or the clock was set back)"),
            (state.out_of_order, message, " out of order"),
            (state.irregular, "interval", " off the sampling grid"),
        ):
            if count:
                problems.append(f"{shown}: {counted(count, noun, rest)}")
        if state.nan and name not in cameras:
            problems.append(f"{shown}: {counted(state.nan, message)} {empty}")
    missing_ends(lost, problems, stamps)
    if failure := str(statistics_of(run.parameters, "plant").get(FAILURE, "")):
        problems.append(f"the run failed: {failure}")
    elif early := run_end(run.parameters, run.covered_ticks if isinstance(run, Run) else None).text:
        problems.append(early)
    dropped = {name: run[name].integrity.nan for name in cameras}
    for name, count in dropped.items():
        if count:
            # Reasons and counts of a camera that takes images; empty for others
            first = "frames_"
            counts = {
                key: value for key, value in statistics_of(run.parameters, "plant").items() if key.startswith(first)
            }
            why = ", ".join(
                f"{value} {key.removeprefix(first).replace('_', ' ')}" for key, value in sorted(counts.items())
            )
            what = f"without angles: {why}" if why else "dropped (NaN)"
            problems.append(f"{name}: {count} {'frame' if count == 1 else 'frames'} {what}")
    return {k: v for k, v in lost.items() if v}, problems, sum(dropped.values())


def missing_ends(lost: dict[str, int], problems: list[str], stamps: dict[str, tuple[int, int, float]]) -> None:
    """Samples a topic lacks at the start or the end against all others, the truth as well; one period is no loss."""
    if "truth/los" not in stamps:
        return
    first, last = min(begin for begin, _, _ in stamps.values()), max(end for _, end, _ in stamps.values())
    for name, (begin, end, period) in stamps.items():
        step = period * 1e9
        short = int(max(begin - first, 0) / step + 1e-6) + int(max(last - end, 0) / step + 1e-6)
        # The command to the last sensor tick may fall after the end of the recording.
        if short > 1:
            lost[name] += short
            problems.append(f"{name}: {counted(short, 'sample')} missing at the start or the end of the run")
