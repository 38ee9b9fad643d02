"""Error series of a run: performance error, knowledge error, transient dropped."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from weakref import WeakKeyDictionary

import numpy as np

from pointing_analysis.arrays import FloatArray, IntArray
from pointing_analysis.indices.metrics import AXES
from pointing_analysis.indices.seen_samples import ALL_SEEN, Unseen, seen_samples
from pointing_analysis.indices.telescope_values import telescope_value
from pointing_analysis.read.mapped_arrays import by_parts, common_rows, empty, parts, rows_made
from pointing_analysis.read.mcap.records import BagError, ShortRunError
from pointing_analysis.read.messages.topic_columns import CAMERA
from pointing_analysis.read.recording import Recording
from pointing_analysis.read.topic import OFF_GRID, Topic, on_grid, read_only
from pointing_analysis.units import RAD_PER_ARCSEC as RAD_PER_ARCSEC
from pointing_analysis.units import RAD_PER_MAS as RAD_PER_MAS

#: [s] excluded of a run without a stated start; one that starts in its steady state states that nothing is
#: to be left out. The answer of a washout of 0.1 rad/s to the bias of accelerometers lasts longer, some 60 s
SETTLING = 5.0
LARGEST = 1e60
"""[rad] Sums of fourth powers of larger values are not finite; they are no angles."""
OFF_PHASE = 0.5
"""Largest share of the intervals of a device's frames that are off their grid: they have stamps of its own clock, and
frames that are off phase are counted and reported (docs/connect_your_rig.md)."""
LEAST = 1.0  # [s] dropped from any run: the line of sight before the loop has taken hold
_PERFORMANCE: WeakKeyDictionary[Topic, dict[tuple[float, str], ErrorSeries]] = WeakKeyDictionary()
"""Performance errors that were asked for, by line of sight, seconds left out, and axis: requirements, figures, and the
report ask for the same ones."""


@dataclass(frozen=True)
class ErrorSeries:
    """A 2-axis error on a uniform time axis.

    Attributes
    ----------
    values : (n, 2) [rad], NaN where a sample is missing; of the error of one axis the other column is zero
    dt : sampling period [s]
    start : time of the first row after the first sample of the run [s]: the transient that was dropped
    missing : samples missing
    open_end : whether the recording is truncated and the number of missing samples at its end is unknown
    unseen : what the record does not show of the motion; these samples are missing
    """

    values: FloatArray
    dt: float
    start: float
    missing: int
    open_end: bool = False
    unseen: Unseen = ALL_SEEN

    @property
    def time(self) -> FloatArray:
        """(n,) seconds after the first sample of the run."""
        return rows_made(len(self.values), lambda row: self.start + self.dt * row)

    @property
    def duration(self) -> float:
        """Length of the series [s]."""
        return self.dt * len(self.values)


def default_transient(duration: float) -> float:
    """Start-up transient [s] dropped from a run of `duration` [s] that does not state it.

    `SETTLING`, from short runs their first half, and never less than `LEAST`.

    Examples
    --------
    >>> default_transient(60.0), default_transient(10.0), default_transient(6.0), default_transient(1.5)
    (5.0, 5.0, 3.0, 1.0)
    """
    return max(LEAST, min(SETTLING, duration / 2))


def transient_of(run: Recording, transient: float | None, duration: float) -> float:
    """Start-up transient to drop [s]: the given one, else the bag's ``transient_s``, else `default_transient`."""
    value = run.parameters.get("transient_s", default_transient(duration)) if transient is None else transient
    if not isinstance(value, (int, float)) or not 0 <= value < math.inf:
        raise BagError(f"transient must be zero or more seconds, got {value!r}")
    return float(value)


def _drop(
    values: FloatArray, dt: float, transient: float, path: object, axis: str, open_end: bool = False
) -> ErrorSeries:
    first = round(min(transient / dt, len(values)))
    if first >= len(values):
        raise ShortRunError(
            f"{path}: the run must be longer than its start-up transient of {transient:g} s, got {len(values) * dt:g} s"
        )
    judged = [axis in ("", one) for one in AXES]
    rows = by_parts(lambda part: np.where(judged, part, 0.0), values[first:, :2])
    if all(np.isnan(rows[part]).any(axis=1).all() for part in parts(len(rows))):
        raise BagError(f"{path}: the line of sight must have finite samples, got none")
    for part in parts(len(rows)):
        if (odd := np.argwhere(np.abs(rows[part]) > LARGEST)).size:
            row, column = map(int, odd[0])
            raise BagError(
                f"{path}: the line of sight must have angles below {LARGEST:g} rad, "
                f"got {rows[part][row, column]:g} rad at {(first + part.start + row) * dt:g} s"
            )
    samples, period, unseen = seen_samples(values, rows, judged, dt)
    missing = sum(int(np.isnan(samples[part]).any(axis=1).sum()) for part in parts(len(samples)))
    return ErrorSeries(read_only(samples), period, first * dt, missing, open_end, unseen)


def on_camera(run: Recording) -> bool:
    """Whether a recording of a device has no true line of sight, so that the camera's has to stand for it."""
    if not run.parameters.get("device") or CAMERA not in run:
        return False
    return "truth/los" not in run or not len(run["truth/los"])


def _gridded(run: Recording, name: str, off_grid: float = OFF_GRID) -> tuple[FloatArray, float]:
    """Samples and period of a topic; messages name the recording and, of another program's file, its own columns."""
    return on_grid(replace(run[name], name=f"{run.path}: {run.shown(name)}"), off_grid)


def performance_error(run: Recording, transient: float | None = None, axis: str = "") -> ErrorSeries:
    """True controlled line of sight minus its target, which is zero; that of the camera where :func:`on_camera`.

    **Sign: error = actual minus target.**

    Parameters
    ----------
    run : a run with the topic ``truth/los``
    transient : seconds to drop at the start (`transient_of`)
    axis : ``x`` or ``y``: the error of this axis alone, by the samples that it has; "" that of both

    Raises
    ------
    BagError
        No truth topic, only transient, or a time axis that is not uniform.
    """
    name, off_grid = (CAMERA, OFF_PHASE) if on_camera(run) else ("truth/los", OFF_GRID)
    if name not in run:
        raise BagError(f"{run.path}: the bag must hold the topic truth/los, got {', '.join(run.topics)}")
    values, dt = _gridded(run, name, off_grid)
    topic = run[name]
    left_out = transient_of(run, transient, dt * (len(values) - topic.absent_after))
    made = _PERFORMANCE.setdefault(topic, {})
    if (left_out, axis) not in made:
        made[left_out, axis] = _drop(values, dt, left_out, run.path, axis, topic.open_end)
    return made[left_out, axis]


def knowledge_error(run: Recording, transient: float | None = None, axis: str = "") -> ErrorSeries:
    """Estimated minus true line of sight, joined by stamp.

    The observer estimates the line of sight *without* the mirror's contribution (the mirror law
    ``u = -estimate / los_sensitivity`` cancels it), so the truth is the controlled line of sight less
    ``los_sensitivity`` times the mirror angle by its gauges.
    **Sign: error = estimate minus truth.** The parameters are those of `performance_error`.

    Raises
    ------
    BagError
        A needed topic is missing, only transient, or a time axis that is not uniform.
    """
    _need(run, "los_estimate")
    estimate = run["los_estimate"]
    return knowledge_error_of(run, estimate.stamp, estimate.values, transient, axis)


def _need(run: Recording, *names: str) -> None:
    for name in names:
        if name not in run:
            raise BagError(
                f"{run.path}: for a knowledge error the bag must hold the topic {name}, got {', '.join(run.topics)}"
            )


def knowledge_error_of(
    run: Recording, stamp: IntArray, estimate: FloatArray, transient: float | None = None, axis: str = ""
) -> ErrorSeries:
    """Knowledge error of any estimate against the truth of a run; see `knowledge_error`.

    Parameters
    ----------
    run : with the topics ``truth/los`` and ``fsm/strain_gauge``
    stamp : (n,) stamps of the estimate [ns], strictly increasing
    estimate : (n, 2 or more) estimated line of sight without the mirror [rad]
    transient : seconds to drop at the start
    axis : ``x``, ``y``, or "" for both
    """
    _need(run, "truth/los", "fsm/strain_gauge")
    truth, angle = run["truth/los"], run["fsm/strain_gauge"]
    grid, dt = _gridded(run, "truth/los")
    gain = telescope_value(run, "los_sensitivity")
    full = empty((len(grid), 2))
    for part in parts(len(full)):
        full[part] = np.nan
    step, matched = round(dt * 1e9), 0
    for rows, columns in common_rows(stamp, angle.stamp):
        index, rest = np.divmod(stamp[rows] - truth.grid_start, step)
        fits = (rest == 0) & (index >= 0) & (index < len(grid))
        index, rows, columns = index[fits], rows[fits], columns[fits]
        full[index] = estimate[rows, :2] + gain * angle.values[columns, :2] - grid[index, :2]
        matched += len(index)
    if not matched:
        raise BagError(f"{run.path}: an estimate and an angle of the mirror must have stamps of truth/los, got none")
    left_out = transient_of(run, transient, dt * (len(grid) - truth.absent_after))
    return _drop(full, dt, left_out, run.path, axis, truth.open_end)
