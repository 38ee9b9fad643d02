"""Small plants of the literature for static output feedback and fixed-order H-infinity design.

Matrices and the best published H-infinity norm of static output feedback are in ``published_plants.json``, with their
sources. All plants have ``x' = A x + B1 w + B u, z = C1 x + D11 w + D12 u, y = C x + D21 w``; ports are w, u -> z, y.

Examples
--------
>>> plant = PLANTS["AC4"]()
>>> plant.order, [port.name for port in plant.inputs], BEST_KNOWN["AC4"]
(4, ['w', 'u'], 0.9355)
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from lftkit.systems.ports import Port
from lftkit.systems.system import System

_DATA: dict[str, dict[str, Any]] = json.loads(
    Path(__file__).with_name("published_plants.json").read_text(encoding="utf-8")
)["plants"]


def published_plant(name: str) -> System:
    """One plant of the collection.

    Parameters
    ----------
    name : str
        Name in COMPleib, for example ``AC4``.

    Raises
    ------
    ValueError
        No plant has this name.
    """
    if name not in _DATA:
        raise InputError(f"name must be one of {', '.join(_DATA)}, got {name!r}")
    return CompleibPlant(**{field.name: _DATA[name][field.name] for field in fields(CompleibPlant)}).system(name)


@dataclass(frozen=True)
class CompleibPlant:
    """Matrices of a plant of COMPleib, in its notation and order.

    Parameters
    ----------
    A, B1, B, C1, C, D11, D12, D21 : array_like
        ``x' = A x + B1 w + B u, z = C1 x + D11 w + D12 u, y = C x + D21 w``.
    """

    A: ArrayLike
    B1: ArrayLike
    B: ArrayLike
    C1: ArrayLike
    C: ArrayLike
    D11: ArrayLike
    D12: ArrayLike
    D21: ArrayLike

    def system(self, name: str) -> System:
        """From w, u to z, y."""
        matrices: list[FloatArray] = [np.array(getattr(self, field.name), dtype=float) for field in fields(self)]
        A, B1, B, C1, C, D11, D12, D21 = matrices
        D = np.block([[D11, D12], [D21, np.zeros((len(C), B.shape[1]))]])
        inputs = Port("w", B1.shape[1]), Port("u", B.shape[1])
        outputs = Port("z", len(C1)), Port("y", len(C))
        return System(A, np.hstack([B1, B]), np.vstack([C1, C]), D, inputs, outputs, name)


PLANTS: dict[str, Callable[[], System]] = {name: partial(published_plant, name) for name in _DATA}
"""Plants by name."""

BEST_KNOWN: dict[str, float] = {name: entry["best_known_hinf"] for name, entry in _DATA.items()}
"""Best published H-infinity norm of the closed loop with static output feedback; 0 is an infimum."""
