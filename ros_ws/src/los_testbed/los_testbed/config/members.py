"""Members of the telescope's uncertain family: ranges, random ones, the worst one of a stage.

What varies: the angle of the solar arrays (``theta`` [rad], or ``tau = tan(theta/4)``), the speeds of the wheels
(``wheel_speed`` [rad/s]), uncertain frequencies (``omega_1``, ``omega_2`` [rad/s] of the first array and those like
it, or ``frequencies`` of all arrays and appendages), and any parameter by its name (``parameter_values``). The ranges
are those of the parameter file.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lftkit.errors import InputError
from lftkit.support.input_files import read_text
from lftkit.support.structured_text import load_json
from los_design.files import WORST_POINTS
from los_testbed.config.run_config import RunConfig
from titop_plant.physical_settings import ANGLE
from titop_plant.simulation.plant_config import start_speeds, stated_values
from titop_plant.telescope.layout import speed_names
from titop_plant.telescope.load import load_telescope
from titop_plant.telescope.motion_profiles import read_profile
from titop_plant.telescope.uncertain_parameters import moves

if TYPE_CHECKING:
    from lftkit import RealParameter
    from titop_plant.telescope.telescope import Telescope

MEMBER = ("theta", "tau", "wheel_speed", "omega_1", "omega_2", "frequencies", "parameter_values")
"""Settings that choose a member of the family."""

REFERENCE_FREQUENCIES = ("solar_array.omega_1", "solar_array.omega_2")
"""Parameters that are ``omega_1`` and ``omega_2`` in settings and data sets, as the options of a run."""


def random_member(seed: int, parameters: str | None = None) -> dict[str, Any]:
    """Settings of a random member of the family: uniform in the ranges, the same for the same seed.

    It is the member that ``system.sample_values(numpy.random.default_rng(seed))`` of the telescope's
    :class:`~lftkit.System` draws first.

    Parameters
    ----------
    seed : int
        Not negative.
    parameters : str, optional
        Parameter file; default: the reference telescope.

    Returns
    -------
    dict
        As :func:`member_settings`.

    Raises
    ------
    ValueError
        A negative seed.

    Examples
    --------
    >>> random_member(3) == random_member(3), random_member(3) == random_member(4)
    (True, False)
    """
    if seed < 0:
        raise InputError(f"sample must be a seed that is not negative, got {seed}")
    rng = np.random.default_rng(seed)
    telescope = load_telescope(parameters)
    drawn = {name: float(rng.uniform(p.lower, p.upper)) for name, p in telescope.uncertain.items()}
    return member_settings(drawn, telescope)


def member_settings(values: Mapping[str, float], telescope: Telescope) -> dict[str, Any]:
    """Values of the uncertain parameters as settings of a run.

    Returns
    -------
    dict
        ``tau`` where an array turns; ``wheel_speed`` [rad/s]; the reference's frequencies as ``omega_1``, ``omega_2``;
        the others as ``parameter_values``.

    Examples
    --------
    >>> from titop_plant.telescope.load import load_telescope
    >>> member_settings({"solar_array.tau": 1.0, "solar_array.omega_1": 0.74}, load_telescope())
    {'tau': 1.0, 'parameter_values': {'solar_array.omega_1': 0.74}}
    """
    others = dict(values)
    settings: dict[str, Any] = {"tau": others.pop(ANGLE)} if ANGLE in others else {}
    speeds = dict(zip(speed_names(len(telescope.wheels)), telescope.default_speeds))
    if speeds.keys() & others.keys():
        settings["wheel_speed"] = [others.pop(name, speed) for name, speed in speeds.items()]
    if tuple(others) == REFERENCE_FREQUENCIES:
        return settings | {name.rpartition(".")[2]: value for name, value in others.items()}
    return settings | ({"parameter_values": others} if others else {})


def worst_member(loop: str, worst_of: str, parameters: str | None = None, designs: str = "") -> dict[str, Any]:
    """Settings of the member of the family that is worst for a stage.

    Parameters
    ----------
    loop : str
        Stage.
    worst_of : {"RPE", "APE", "slow", "fast"}
    parameters : str, optional
        Parameter file; default: the reference telescope.
    designs : str
        Folder of designs with :data:`los_design.files.WORST_POINTS`; empty for the stored designs.

    Returns
    -------
    dict
        As :func:`random_member`; empty where no worst values of this telescope and stage are stored: nominal values are
        meant.

    Raises
    ------
    ValueError
        A file of another form.
    """
    from los_design.search import worst_points

    folder = Path(designs) if designs else Path(worst_points.__file__).parent
    path = folder / WORST_POINTS
    if not path.exists():
        return {}
    telescope = load_telescope(parameters)
    try:
        content = load_json(read_text(path), path)
        if content["parameters_hash"] != telescope.parameters_hash:
            return {}
        stages = content["stages"]
        return member_settings(stages[loop][worst_of]["parameters"], telescope) if loop in stages or not stages else {}
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise InputError(f"{path} must hold the worst values of {loop} for {worst_of}, got {error!r}") from None


def check_ranges(config: RunConfig, telescope: Telescope) -> None:
    """Refuse a configuration whose plant is not in the family, at its start or at the end of its ramps.

    Parameters
    ----------
    config : RunConfig
    telescope : Telescope
        Of the telescope.

    Raises
    ------
    ValueError
        Names the parameter, its range and what came.

    Examples
    --------
    >>> from titop_plant.telescope.load import load_telescope
    >>> check_ranges(RunConfig(omega_1=2.0), load_telescope())
    Traceback (most recent call last):
        ...
    lftkit.errors.InputError: omega_1 must be between 0.70585 and 0.78015 rad/s, got 2 rad/s
    """
    table = telescope.uncertain
    if config.loop not in (stages := telescope.stages):
        raise InputError(f"loop must be one of {', '.join(stages)} of this telescope, got {config.loop}")
    by_name = config.parameter_values or {}
    for name, value in stated_values(config, telescope).items():
        if name in by_name or not moves(name):
            _within(name if name in by_name else _setting_of(name, config), table[name], value)
    if config.motion_from_file:
        if moving := [name for name in by_name if moves(name)]:
            raise InputError(f"{moving[0]} must be absent with a profile from a file, got {by_name[moving[0]]:g}")
        _check_profile(config, telescope, table)
        return
    turn = config.theta_rate * config.ramp_duration
    if ANGLE in table:
        if config.tau is not None:
            _within("tau", table[ANGLE], config.tau)
        for angle, when in ((config.array_angle, ""), (config.array_angle + turn, " at the end of the ramp")):
            _within_angle(table[ANGLE], angle, when)
    _check_speeds(config.wheel_speed or (), telescope)
    if config.wheel_acceleration and config.ramp_duration:
        speeds = start_speeds(config, telescope)
        ends = [speed + gain * config.ramp_duration for speed, gain in zip(speeds, config.wheel_acceleration)]
        _check_speeds(ends, telescope, " at the end of the ramp")


def _check_speeds(speeds: Iterable[float], telescope: Telescope, when: str = "") -> None:
    """Refuse speeds of wheels out of their ranges; a plant from a file may have none, they are those of its tones."""
    table = telescope.uncertain
    for i, (speed, wheel) in enumerate(zip(speeds, telescope.wheels), start=1):
        if parameter := table.get(f"wheel_{i}.speed"):
            _within(f"wheel_speed (wheel {i})", parameter, speed, when)
        elif not wheel.varies and speed != wheel.default_speed:
            only = f"{wheel.default_speed:g} rad/s"
            raise InputError(f"wheel_speed (wheel {i}) must be its only speed, {only}, got {speed:g} rad/s{when}")


def _check_profile(config: RunConfig, telescope: Telescope, table: Mapping[str, RealParameter]) -> None:
    for time, theta, *speeds in read_profile(Path(config.profile), len(telescope.wheels)).table():
        when = f" at {time:g} s of {config.profile}"
        if ANGLE in table:
            _within_angle(table[ANGLE], theta, when)
        _check_speeds(speeds, telescope, when)


def _setting_of(name: str, config: RunConfig) -> str:
    """Setting that gives an uncertain frequency."""
    return name.rpartition(".")[2] if config.frequencies is None else f"frequencies ({name})"


def _within_angle(tau: RealParameter, angle: float, when: str) -> None:
    _between("theta", 4.0 * math.atan(tau.lower), 4.0 * math.atan(tau.upper), "rad", angle, when)


def _within(name: str, parameter: RealParameter, value: float, when: str = "") -> None:
    _between(name, parameter.lower, parameter.upper, "" if parameter.unit == "1" else parameter.unit, value, when)


def _between(name: str, low: float, high: float, unit: str, value: float, when: str) -> None:
    if not low - 1e-9 * (high - low) <= value <= high + 1e-9 * (high - low):
        unit = f" {unit}" if unit else ""
        raise InputError(f"{name} must be between {low:g} and {high:g}{unit}, got {value:g}{unit}{when}")
