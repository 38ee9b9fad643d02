"""Further uncertain parameters of a telescope: the table ``[uncertain]`` of a file, and what a command adds to it.

Each entry is a factor about 1 of what it names, with a half-width::

    [uncertain]
    isolator.stiffness = 0.10     # all six stiffnesses of the isolator, 10 % less to 10 % more
    camera_los.gain = 0.05

========================  ============================================================================================
entry                     what it multiplies
========================  ============================================================================================
``isolator.stiffness``    the six stiffnesses of the isolator, together
``isolator.damping``      its six dampings, together
``fsm_command.gain``      commands as the mirror carries them out
``pma_force.gain``        forces of the proof-mass actuators, together
``<measured>.gain``       a measured port: ``accel_Ip``, ``accel_M1``, ``accel_M2``, ``camera_los``, ``fsm_angle``
========================  ============================================================================================

They are channels of the telescope's Delta behind those that are always there, for everything that uses them: searches,
designs, verification and proofs. A run has the nominal factors.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Any

from lftkit.uncertainty.parameters import RealParameter
from titop_plant.interface import COMMANDED, MEASURED
from titop_plant.telescope.tables.parameter_check import ParameterFile

UNCERTAIN = "uncertain"
"""Name of the table."""
STIFFNESS, DAMPING = "isolator.stiffness", "isolator.damping"
GAIN = "gain"
ENTRIES = (STIFFNESS, DAMPING, *(f"{name}.{GAIN}" for name in (*COMMANDED, *MEASURED)))
"""What can be uncertain, in the order of Delta."""
LARGEST = 0.9
"""Half-width of a factor: none may be zero."""


def spread_of(text: str) -> tuple[str, float]:
    """Entry and half-width of a text as ``isolator.stiffness=10%`` or ``isolator.stiffness=0.1``.

    Raises
    ------
    ValueError
        Another form, an unknown entry, a half-width out of its range.

    Examples
    --------
    >>> spread_of("isolator.stiffness=10%")
    ('isolator.stiffness', 0.1)
    """
    name, _, value = (part.strip() for part in text.partition("="))
    try:
        spread = float(value.removesuffix("%")) * (0.01 if value.endswith("%") else 1.0)
    except ValueError:
        raise ValueError(f"uncertain must be ENTRY=SPREAD, e.g. {STIFFNESS}=10%, got {text!r}") from None
    return checked(name, spread), spread


def checked(name: str, spread: Any) -> str:
    """The name of an entry.

    Raises
    ------
    ValueError
        An unknown entry, a half-width out of its range.
    """
    if name not in ENTRIES:
        raise ValueError(f"uncertain must name one of {', '.join(ENTRIES)}, got {name!r}")
    if isinstance(spread, bool) or not isinstance(spread, (int, float)) or not 0.0 < spread <= LARGEST:
        raise ValueError(f"uncertain {name} must be above 0 and at most {LARGEST:g}, got {spread!r}")
    return name


def checked_spreads(table: Any, file: ParameterFile) -> dict[str, float]:
    """Half-widths by entry, of a table of a file.

    Raises
    ------
    ValueError
        Not a table, an unknown entry, a half-width out of its range; the message names the file.
    """
    if not isinstance(table, dict):
        raise file.error(UNCERTAIN, f"must be a table, got {table!r}")
    nested = ((key, value if isinstance(value, dict) else {"": value}) for key, value in table.items())
    flat = {f"{key}.{inner}" if inner else key: spread for key, values in nested for inner, spread in values.items()}
    try:
        return {checked(name, spread): float(spread) for name, spread in flat.items()}
    except ValueError as error:
        raise file.error(UNCERTAIN, f"is not valid: {error}") from None


def with_uncertain(parameters: Mapping[str, Any], spreads: Iterable[str]) -> Mapping[str, Any]:
    """Parameters of a telescope with further uncertain entries, each as for :func:`spread_of`; a later one wins."""
    table = {**parameters.get(UNCERTAIN, {}), **dict(map(spread_of, spreads))}
    return MappingProxyType({**parameters, UNCERTAIN: table}) if table else parameters


def factors(parameters: Mapping[str, Any]) -> dict[str, RealParameter]:
    """The uncertain factors of a telescope by entry, in the order of Delta."""
    spreads = parameters.get(UNCERTAIN, {})
    return {
        name: RealParameter(name, 1.0, 1.0 - spreads[name], 1.0 + spreads[name], "1", f"factor of {name}")
        for name in ENTRIES
        if name in spreads
    }
