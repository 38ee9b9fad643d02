"""Motion of the array angle and of the wheel speeds during a run: linear, trapezoidal, or from a CSV file.

All are kept as values at knots, linear between them; before the first and after the last knot everything is constant.
The angle through which a wheel has turned is then known in closed form, so the phase of its tones is exact at any time.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from lftkit.support.input_files import read_text
from lftkit.support.input_limits import LINES
from titop_plant.physical_settings import PROFILES

BLEND = 0.25
"""Share of a trapezoidal profile in which the rates rise, and in which they fall."""

BLEND_KNOTS = 50


def columns(wheels: int) -> tuple[str, ...]:
    """Header of a CSV file for so many wheels: s, rad, rad/s.

    Examples
    --------
    >>> columns(3)
    ('time', 'theta', 'wheel_speed_1', 'wheel_speed_2', 'wheel_speed_3')
    """
    return ("time", "theta", *(f"wheel_speed_{i}" for i in range(1, wheels + 1)))


@dataclass(frozen=True)
class MotionProfile:
    """Array angle and wheel speeds over time.

    Parameters
    ----------
    time : ndarray, shape (k,)
        Knots [s], rising from 0.
    theta : ndarray, shape (k,)
        Angle of the arrays [rad].
    speed : ndarray, shape (k, wheels)
        Wheel speeds [rad/s], signed.

    Examples
    --------
    >>> wheels = MotionProfile(np.array([0.0, 2.0]), np.zeros(2), np.array([[-1.0] * 4, [3.0] * 4]))
    >>> wheels.speeds(0.5).tolist(), wheels.turned([1.0, 2.0, 3.0])[:, 0].tolist()
    ([0.0, 0.0, 0.0, 0.0], [0.0, 2.0, 5.0])
    """

    time: FloatArray
    theta: FloatArray
    speed: FloatArray

    @property
    def duration(self) -> float:
        """Time of the last knot [s]."""
        return float(self.time[-1])

    def angle(self, time: ArrayLike) -> FloatArray:
        """Array angle [rad]."""
        return np.asarray(np.interp(np.asarray(time, dtype=float), self.time, self.theta))

    def speeds(self, time: ArrayLike) -> FloatArray:
        """Wheel speeds [rad/s], shape (..., wheels)."""
        t = np.asarray(time, dtype=float)
        return np.stack([np.interp(t, self.time, column) for column in self.speed.T], axis=-1)

    def turned(self, time: ArrayLike) -> FloatArray:
        """Angle through which each wheel has turned since time 0 [rad], shape (..., wheels)."""
        t = np.asarray(time, dtype=float)
        mean = 0.5 * (self.speed[1:] + self.speed[:-1])
        whole = np.vstack([np.zeros(self.speed.shape[1]), np.cumsum(mean * np.diff(self.time)[:, None], axis=0)])
        k = np.clip(np.searchsorted(self.time, t, side="right") - 1, 0, len(self.time) - 1)
        return np.asarray(whole[k] + 0.5 * (self.speed[k] + self.speeds(t)) * (t - self.time[k])[..., None])

    def steepest(self) -> tuple[float, float]:
        """Largest rates of the array angle [rad/s] and of a wheel speed [rad/s2], absolute."""
        steps = np.diff(self.time)
        if not steps.size:
            return 0.0, 0.0
        theta, speed = np.abs(np.diff(self.theta)) / steps, np.abs(np.diff(self.speed, axis=0)) / steps[:, None]
        return float(theta.max()), float(speed.max())

    def table(self) -> list[list[float]]:
        """Knots as rows in the order of :func:`columns`."""
        table: list[list[float]] = np.column_stack([self.time, self.theta, self.speed]).tolist()
        return table


def linear_profile(
    theta: float, rate: float, speed: ArrayLike, acceleration: ArrayLike, duration: float
) -> MotionProfile:
    """Constant rates [rad/s, rad/s2] for `duration` seconds."""
    return _moved(np.array([0.0, duration]), np.array([0.0, duration]), theta, rate, speed, acceleration)


def trapezoidal_profile(
    theta: float, rate: float, speed: ArrayLike, acceleration: ArrayLike, duration: float
) -> MotionProfile:
    """The same mean rates and ends as :func:`linear_profile`; the rates rise and fall linearly in a quarter each.

    Examples
    --------
    >>> profile = trapezoidal_profile(0.0, 0.1, np.zeros(4), np.ones(4), 8.0)
    >>> [round(float(profile.angle(t)), 4) for t in (0.0, 1.0, 4.0, 8.0)]
    [0.0, 0.0333, 0.4, 0.8]
    """
    blend = np.linspace(0.0, BLEND * duration, BLEND_KNOTS + 1)
    top = 1.0 / (1.0 - BLEND)
    rise = 0.5 * top * blend**2 / (BLEND * duration)
    knots = np.concatenate([blend, (duration - blend)[::-1]])
    return _moved(knots, np.concatenate([rise, (duration - rise)[::-1]]), theta, rate, speed, acceleration)


def _moved(
    time: FloatArray, passed: FloatArray, theta: float, rate: float, speed: ArrayLike, acceleration: ArrayLike
) -> MotionProfile:
    return MotionProfile(time, theta + rate * passed, np.asarray(speed) + np.outer(passed, np.asarray(acceleration)))


def read_csv(path: Path, what: str, choices: Iterable[str]) -> tuple[list[str], list[list[str]]]:
    """Header and lines of a CSV file that a setting names in place of one of its choices.

    Parameters
    ----------
    path : Path
    what : str
        The setting, for the message.
    choices : iterable of str
        Its values that are no file.

    Raises
    ------
    ValueError
        No such file, or no text.
    """
    try:
        text = read_text(path).removeprefix("\ufeff").rstrip()
        if text.count("\n") > LINES:
            raise InputError(f"{path} must have at most {LINES} lines, got more")
        lines = list(csv.reader(text.splitlines()))
    except OSError as error:
        raise InputError(
            f"{what} must be one of {', '.join(choices)} or a CSV file, got {path}: {error.strerror}"
        ) from None
    except UnicodeDecodeError:
        raise InputError(f"{path} is not a CSV file: expected UTF-8 text") from None
    return [name.strip() for name in lines[0]] if lines else [], lines[1:]


def read_profile(path: Path, wheels: int) -> MotionProfile:
    """Profile of a CSV file with the header :func:`columns` for so many wheels.

    Raises
    ------
    ValueError
        No such file, another header, a value that is no finite number, times that do not rise from 0.
    """
    known = columns(wheels)
    header, lines = read_csv(path, "profile", PROFILES)
    if header != list(known):
        raise InputError(f"{path}: the header must be {','.join(known)}, got {','.join(header) or 'nothing'}")
    rows = []
    for number, line in enumerate(lines, start=2):
        try:
            rows.append([float(text) for text in line])
        except ValueError:
            rows.append([np.nan])
        if len(rows[-1]) != len(known) or not np.isfinite(rows[-1]).all():
            raise InputError(f"{path}, line {number}: must hold {len(known)} finite numbers, got {','.join(line)!r}")
    values = np.array(rows).reshape(-1, len(known))
    if len(values) < 2 or values[0, 0] != 0.0 or not (np.diff(values[:, 0]) > 0.0).all():
        raise InputError(f"{path}: time must increase from 0 over two lines or more, got {len(values)} lines")
    return MotionProfile(values[:, 0], values[:, 1], values[:, 2:])
