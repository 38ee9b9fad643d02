"""Static displacement of a clamped frame of beams, from its stiffness matrix alone."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg

from lftkit.arrays import FloatArray
from titop_plant.structures.beam_frame import BeamFrame, assemble


def static_displacement(frame: BeamFrame, parent: str, loads: Mapping[str, ArrayLike]) -> dict[str, FloatArray]:
    """Translation [m] and rotation [rad] of every node, clamped at `parent`, under wrenches (6,) [N, N m] at nodes."""
    names, _, K = assemble(frame)
    force = np.zeros(K.shape[0])
    for node, wrench in loads.items():
        force[6 * names.index(node) : 6 * names.index(node) + 6] += np.asarray(wrench, dtype=float)
    clamped = 6 * names.index(parent)
    free = np.delete(np.arange(K.shape[0]), np.arange(clamped, clamped + 6))
    displacement = np.zeros(K.shape[0])
    displacement[free] = linalg.solve(K[np.ix_(free, free)], force[free], assume_a="pos")
    return {name: displacement[6 * i : 6 * i + 6] for i, name in enumerate(names)}
