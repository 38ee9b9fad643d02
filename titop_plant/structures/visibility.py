"""Observability of the modes of a body at its ports."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lftkit.arrays import FloatArray
from titop_plant.structures.modal_data import ModalData


def port_visibility(data: ModalData, names: Sequence[str] | None = None) -> FloatArray:
    """Magnitude of each mode at the ports of a body, relative to the largest one.

    The norm of ``[L_k, Phi_Ck ...]`` over all ports, rotations scaled by the radius of gyration about the
    parent; a mode with value 0 is uncontrollable and is removed from a minimal realisation.

    Parameters
    ----------
    data : ModalData
    names : sequence of str, optional
        Child ports taken into account. Default: all.

    Returns
    -------
    ndarray, shape (n,)
    """
    radius = np.sqrt(np.trace(data.mass_matrix[3:, 3:]) / data.mass)
    scale = np.r_[np.ones(3), radius * np.ones(3)]
    seen = [child for child in data.children if names is None or child.name in names]
    rows = [data.participation / scale / np.sqrt(data.mass)]
    rows += [child.shapes.T * scale * np.sqrt(data.mass) for child in seen]
    total = np.sqrt(np.sum(np.hstack(rows) ** 2, axis=1))
    return np.asarray(total / total.max())
