"""Members of a campaign: points of the box of uncertain parameters, in an order that the seed fixes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lftkit.arrays import FloatArray
from los_testbed.members import family
from titop_plant.telescope.motion_profiles import read_csv

SAMPLINGS = ("uniform", "lhs", "corners", "adversarial")
RANDOM = SAMPLINGS[:2]
"""Samplings whose members are random draws: of these alone is there a probability."""

COLUMNS = ("tau", "wheel_speed_1", "wheel_speed_2", "wheel_speed_3", "wheel_speed_4", "omega_1", "omega_2")
"""Parameters of a member: tan(theta/4), wheel speeds [rad/s], first two frequencies of the arrays [rad/s]."""

DELTA = ("solar_array.tau", *(f"wheel_{i}.speed" for i in range(1, 5)), "solar_array.omega_1", "solar_array.omega_2")
"""The same as names of the telescope's uncertain parameters."""

_SEEDS = 2**31 - 1


def box(parameters: str | None = None) -> dict[str, tuple[float, float]]:
    """Range of each of `COLUMNS` for a parameter file, or for the reference telescope."""
    table = family(parameters)
    if set(table) != set(DELTA):
        raise ValueError(
            f"a campaign must be of a telescope with the parameters {', '.join(DELTA)}, got {', '.join(table)}"
        )
    return {column: (table[name].lower, table[name].upper) for column, name in zip(COLUMNS, DELTA)}


def members(sampling: str, samples: int, seed: int, parameters: str | None = None) -> FloatArray:
    """Parameters of the members of a campaign.

    Parameters
    ----------
    sampling : str
        ``uniform``: independent, so that more samples of the same seed continue the list; ``lhs``: Latin hypercube;
        ``corners``: the corners of the box; else the path of a CSV file with the header `COLUMNS`. For ``adversarial``
        see :func:`los_testbed.campaign.adversarial.adversarial_members`, which needs controllers.
    samples : int
        Number of members; 0 for all corners or all lines of a file.
    seed : int
    parameters : str, optional
        Parameter file; default: the reference telescope.

    Returns
    -------
    ndarray, shape (samples, 7)
        In the order of `COLUMNS`.

    Raises
    ------
    ValueError
        An unknown sampling, a number that does not fit, a file that cannot be read, a line outside the box.

    Examples
    --------
    >>> first, more = members("uniform", 2, 5), members("uniform", 4, 5)
    >>> bool((more[:2] == first).all()), members("corners", 0, 0).shape
    (True, (128, 7))
    """
    ranges: FloatArray = np.array(list(box(parameters).values()))
    if sampling == "adversarial":
        raise ValueError("sampling must be one that needs no controllers here, got 'adversarial'")
    if sampling not in SAMPLINGS:
        return _listed(Path(sampling), samples, ranges)
    if sampling == "corners":
        bits = (np.arange(2 ** len(COLUMNS))[:, None] >> np.arange(len(COLUMNS))) & 1
        return _first(np.where(bits, ranges[:, 1], ranges[:, 0]), samples, "corners")
    if samples < 1:
        raise ValueError(f"samples must be 1 or more, got {samples}")
    if sampling == "lhs":
        from scipy.stats import qmc

        rng = np.random.default_rng(_sequence(seed, 0))
        unit: FloatArray = qmc.LatinHypercube(len(COLUMNS), seed=rng).random(samples)
    else:
        unit = np.asarray(np.random.default_rng(_sequence(seed, 0)).random((samples, len(COLUMNS))))
    return np.asarray(ranges[:, 0] + unit * (ranges[:, 1] - ranges[:, 0]))


def member_seeds(samples: int, seed: int) -> NDArray[np.int64]:
    """Seed of the noise and of the disturbance's phases of each member, shape (samples,); more continue the list."""
    return np.random.default_rng(_sequence(seed, 1)).integers(0, _SEEDS, size=samples)


def settings(row: Mapping[str, Any]) -> dict[str, Any]:
    """Settings of a run from the parameters of a member; a row of a campaign's data set will do."""
    return {
        "seed": int(row["seed"]),
        "tau": float(row["tau"]),
        "wheel_speed": [float(row[f"wheel_speed_{i}"]) for i in range(1, 5)],
        "omega_1": float(row["omega_1"]),
        "omega_2": float(row["omega_2"]),
    }


def command(row: Mapping[str, Any], options: str = "") -> str:
    """Command line that runs a member again and records it."""
    chosen = settings(row)
    speeds = " ".join(repr(v) for v in chosen["wheel_speed"])
    return (
        f"los-testbed run --mode inprocess --seed {chosen['seed']} --tau {chosen['tau']!r} --wheel-speed {speeds} "
        f"--omega-1 {chosen['omega_1']!r} --omega-2 {chosen['omega_2']!r}{options}"
    )


def _sequence(seed: int, stream: int) -> np.random.SeedSequence:
    if seed < 0:
        raise ValueError(f"seed must not be negative, got {seed}")
    return np.random.SeedSequence(seed, spawn_key=(stream,))


def _first(points: FloatArray, samples: int, what: str) -> FloatArray:
    if samples > len(points):
        raise ValueError(f"samples must be at most {len(points)}, the number of {what}, got {samples}")
    if samples < 0 or not len(points):
        raise ValueError(f"samples must be 1 or more, got {min(samples, len(points))}")
    return np.asarray(points[: samples or len(points)], dtype=float)


def _listed(path: Path, samples: int, ranges: FloatArray) -> FloatArray:
    header, lines = read_csv(path, "sampling", SAMPLINGS)
    if sorted(header) != sorted(COLUMNS):
        raise ValueError(f"{path}: the header must be {','.join(COLUMNS)}, got {','.join(header) or 'nothing'}")
    points = np.empty((len(lines), len(COLUMNS)))
    for number, line in enumerate(lines, start=2):
        values = dict(zip(header, line))
        for k, (name, (low, high)) in enumerate(zip(COLUMNS, ranges)):
            text = values.get(name, "").strip()
            value = _number(text)
            slack = 1e-9 * (high - low)
            if not low - slack <= value <= high + slack:
                raise ValueError(f"{path}, line {number}: {name} must be between {low:g} and {high:g}, got {text!r}")
            points[number - 2, k] = value
    return _first(points, samples, "lines")


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan
