"""Further uncertain parameters of a telescope: the table ``[uncertain]`` of a file, and what a command adds to it.

Each entry is a factor about 1 of what it names, with a half-width::

    [uncertain]
    isolator.stiffness = 0.10     # all six stiffnesses of the isolator, 10 % less to 10 % more
    camera_los.gain = 0.05
    payload.frequency_1 = { spread = 0.03, role = "operating" }

The role says how the value differs among members: a `CONSTANT` is one number of a spacecraft, which measurements can
tell better; an `OPERATING` parameter is driven through its range, as the speeds of wheels and the angle of arrays are.

========================  ============================================================================================
entry                     what it multiplies
========================  ============================================================================================
``isolator.stiffness``    the six stiffnesses of the isolator, together
``isolator.damping``      its six dampings, together
``fsm_command.gain``      commands as the mirror carries them out
``pma_force.gain``        forces of the proof-mass actuators, together
``<measured>.gain``       a measured port: ``accel_Ip``, ``accel_M1``, ``accel_M2``, ``camera_los``, ``fsm_angle``
``fsm.stiffness``         the stiffness of both joints of the mirror; torques by commands stay
``body.frequency_1``      clamped frequency of the central body's first mode, and so on
``body.frequency``        clamped frequencies of all its modes, together: one stiffness, or one mass
``body.damping_1``        damping ratio of that mode
``body.damping``          damping ratios of all its modes, together
``payload.*``, ``<p>.*``  the same of the payload, and of arrays and appendages with ``<p>`` before their parameters
========================  ============================================================================================

They are channels of the telescope's Delta behind those that are always there, for everything that uses them: searches,
designs, verification, proofs, and members of the family in runs.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from typing import Any

from lftkit.errors import InputError
from lftkit.uncertainty.elements import RealParameter
from pointing_analysis.files.settings import proposal
from titop_plant.interface import COMMANDED, MEASURED
from titop_plant.telescope.layout import MountedBody, read_appendages, read_arrays
from titop_plant.telescope.tables.parameter_check import ParameterFile

UNCERTAIN = "uncertain"
"""Name of the table."""
STIFFNESS, DAMPING, MIRROR = "isolator.stiffness", "isolator.damping", "fsm.stiffness"
GAIN = "gain"
ENTRIES = (STIFFNESS, DAMPING, *(f"{name}.{GAIN}" for name in (*COMMANDED, *MEASURED)), MIRROR)
"""Entries that can be uncertain, in the order of Delta; then those of `MODAL`."""
BODIES = ("body", "payload")
FREQUENCY_OF, DAMPING_OF = "frequency", "damping"
MODAL = re.compile(rf"([A-Za-z]\w*)\.({FREQUENCY_OF}|{DAMPING_OF})(?:_([1-9]\d*))?", re.ASCII)
"""Of modes of a body: its name, or that of its parameters, kind, number; without a number all of them."""
LARGEST = 0.9
"""Half-width of a factor: none may be zero."""
SPREAD, ROLE = "spread", "role"
"""Keys of an entry that is a table."""
CONSTANT, OPERATING = ROLES = ("constant", "operating")
"""Roles of parameters."""
Entry = float | dict[str, Any]
"""Half-width of a constant factor, or a table."""


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
        raise InputError(f"uncertain must be ENTRY=SPREAD, e.g. {STIFFNESS}=10%, got {text!r}") from None
    return checked(name, spread), spread


def is_factor(name: str) -> bool:
    """Whether an uncertain parameter is a factor of this table."""
    return name in ENTRIES or MODAL.fullmatch(name) is not None


def checked(name: str, spread: Any) -> str:
    """The name of an entry.

    Raises
    ------
    ValueError
        An unknown entry, a half-width out of its range.
    """
    if not is_factor(name):
        modal = [f"{body}.{kind}{end}" for body in BODIES for kind in (FREQUENCY_OF, DAMPING_OF) for end in ("", "_1")]
        raise InputError(f"unknown entry {name!r} of uncertain{proposal(name, (*ENTRIES, *modal))}")
    if isinstance(spread, bool) or not isinstance(spread, (int, float)) or not 0.0 < spread <= LARGEST:
        raise InputError(f"uncertain {name} must be above 0 and at most {LARGEST:g}, got {spread!r}")
    return name


def spread_and_role(entry: Entry) -> tuple[float, str]:
    """Half-width and role of a checked entry."""
    return (entry[SPREAD], entry[ROLE]) if isinstance(entry, dict) else (entry, CONSTANT)


def _checked_entry(name: str, entry: Any) -> Entry:
    """An entry of a file: a number where the role is constant, as before there were roles."""
    table = entry if isinstance(entry, dict) else {SPREAD: entry}
    if not {SPREAD} <= set(table) <= {SPREAD, ROLE}:
        raise InputError(
            f"uncertain {name} must have {SPREAD} and may have {ROLE}, got {', '.join(table) or 'nothing'}"
        )
    spread, role = table[SPREAD], table.get(ROLE, CONSTANT)
    checked(name, spread)
    if role not in ROLES:
        raise InputError(f"uncertain {name} must have a {ROLE} that is one of {', '.join(ROLES)}, got {role!r}")
    return float(spread) if role == CONSTANT else {SPREAD: float(spread), ROLE: role}


def checked_entries(table: Any, file: ParameterFile, tables: Mapping[str, Any]) -> dict[str, Entry]:
    """Half-widths and roles by entry, of a table of a file with these other tables.

    Raises
    ------
    ValueError
        Not a table, an unknown entry or key, a half-width out of its range, a role or mode that is none; the message
        names the file.
    """
    if not isinstance(table, dict):
        raise file.error(UNCERTAIN, f"must be a table, got {table!r}")
    nested = (
        (key, value if isinstance(value, dict) and not is_factor(key) else {"": value}) for key, value in table.items()
    )
    flat = {f"{key}.{inner}" if inner else key: entry for key, values in nested for inner, entry in values.items()}
    try:
        require_modes(flat, tables)
        return {name: _checked_entry(name, entry) for name, entry in flat.items()}
    except ValueError as error:
        raise file.error(UNCERTAIN, f"is not valid: {error}") from None


def require_modes(spreads: Iterable[str], tables: Mapping[str, Any]) -> None:
    """Refuse entries of bodies and modes that are not on board, and factors of a value that another parameter has.

    Modes of a file of modal data are counted where it is read.
    """
    names = set(spreads)
    mounted = {one.parameters: one for one in (*read_arrays(tables), *read_appendages(tables))}
    for name in names - set(ENTRIES):
        body, kind, number = match.groups() if (match := MODAL.fullmatch(name)) else (BODIES[0], "", None)
        if body not in (*BODIES, *mounted):
            raise InputError(f"uncertain {name} must be of one of {', '.join((*BODIES, *mounted))}, got {body}")
        if number and f"{body}.{kind}" in names:
            raise InputError(f"uncertain {body}.{kind} has all modes: it must be given without {name}, got both")
        modes, uncertain = _counts(mounted[body]) if body in mounted else _counts_of_frame(tables[body])
        if number and int(number) > modes:
            raise InputError(f"uncertain {name} must be of one of the {modes:g} modes, got mode {number}")
        if kind == FREQUENCY_OF and int(number or 1) <= uncertain:
            omega = f"{body}.omega_{number or 1}"
            raise InputError(f"uncertain {name} must be of modes without a parameter of their own, got that of {omega}")


def _counts(body: MountedBody) -> tuple[float, float]:
    """Modes of a mounted body, infinite of one from a file, and those of them whose frequency is a parameter."""
    printed, count = (
        (0, math.inf) if body.modes is None else (len(body.modes.frequencies), len(body.modes.further_modes))
    )
    uncertain = body.uncertain_modes or (math.inf if body.modes is None else printed)
    return printed + count, uncertain if body.relative_uncertainty else 0


def _counts_of_frame(table: Mapping[str, Any]) -> tuple[float, float]:
    """The same of the central body or the payload."""
    return math.inf if table.get("modal_data") else table["modes"], 0


def factors(spreads: Mapping[str, float]) -> dict[str, RealParameter]:
    """The uncertain factors by entry, in the order of Delta, of half-widths by entry."""
    modal = [name for name in spreads if name not in ENTRIES]
    modal.sort(key=lambda name: (name.rstrip("0123456789"), len(name), name))
    return {
        name: RealParameter(name, 1.0, 1.0 - spreads[name], 1.0 + spreads[name], "1", f"factor of {name}")
        for name in (*ENTRIES, *modal)
        if name in spreads
    }


def factors_of_modes(parameters: Mapping[str, RealParameter], body: str, modes: int) -> Mapping[str, Any]:
    """Arguments of :func:`titop_plant.blocks.flexible_body.flexible_body` for a body with so many modes."""
    known = {name: factor for name, factor in parameters.items() if name.startswith(f"{body}.") and name not in ENTRIES}
    by_kind: dict[str, dict[int, RealParameter]] = {FREQUENCY_OF: {}, DAMPING_OF: {}}
    for name, factor in known.items():
        kind, _, number = name.removeprefix(f"{body}.").partition("_")
        by_kind[kind] |= dict.fromkeys([int(number) - 1] if number else range(modes), factor)
    return {"frequencies": by_kind[FREQUENCY_OF], "dampings": by_kind[DAMPING_OF], "relative": tuple(known)}
