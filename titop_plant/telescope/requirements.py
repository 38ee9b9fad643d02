r"""Pointing requirements of a telescope: read from its parameter file, and the limits that a design takes from them.

The list ``[[requirement]]`` of the file has the requirements on a line of sight, in the form of
:mod:`pointing_analysis.requirements.requirement`. Runs are judged by it, and the limits of the synthesis weights
(``telescope.weights``) are made of it:

===================  =================================================================================================
``ape_limit``        of the strictest requirement on \|APE\| that holds for all stages with fine control
``rpe_limit_fine``   of the strictest one on the RPE of windows (where there is none: of instants) that holds for the
                     stage with all actuators
``rpe_window``       its window
``rpe_limit``        of the strictest one with this window that holds for the stage with the mirror alone
===================  =================================================================================================

An older file gives these four values in ``[weights]``: they replace the limits (and the window) of these requirements.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from lftkit.errors import InputError
from pointing_analysis.requirements.requirement import Requirement, entries, parse
from titop_plant.interface import MIRROR_STAGES, STAGES
from titop_plant.telescope.sections import LimitsTable
from titop_plant.telescope.tables.parameter_check import ParameterFile

LIMITS = tuple(LimitsTable.SETTINGS)
"""Values of the table ``weights`` that are made of the requirements."""


def read_requirements(tables: Mapping[str, Any]) -> tuple[Requirement, ...]:
    """Requirements of the tables of a parameter file, those of all stages.

    Examples
    --------
    >>> from titop_plant.telescope.load import load_telescope
    >>> [r.quantity for r in load_telescope().requirements]
    ['|APE|', 'rms RPE(20 ms)', 'rms RPE(20 ms)']
    """
    return tuple(_parsed(entry) for entry in tables["requirement"])


def take_limits(content: dict[str, Any], file: ParameterFile) -> dict[str, float]:
    """Take the limits out of the ``[weights]`` of an older file.

    Raises
    ------
    ValueError
        One of them is no positive number.
    """
    table = content.get("weights")
    if not isinstance(table, dict):
        return {}
    limits = {key: table[key] for key in LIMITS if key in table}
    with file.refusals("weights"):
        LimitsTable.check_given(limits)
    content["weights"] = {key: value for key, value in table.items() if key not in limits}
    return {key: float(value) for key, value in limits.items()}


def with_limits(
    content: dict[str, Any], stated: Mapping[str, Any], figures: Mapping[str, float], file: ParameterFile
) -> dict[str, Any]:
    """The merged content of a file with its requirements checked and the limits in ``weights``.

    Parameters
    ----------
    content : dict
        Merged with the reference.
    stated : mapping
        Of the file alone.
    figures : mapping
        What `take_limits` found.
    file : ParameterFile
        For the messages.

    Raises
    ------
    ValueError
        A requirement that cannot be read, names an unknown stage or has the name of another one; none that a limit can
        be made of; a limit that contradicts a requirement of the same file.
    """
    names = [entry["name"] for entry in stated.get("requirement", ())]
    requirements = []
    for entry in content["requirement"]:
        key = f"requirement[{names.index(entry['name'])}]" if entry["name"] in names else "requirement"
        try:
            requirements.append(_parsed(entry))
        except InputError as error:
            raise file.error(f"{key}.text", f"must be a requirement: {error}") from None
        for loop in requirements[-1].loops:
            if loop not in STAGES:
                raise file.error(f"{key}.loop", f"must be among {', '.join(STAGES)}, got {loop!r}")
    for i, name in enumerate(names):
        if name in names[:i]:
            raise file.error(f"requirement[{i}].name", f"must be given once, got {name!r} twice")
    try:
        limits, defining = design_limits(requirements)
    except ValueError as error:
        raise file.error("requirement", str(error)) from None
    for key, value in figures.items():
        for i in defining[key]:
            requirement = requirements[i]
            changed = replace(requirement, times=(value,)) if key == "rpe_window" else replace(requirement, limit=value)
            same = np.allclose([requirement.limit, *requirement.times], [changed.limit, *changed.times], 1e-6, 0.0)
            if requirement.name in names and not same:
                raise file.error(
                    f"weights.{key}",
                    f"must agree with the requirement {requirement.name!r}, {requirement.exact_text}, got {value:g}",
                )
            requirements[i] = changed
    return {**content, "requirement": entries(requirements), "weights": {**content["weights"], **limits, **figures}}


def design_limits(requirements: Sequence[Requirement]) -> tuple[dict[str, float], dict[str, list[int]]]:
    """Value of each of `LIMITS` (SI units), and the places of the requirements that it is made of.

    Raises
    ------
    ValueError
        There is none that it can be made of.
    """
    ape = _absolute(requirements)
    mirror = MIRROR_STAGES[0]
    fine, means = _finest(requirements)
    if ape is None or fine is None:
        raise InputError(f"must hold one on |APE| and one on rms RPE for the stages {' and '.join(MIRROR_STAGES)}")
    window = requirements[fine].times[0]
    rpe = _strictest(
        requirements,
        lambda r: r.index == "RPE" and r.of_windows == means and _holds(r, mirror) and r.times[0] == window,
    )
    if rpe is None:
        raise InputError(f"must hold one on the RPE of {1e3 * window:g} ms for the stage {mirror}")
    made = {"ape_limit": [ape], "rpe_limit": [rpe], "rpe_limit_fine": [fine], "rpe_window": sorted({rpe, fine})}
    values = {key: requirements[made[key][0]].limit for key in LIMITS[:3]}
    return {**values, "rpe_window": window}, made


def unseen_by_design(requirements: Sequence[Requirement]) -> tuple[Requirement, ...]:
    """Requirements that no limit of a design is made of: runs are judged by them.

    Examples
    --------
    >>> from titop_plant.telescope.load import load_telescope
    >>> unseen_by_design(load_telescope().requirements)
    ()
    """
    seen = {i for places in design_limits(requirements)[1].values() for i in places}
    return tuple(one for i, one in enumerate(requirements) if i not in seen)


def window_length(requirements: Sequence[Requirement]) -> float:
    """``rpe_window`` [s], by which the loop is weighted; NaN without a requirement that it is made of.

    Examples
    --------
    >>> from titop_plant.telescope.load import load_telescope
    >>> window_length(load_telescope().requirements)
    0.02
    """
    fine, _ = _finest(requirements)
    return math.nan if fine is None else requirements[fine].times[0]


def window_probability(requirements: Sequence[Requirement]) -> float:
    """Part of the windows that must keep ``rpe_limit_fine``: of the requirement that it is made of; NaN without one.

    Examples
    --------
    >>> from titop_plant.telescope.load import load_telescope
    >>> window_probability(load_telescope().requirements)
    0.997
    """
    fine, _ = _finest(requirements)
    return math.nan if fine is None else requirements[fine].probability


def instant_probability(requirements: Sequence[Requirement]) -> float:
    """Part of the instants that must keep ``ape_limit``: of the requirement that it is made of; NaN without one.

    Examples
    --------
    >>> from titop_plant.telescope.load import load_telescope
    >>> instant_probability(load_telescope().requirements)
    0.997
    """
    index = _absolute(requirements)
    return math.nan if index is None else requirements[index].probability


def _absolute(requirements: Sequence[Requirement]) -> int | None:
    """Place of the requirement that ``ape_limit`` is made of."""
    return _strictest(requirements, lambda r: r.index == "APE" and all(_holds(r, loop) for loop in MIRROR_STAGES))


def _finest(requirements: Sequence[Requirement]) -> tuple[int | None, bool]:
    """Place of the requirement that ``rpe_limit_fine`` is made of; whether those on windows count, or on instants."""
    means = any(r.index == "RPE" and r.of_windows and not r.axis for r in requirements)
    forces = MIRROR_STAGES[1]
    return _strictest(requirements, lambda r: r.index == "RPE" and r.of_windows == means and _holds(r, forces)), means


def _parsed(entry: Mapping[str, Any]) -> Requirement:
    loop = entry.get("loop", ())
    return parse(entry["text"], entry["name"], (loop,) if isinstance(loop, str) else loop)


def _holds(requirement: Requirement, loop: str) -> bool:
    return not requirement.loops or loop in requirement.loops


def _strictest(requirements: Sequence[Requirement], wanted: Any) -> int | None:
    """Place of the smallest limit, both axes together, of the requirements that are wanted."""
    places = [i for i, r in enumerate(requirements) if not r.axis and wanted(r)]
    return min(places, key=lambda i: requirements[i].limit, default=None)
