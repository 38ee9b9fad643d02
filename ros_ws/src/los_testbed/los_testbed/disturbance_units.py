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
        >>> DENSITY.scale("mN²/Hz"), DENSITY.scale("(N m)^2/Hz"), DENSITY.scale("N"), FORCE.scale("mNm")
        (1e-06, 1.0, None, 0.001)
        """
        if unit.startswith(("M", "mH")):  # mega and millihertz have the same small letters as milli and megahertz
            return None
        return self.scales.get(_MARKS.sub("", unit.replace("²", "2")).lower())


def _units(expected: str, *groups: tuple[float, str]) -> Units:
    found = {name: scale for scale, names in groups for name in names.split()}
    return Units(expected, MappingProxyType({"": 1.0, **found}))


FORCE = _units("N, mN, Nm or mNm", (1.0, "n nm"), (1e-3, "mn mnm"))
DENSITY = _units(
    "N^2/Hz, mN^2/Hz, Nm^2/Hz or mNm^2/Hz", (1.0, "n2/hz nm2/hz n2m2/hz"), (1e-6, "mn2/hz mnm2/hz mn2m2/hz")
)
PER_SPEED_SQUARED = _units(
    "N s^2/rad^2, Nm s^2/rad^2, N/rpm^2 or Nm/rpm^2 (squared = false takes N and Nm)",
    (1.0, "ns2 nms2 ns2/rad2 nms2/rad2"),
    (1e-3, "mns2 mnms2 mns2/rad2 mnms2/rad2"),
    ((30 / math.pi) ** 2, "n/rpm2 nm/rpm2"),
    (1e-3 * (30 / math.pi) ** 2, "mn/rpm2 mnm/rpm2"),
)
FREQUENCY = _units("Hz, kHz or rad/s", (1.0, "hz"), (1e3, "khz"), (0.5 / math.pi, "rad/s"))
