"""Units of a NASTRAN deck: ``PARAM,UNITSYS``, ``PARAM,WTMASS``, or what the user states.

NASTRAN has no units. Without a statement a deck is taken as SI only if its materials are those of a structure in SI.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np

from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from titop_plant.nastran.deck import Deck, number_of, parameters_of

FOOT, INCH, POUND_FORCE, POUND = 0.3048, 0.0254, 4.4482216152605, 0.45359237
STRUCTURAL = (1e9, 2e12)
"""Young's moduli between those of plastics and above that of diamond, Pa: one material of a deck in SI is there."""

SOLID = (1e6, 1e13)
"""Young's moduli from rubber to above any solid, Pa: one material of a deck in stated units is there."""
DENSITIES = (10.0, 5e4)
"""Densities from foam to above any metal, kg/m3; a body by mistake in another unit of mass has none there."""
MASSLESS = 1e-3
"""Largest density, kg/m3, of parts that shall have no mass."""
SAME = 1e-3
"""Relative difference of factors that is their rounding: 0.00259 is one over 386.1 in/s2."""


@dataclass(frozen=True)
class DeckUnits:
    """Units of a deck; the second is that of all of them.

    Attributes
    ----------
    length : of one unit [m]
    mass : of the consistent unit, force by length per s2 [kg]
    weight : ``PARAM,WTMASS``: consistent units of mass in one unit in which the deck states masses

    Raises
    ------
    ValueError
        A factor that is not positive and finite.

    Examples
    --------
    Millimetres, kilograms and millinewtons; a deck in mm, N and tonnes is ``DeckUnits(1e-3, 1e3)``:

    >>> DeckUnits(1e-3, 1.0).matrix_scale().tolist()[0]
    [1.0, 1.0, 1.0, 0.001, 0.001, 0.001]
    """

    length: float = 1.0
    mass: float = 1.0
    weight: float = 1.0

    def __post_init__(self) -> None:
        for name in ("length", "mass", "weight"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise InputError(f"units: {name} must be positive, got {value}")

    def by_axis(self) -> FloatArray:
        """Factors of a motion with mass-normalised modes, shape (6,): 1 for translation, the length for rotation."""
        return np.repeat(np.array([1.0, self.length]), 3)

    def matrix_scale(self) -> FloatArray:
        """Factors of a mass matrix from consistent units to kg, kg m and kg m2, shape (6, 6)."""
        return np.asarray(self.mass * np.outer(self.by_axis(), self.by_axis()), dtype=float)


UNIT_SYSTEMS: Mapping[str, DeckUnits] = MappingProxyType(
    {
        "N-M": DeckUnits(),
        "MN-MM": DeckUnits(1e-3, 1.0),  # the force in millinewton, the mass in kg
        "CN-CM": DeckUnits(1e-2, 1.0),
        "N-MM": DeckUnits(1e-3, 1e3),
        "LBF-IN": DeckUnits(INCH, POUND_FORCE / INCH),
        "LBF-FT": DeckUnits(FOOT, POUND_FORCE / FOOT),
        "PDL-FT": DeckUnits(FOOT, POUND),
    }
)
"""Units by PARAM,UNITSYS, which Simcenter writes: force and length (Siemens KB000073658, "MN-MM" is mN, mm, kg)."""

STATED_SYSTEMS: Mapping[str, DeckUnits] = MappingProxyType(
    {
        "SI": UNIT_SYSTEMS["N-M"],
        "mm-t-s": UNIT_SYSTEMS["N-MM"],
        "mm-kg-s": UNIT_SYSTEMS["MN-MM"],
        "inch-lbf-s": UNIT_SYSTEMS["LBF-IN"],
        "ft-lbf-s": UNIT_SYSTEMS["LBF-FT"],
    }
)
"""Names for the option `units` beside those of `UNIT_SYSTEMS`; the mass unit of inch-lbf-s is lbf s2/inch."""

Units: TypeAlias = str | DeckUnits | tuple[float, float] | None
"""A name of `STATED_SYSTEMS` or `UNIT_SYSTEMS`, or factors: length [m] and consistent mass [kg]."""


def units_of(deck: Deck, model: Any, path: Path, stated: Units = None) -> DeckUnits:
    """Units of a deck by the user's statement or ``PARAM,UNITSYS``, with ``PARAM,WTMASS``; SI without both.

    Raises
    ------
    ValueError
        A unit system that is not known, two that contradict each other, ``PARAM,WTMASS`` that is no positive number
        or without a unit system, or units in which the materials are none of a structure.
    """
    parameters = parameters_of(deck, model, path)
    weight = number_of(parameters.get("WTMASS", "1.0"))
    if not (np.isfinite(weight) and weight > 0):
        raise InputError(f"{path}: PARAM,WTMASS must be a positive number, got {parameters['WTMASS']}")
    system = parameters.get("UNITSYS", "").upper().strip()
    if system and system not in UNIT_SYSTEMS:
        raise InputError(f"{path}: PARAM,UNITSYS must be one of {', '.join(UNIT_SYSTEMS)}, got {system}")
    if stated is not None:
        deck_units = _stated(stated)
        if system and not np.allclose(
            (deck_units.length, deck_units.mass), (UNIT_SYSTEMS[system].length, UNIT_SYSTEMS[system].mass), rtol=SAME
        ):
            raise InputError(f"{path}: units must be those of PARAM,UNITSYS,{system} in the deck, got {stated}")
        if deck_units.weight != 1.0 != weight and abs(deck_units.weight / weight - 1.0) > SAME:
            raise InputError(
                f"{path}: units must have the weight of PARAM,WTMASS, {weight:g}, got {deck_units.weight:g}"
            )
        deck_units = deck_units if deck_units.weight != 1.0 else replace(deck_units, weight=weight)
    elif system:
        deck_units = replace(UNIT_SYSTEMS[system], weight=weight)
    elif weight != 1.0:
        raise InputError(
            f"{path}: units must be given with PARAM,WTMASS,{weight:g}, as units='inch-lbf-s' "
            f"(one of {', '.join([*STATED_SYSTEMS, *UNIT_SYSTEMS])}), got none"
        )
    else:
        _check_materials(model, path, UNIT_SYSTEMS["N-M"], None)
        return UNIT_SYSTEMS["N-M"]
    named = f"{stated}" if stated is not None else f"PARAM,UNITSYS,{system}"
    _check_materials(model, path, deck_units, named)
    _check_densities(model, path, deck_units, named)
    return deck_units


def _stated(stated: str | DeckUnits | tuple[float, float]) -> DeckUnits:
    if isinstance(stated, DeckUnits):
        return stated
    if isinstance(stated, str):
        known = {name.upper(): one for name, one in {**STATED_SYSTEMS, **UNIT_SYSTEMS}.items()}
        if stated.upper() not in known:
            raise InputError(f"units must be one of {', '.join([*STATED_SYSTEMS, *UNIT_SYSTEMS])}, got {stated}")
        return known[stated.upper()]
    try:
        length, mass = (float(factor) for factor in stated)
    except (TypeError, ValueError):
        raise InputError(f"units must be a name, or two factors (length [m], mass [kg]), got {stated!r}") from None
    return DeckUnits(length, mass)


def _check_materials(model: Any, path: Path, units: DeckUnits, stated: str | None) -> None:
    """Refuse units in which no material of the deck is that of a structure, or of any solid where they are stated."""
    moduli = []
    for material in model.materials.values():
        values = [getattr(material, key, None) for key in ("e", "e11", "e22", "G11")]
        moduli += [float(value) for value in values if isinstance(value, (int, float)) and value > 0]
    pascal = units.mass / units.length
    least, largest = STRUCTURAL if stated is None else SOLID
    if not moduli or any(least <= modulus * pascal <= largest for modulus in moduli):
        return
    if stated is None:
        raise InputError(
            f"{path}: units must be given (units='mm-t-s', 'inch-lbf-s', ..., or PARAM,UNITSYS), got none, and "
            f"E = {max(moduli):.3g} of the stiffest material is that of no structure in SI"
        )
    raise InputError(
        f"{path}: units must be those of the deck, got {stated}, in which the stiffest material has "
        f"E = {max(moduli) * pascal:.3g} Pa"
    )


def _check_densities(model: Any, path: Path, units: DeckUnits, stated: str) -> None:
    """Refuse stated units in which every material is lighter than foam or heavier than any metal."""
    scale = units.mass * units.weight / units.length**3
    values = [getattr(material, "rho", None) for material in model.materials.values()]
    densities = [scale * float(value) for value in values if isinstance(value, (int, float))]
    densities = [density for density in densities if density > MASSLESS]
    if densities and not any(DENSITIES[0] <= density <= DENSITIES[1] for density in densities):
        raise InputError(
            f"{path}: units must be those of the deck, got {stated}, in which the densest material has "
            f"{max(densities):.3g} kg/m3"
        )
