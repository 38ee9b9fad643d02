"""Sections of tubes, boxes and bars from a material and dimensions."""

from __future__ import annotations

from collections.abc import Mapping
from math import pi

from lftkit.errors import InputError
from titop_plant.structures.beam_element import Section


def tube(material: Mapping[str, float], diameter: float, thickness: float) -> Section:
    """Round tube.

    Parameters
    ----------
    material : mapping
        ``E``, ``G`` (Pa), ``density`` (kg/m3).
    diameter, thickness : float
        Outer diameter and wall, m; a wall of half the diameter is a solid bar.

    Raises
    ------
    ValueError
        Wall thickness not in (0, diameter / 2].

    Examples
    --------
    >>> round(tube({"E": 70e9, "G": 27e9, "density": 2700.0}, 2.0, 1.0).A, 6)
    3.141593
    """
    if not 0 < 2 * thickness <= diameter:
        raise InputError(f"tube: thickness must be in (0, diameter / 2], got {thickness} of {diameter} m")
    inner = diameter - 2 * thickness
    bending = pi / 64 * (diameter**4 - inner**4)
    area = pi / 4 * (diameter**2 - inner**2)
    return Section(**material, A=area, Iy=bending, Iz=bending, J=2 * bending)


def box(material: Mapping[str, float], height: float, width: float, thickness: float) -> Section:
    """Thin-walled rectangular tube; ``height`` lies along the beam's local y (its ``up`` side).

    The torsion constant is Bredt's, ``4 Am^2 t / perimeter`` of the mid-line.

    Raises
    ------
    ValueError
        Wall thickness not in (0, smaller side / 2).
    """
    if not 0 < 2 * thickness < min(height, width):
        raise InputError(f"box: thickness must be in (0, side / 2), got {thickness} of {height} and {width} m")
    h, w = height - 2 * thickness, width - 2 * thickness
    middle = (height - thickness) * (width - thickness)
    around = 2 * ((height - thickness) + (width - thickness))
    return Section(
        **material,
        A=height * width - h * w,
        Iy=(height * width**3 - h * w**3) / 12,
        Iz=(width * height**3 - w * h**3) / 12,
        J=4 * middle**2 * thickness / around,
    )


def bar(material: Mapping[str, float], height: float, width: float) -> Section:
    """Solid rectangle; ``height`` lies along the beam's local y.

    Torsion constant by Roark, *Formulas for Stress and Strain*, table of torsion, solid rectangle.

    Raises
    ------
    ValueError
        A side is not positive.
    """
    if min(height, width) <= 0:
        raise InputError(f"bar: sides must be positive, got {height} and {width} m")
    a, b = max(height, width), min(height, width)
    torsion = a * b**3 * (1 / 3 - 0.21 * b / a * (1 - b**4 / (12 * a**4)))
    return Section(**material, A=height * width, Iy=height * width**3 / 12, Iz=width * height**3 / 12, J=torsion)
