"""Members of a campaign: points of the box of uncertain parameters, in an order that the seed fixes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from los_testbed.config.members import REFERENCE_FREQUENCIES, member_settings
from titop_plant.physical_settings import ANGLE
from titop_plant.telescope.load import load_telescope
from titop_plant.telescope.motion_profiles import read_csv
from titop_plant.telescope.telescope import Telescope
from titop_plant.telescope.uncertain_parameters import SPEED, further_parameters

SAMPLINGS = ("uniform", "lhs", "corners", "adversarial")
RANDOM = SAMPLINGS[:2]
"""Samplings whose members are random draws: only these have a probability."""

MOST_CORNERS = 1_000_000

_SEEDS = 2**31 - 1


@dataclass(frozen=True)
class MemberParameters:
    """Parameters that vary in a campaign: the uncertain parameters of a telescope, one column each.

    Columns are ``tau`` = tan(theta/4) of the arrays that turn, ``wheel_speed_1`` and so on [rad/s], then the
    frequencies [rad/s]: ``omega_1`` and ``omega_2`` where they are those of the reference telescope, else the name of
    the parameter, for instance ``panel.omega_1``.

    Parameters
    ----------
    ranges : mapping of str to (float, float)
        Range of each parameter by its name in the telescope.
    telescope : Telescope
    fixed : mapping of str to float
        Values of parameters that all members have.
    """

    ranges: Mapping[str, tuple[float, float]]
    telescope: Telescope
    fixed: Mapping[str, float]

    @classmethod
    def of(cls, parameters: str | None = None, fixed: Mapping[str, float] | None = None) -> MemberParameters:
        """Those of a parameter file, or of the reference telescope, without those that all members have alike.

        Raises
        ------
        ValueError
            The file cannot be read or is no parameter file.

        Examples
        --------
        >>> MemberParameters.of().columns[:2], MemberParameters.of().columns[-2:]
        (('tau', 'wheel_speed_1'), ('omega_1', 'omega_2'))
        """
        telescope, fixed = load_telescope(parameters), fixed or {}
        table = {name: one for name, one in telescope.uncertain.items() if name not in fixed}

        def place(name: str) -> int:
            return 0 if name == ANGLE else 1 if SPEED.fullmatch(name) else 2

        ranges = {name: (table[name].lower, table[name].upper) for name in sorted(table, key=place)}
        return cls(ranges, telescope, fixed)

    @cached_property
    def columns(self) -> tuple[str, ...]:
        """Columns of the data set, in the order of `ranges`."""
        frequencies = tuple(further_parameters(self.ranges, self.telescope.factors))
        short = {ANGLE, *(frequencies if frequencies == REFERENCE_FREQUENCIES else ())}

        def column(name: str) -> str:
            stem, _, quantity = name.rpartition(".")
            if SPEED.fullmatch(name):
                return f"wheel_speed_{stem.removeprefix('wheel_')}"
            return quantity if name in short else name

        return tuple(column(name) for name in self.ranges)

    @cached_property
    def limits(self) -> FloatArray:
        """Lower and upper ends, shape (parameters, 2)."""
        return np.array(list(self.ranges.values())).reshape(len(self.ranges), 2)

    def checked(self, row: Mapping[str, float]) -> dict[str, float]:
        """Values by the names of the parameters, of a member given by columns, with those that all members have.

        Raises
        ------
        ValueError
            One is outside its range.
        """
        checked = {}
        for column, (name, (low, high)) in zip(self.columns, self.ranges.items()):
            value, slack = float(row[column]), 1e-9 * (high - low)
            if not low - slack <= value <= high + slack:
                raise InputError(f"{column} must be between {low:g} and {high:g}, got {value:g}")
            checked[name] = value
        return {**checked, **self.fixed}

    def settings(self, row: Mapping[str, Any]) -> dict[str, Any]:
        """Settings of a run from a member; a row of a campaign's data set will do."""
        values = {name: float(row[column]) for column, name in zip(self.columns, self.ranges)}
        member = member_settings({**values, **self.fixed}, self.telescope)
        return {"seed": int(row["seed"]), "parameter_values": None, **member}

    def command(self, row: Mapping[str, Any], options: str = "") -> str:
        """Command line that runs a member again and records it."""
        words = ["los-testbed run --mode inprocess"]
        settings = self.settings(row)
        by_name = settings.pop("parameter_values") or {}
        for name, value in settings.items():
            numbers = value if isinstance(value, list) else [value]
            words += [f"--{name.replace('_', '-')}", *(repr(v) for v in numbers)]
        return " ".join([*words, *(f"--set {name}={value!r}" for name, value in by_name.items())]) + options


def members(
    sampling: str,
    samples: int,
    seed: int,
    parameters: str | None = None,
    fixed: Mapping[str, float] | None = None,
) -> FloatArray:
    """Parameters of the members of a campaign.

    Parameters
    ----------
    sampling : str
        ``uniform``: independent, so that more samples of the same seed continue the list; ``lhs``: Latin hypercube;
        ``corners``: the corners of the box; else the path of a CSV file whose header is the columns. For
        ``adversarial`` see :func:`los_testbed.campaign.adversarial.adversarial_members`, which needs controllers.
    samples : int
        Number of members; 0 for all corners or all lines of a file.
    seed : int
    parameters : str, optional
        Parameter file; default: the reference telescope.
    fixed : mapping, optional
        Values of parameters that all members have: these are no columns.

    Returns
    -------
    ndarray, shape (samples, parameters)
        In the order of :attr:`MemberParameters.columns`.

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
    member = MemberParameters.of(parameters, fixed)
    ranges, count = member.limits, len(member.columns)
    if sampling == "adversarial":
        raise InputError("sampling must be one that needs no controllers here, got 'adversarial'")
    if sampling not in SAMPLINGS:
        path = Path(sampling)
        header, lines = read_csv(path, "sampling", SAMPLINGS)
        if sorted(header) != sorted(member.columns):
            raise InputError(
                f"{path}: the header must be {','.join(member.columns)}, got {','.join(header) or 'nothing'}"
            )
        points = np.empty((len(lines), len(member.columns)))
        for number, line in enumerate(lines, start=2):
            texts = {name: text.strip() for name, text in zip(header, line)}
            values = {name: _number(texts.get(name, "")) for name in member.columns}
            for column, (low, high) in zip(member.columns, member.limits):
                if math.isnan(values[column]):
                    got = texts.get(column, "")
                    raise InputError(
                        f"{path}, line {number}: {column} must be between {low:g} and {high:g}, got {got!r}"
                    )
            try:
                points[number - 2] = [member.checked(values)[name] for name in member.ranges]
            except ValueError as error:
                raise InputError(f"{path}, line {number}: {error}") from None
        return _first(points, samples, "lines")
    if sampling == "corners":
        wanted = samples or 2**count
        if wanted > MOST_CORNERS:
            raise InputError(f"samples must be 1 to {MOST_CORNERS} of the 2^{count} corners, got {wanted}")
        bits = (np.arange(min(2**count, MOST_CORNERS))[:, None] >> np.arange(count)) & 1
        return _first(np.where(bits, ranges[:, 1], ranges[:, 0]), samples, "corners")
    if samples < 1:
        raise InputError(f"samples must be 1 or more, got {samples}")
    if sampling == "lhs":
        from scipy.stats import qmc

        rng = np.random.default_rng(_sequence(seed, 0))
        unit: FloatArray = qmc.LatinHypercube(count, seed=rng).random(samples)
    else:
        unit = np.asarray(np.random.default_rng(_sequence(seed, 0)).random((samples, count)))
    return np.asarray(ranges[:, 0] + unit * (ranges[:, 1] - ranges[:, 0]))


def member_seeds(samples: int, seed: int) -> NDArray[np.int64]:
    """Seed of the noise and of the disturbance's phases of each member, shape (samples,); more continue the list."""
    return np.random.default_rng(_sequence(seed, 1)).integers(0, _SEEDS, size=samples)


def _sequence(seed: int, stream: int) -> np.random.SeedSequence:
    if seed < 0:
        raise InputError(f"seed must not be negative, got {seed}")
    return np.random.SeedSequence(seed, spawn_key=(stream,))


def _first(points: FloatArray, samples: int, what: str) -> FloatArray:
    if samples > len(points):
        raise InputError(f"samples must be at most {len(points)}, the number of {what}, got {samples}")
    if samples < 0 or not len(points):
        raise InputError(f"samples must be 1 or more, got {min(samples, len(points))}")
    return np.asarray(points[: samples or len(points)], dtype=float)


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan
