"""Whether a mirror follows its command, by the angles of its gauges.

The commanded angles pass the nominal dynamics of the mirror, ``w^2 / (s^2 + 2 d w s + w^2)`` with held commands. In
each block of samples the response is delayed by the lag at which the measured angles are nearest to it. The block
deviates where the rms of what is left exceeds the tolerance of :class:`FollowingSettings`. The mirror does not follow
where the blocks that deviate, less those since the first of them that do not, last for longer than the patience.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from pointing_analysis.arrays import BoolArray, FloatArray, IntArray
from pointing_analysis.files.structured_text import is_number
from pointing_analysis.indices.telescope_values import telescope_value
from pointing_analysis.read.mcap.records import BagError
from pointing_analysis.read.recorded_sensors import sensors_of
from pointing_analysis.read.recording import Recording
from pointing_analysis.read.topic import NANO, on_grid

COMMAND, GAUGE = "fsm/command", "fsm/strain_gauge"
"""Topics of the commanded and of the measured angles."""
SETTLED = 12.0
"""Time constants after which the response to a command is over."""
LEAST_DAMPING = 0.01
"""Damping ratio of a mirror whose data have less: without any its response would never be over."""


@dataclass(frozen=True)
class FollowingSettings:
    """Tolerance between the angles of a mirror and their command.

    Parameters
    ----------
    block : int
        Samples that are compared at a time.
    lag : int
        Largest delay of the angles behind the nominal response, in samples: transport and age.
    share : float
        Deviation (rms) that is permitted for each response (rms): gain and dynamics that are not nominal, the 20 % of
        ``device check``.
    noise : float
        The same for each standard deviation of the gauges' noise, the factor of ``device check``.
    floor : float
        Deviation (rms) that is permitted at any response [rad]: three steps of 16 bits over the stroke.
    patience : int
        Samples after the hold and the fade of a command for which a larger deviation may last.
    """

    block: int = 50
    lag: int = 6
    share: float = 0.2
    noise: float = 3.0
    floor: float = 5e-7
    patience: int = 100


class MirrorFollowing:
    """Compares command and angles of a mirror, block after block.

    Parameters
    ----------
    frequency, damping : float
        Natural frequency [rad/s] and damping ratio of the mirror on its joint.
    noise : float
        Standard deviation of an angle of the gauges [rad].
    settings : FollowingSettings
    dt : float
        Sampling period [s].
    fade : int
        Samples for which a command is held and fades.

    Examples
    --------
    A mirror that stays at zero while it is commanded to move does not follow; one that moves 10 % less does:

    >>> command = 1e-4 * np.sin(0.1 * np.arange(200.0))[:, None] * [1.0, 0.5]
    >>> dead, weak = (MirrorFollowing(1569.0, 0.15, 1e-8, FollowingSettings(), 1e-3, 40) for _ in range(2))
    >>> dead.deviates(command, 0.0 * command).tolist(), weak.deviates(command, 0.9 * command).tolist()
    ([True, True, True, True], [False, False, False, False])
    """

    def __init__(
        self, frequency: float, damping: float, noise: float, settings: FollowingSettings, dt: float, fade: int
    ) -> None:
        self.settings, self._noise, self.limit = settings, noise, fade + settings.patience
        damping = max(damping, LEAST_DAMPING)
        rows = np.array([[0.0, 1.0, 0.0], [-(frequency**2), -2.0 * damping * frequency, frequency**2], [0.0, 0.0, 0.0]])
        held = linalg.expm(rows * dt)
        state, taps = held[:2, 2], []
        for _ in range(math.ceil(SETTLED / (damping * frequency * dt))):
            taps.append(state[0])
            state = held[:2, :2] @ state
        self._taps: FloatArray = np.array(taps)
        self.reset()

    def reset(self) -> None:
        """Begin another record, in the steady state of its first command."""
        self._past: FloatArray | None = None  # commands of which the next responses depend
        self._lasting = 0

    def lasting(self, deviates: BoolArray) -> IntArray:
        """Samples for which the mirror has not followed at the end of each block, (m,); beyond `limit` it is at fault.

        A block that deviates adds its samples, any other one takes as many away: a motion through zero hides a mirror
        at rest for a while.
        """
        size, counts = self.settings.block, []
        for odd in deviates.tolist():
            self._lasting = min(self._lasting + size, self.limit + size) if odd else max(self._lasting - size, 0)
            counts.append(self._lasting)
        return np.array(counts, np.int64)

    def deviates(self, command: FloatArray, angle: FloatArray) -> BoolArray:
        """Whether the mirror deviates from its command in each of the blocks that continue the last ones, (m,).

        A block of which less than half of the angles are known does not.

        Parameters
        ----------
        command : (m block, 2)
            Held from each sample to the next [rad].
        angle : (m block, 2)
            Measured at the end of that time, or up to `lag` samples later [rad]; NaN: not known.
        """
        settings, size = self.settings, self.settings.block
        past = np.tile(command[0], (len(self._taps) - 1 + settings.lag, 1)) if self._past is None else self._past
        commands = np.concatenate([past, command])
        self._past = commands[len(command) :]
        course = np.column_stack([np.convolve(axis, self._taps, "valid") for axis in commands.T])
        seen = angle.reshape(-1, size, 2)
        known = np.isfinite(seen).all(axis=2)
        count = known.sum(axis=1)
        lags = [course[settings.lag - lag : len(course) - lag].reshape(seen.shape) for lag in range(settings.lag + 1)]
        squares = [np.where(known, np.square(seen - delayed).sum(axis=2), 0.0).sum(axis=1) for delayed in lags]
        rest = np.sqrt(np.min(squares, axis=0) / np.maximum(count, 1))
        moved = np.sqrt(np.square(lags[0]).sum(axis=2).mean(axis=1))
        tolerance = settings.share * moved + settings.noise * math.sqrt(2.0) * self._noise + settings.floor
        return np.asarray((rest > tolerance) & (2 * count >= size))


def not_followed(run: Recording, settings: FollowingSettings | None = None) -> tuple[tuple[float, float], ...]:
    """Periods of a run with a device in which the mirror did not follow its command: begin and end of each [s].

    A period lasts longer than the hold and the fade of a command and the patience of the settings. Times count from the
    first sample of the gauges. Empty where none is known: without a device, or without commands and angles.

    Parameters
    ----------
    run : Recording
    settings : FollowingSettings, optional
        Default: the usual tolerance.
    """
    # of a replay the commands are not those that the device got
    if (
        not run.parameters.get("device")
        or run.parameters.get("mode") != "realtime"
        or not {COMMAND, GAUGE} <= set(run.topics)
    ):
        return ()
    settings, gauge = settings or FollowingSettings(), run[GAUGE]
    try:
        (angle, dt), (command, period) = on_grid(gauge), on_grid(run[COMMAND])
    except BagError:
        return ()
    if abs(period - dt) > 1e-9:
        return ()
    # the command with the stamp of a sample is applied one sample later
    first = round((run[COMMAND].grid_start - gauge.grid_start) / (dt * NANO)) + 1
    noise = [max(sensor.noise) for sensor in sensors_of(run) if sensor.topic == GAUGE and sensor.noise]
    frequency, damping = (telescope_value(run, name) for name in ("fsm_frequency", "fsm_damping"))
    waits = (run.parameters.get(name) for name in ("hold_ticks", "fade_ticks"))
    fade = sum(int(ticks) for ticks in waits if is_number(ticks))
    watch = MirrorFollowing(frequency, damping, max(noise, default=0.0), settings, dt, fade)
    authority = telescope_value(run, "fsm_authority")
    size, held, deviates = settings.block, np.zeros(2), []
    for begin in range(0, len(angle) - size + 1, 1000 * size):
        rows = np.arange(begin, begin + min(1000, (len(angle) - begin) // size) * size)
        there = (rows >= first) & (rows < first + len(command))
        asked: FloatArray = np.full((len(rows), 2), np.nan)
        seen = np.array(angle[rows, :2])
        asked[there] = command[rows[there] - first, :2]
        applied = (np.abs(asked) <= authority * (1.0 + 1e-9)).all(axis=1)
        latest = np.maximum.accumulate(np.where(applied, np.arange(len(rows)), -1))
        asked = np.where(latest[:, None] < 0, held, asked[latest])
        held, seen[~applied] = asked[-1], np.nan
        deviates.append(watch.deviates(asked, seen))
    odd = np.concatenate([[False], *deviates])
    counts = watch.lasting(odd)
    begins, ends = np.flatnonzero(np.diff(np.concatenate([[0], counts > 0, [0]]))).reshape(-1, 2).T
    return tuple(
        ((begin - 1) * size * dt, (begin + int(np.flatnonzero(odd[begin:end])[-1])) * size * dt)
        for begin, end in zip(begins.tolist(), ends.tolist())
        if counts[begin:end].max() > watch.limit
    )
