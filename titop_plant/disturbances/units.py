"""Units in the headers of files of disturbances: what one of them is in SI units.

A header without a unit has that of the kind: N and Nm, of a spectral density N^2/Hz and (Nm)^2/Hz, of the harmonics of
a wheel N s^2/rad^2 and Nm s^2/rad^2. A unit of another quantity is refused: a force is no spectral density.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

_MARKS = re.compile(r"[\s.*·^()]")


@dataclass(frozen=True)
class Units:
    """Units of one quantity.

    Attributes
    ----------
    expected : in words, for messages
    scales : factor to SI units of each spelling, in small letters and without marks of powers and products
    """

    expected: str
    scales: Mapping[str, float]

    def scale(self, unit: str) -> float | None:
        """Factor to SI units; None for a unit of another quantity.

        Examples
        --------
        >>> DENSITY.force.scale("mN²/Hz"), DENSITY.torque.scale("(N m)^2/Hz"), DENSITY.force.scale("N")
        (1e-06, 1.0, None)
        >>> FORCE.torque.scale("mNm"), FORCE.force.scale("Nm"), FORCE.torque.scale("N")
        (0.001, None, None)
        """
        if unit.startswith(("M", "mH")):  # mega and millihertz have the same small letters as milli and megahertz
            return None
        return self.scales.get(_MARKS.sub("", unit.replace("²", "2")).lower())


def _units(expected: str, *groups: tuple[float, str]) -> Units:
    scales = {name: scale for scale, names in groups for name in names.split()}
    return Units(expected, MappingProxyType({"": 1.0, **scales}))


@dataclass(frozen=True)
class WrenchUnits:
    """Units of the three forces and of the three torques of a quantity: a force is no torque."""

    force: Units
    torque: Units

    def of_axis(self, axis: int) -> Units:
        """Units of one of the six axes, forces first."""
        return self.force if axis < 3 else self.torque

    def knows(self, unit: str) -> bool:
        """Whether it is one of these."""
        return bool(unit) and any(each.scale(unit) is not None for each in (self.force, self.torque))


FORCE = WrenchUnits(
    _units("N or mN", (1.0, "n"), (1e-3, "mn")),
    _units("Nm or mNm", (1.0, "nm"), (1e-3, "mnm")),
)
DENSITY = WrenchUnits(
    _units("N^2/Hz or mN^2/Hz", (1.0, "n2/hz"), (1e-6, "mn2/hz")),
    _units("Nm^2/Hz or mNm^2/Hz", (1.0, "nm2/hz n2m2/hz"), (1e-6, "mnm2/hz mn2m2/hz")),
)
_RPM = (30 / math.pi) ** 2
PER_SPEED_SQUARED = WrenchUnits(
    _units(
        "N s^2/rad^2 or N/rpm^2 (squared = false for N)",
        (1.0, "ns2 ns2/rad2"),
        (1e-3, "mns2 mns2/rad2"),
        (_RPM, "n/rpm2"),
        (1e-3 * _RPM, "mn/rpm2"),
    ),
    _units(
        "Nm s^2/rad^2 or Nm/rpm^2 (squared = false for Nm)",
        (1.0, "nms2 nms2/rad2"),
        (1e-3, "mnms2 mnms2/rad2"),
        (_RPM, "nm/rpm2"),
        (1e-3 * _RPM, "mnm/rpm2"),
    ),
)
FREQUENCY = _units("Hz, kHz or rad/s", (1.0, "hz"), (1e3, "khz"), (0.5 / math.pi, "rad/s"))
ORDER = _units("none: multiples of the speed", (1.0, "- 1"))
