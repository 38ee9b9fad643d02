"""One function names laws, plants, nodes and proofs by their numbers."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

NONE: Mapping[str, NDArray[Any]] = MappingProxyType({})


def digest(content: Any, arrays: Mapping[str, NDArray[Any]] = NONE) -> str:
    """128 bits, as hexadecimal digits, of the SHA-256 of values as of JSON, and of arrays with their shapes.

    Parameters
    ----------
    content : mapping, sequence, number or text
        Numbers count with all their digits, mappings without their order.
    arrays : mapping of str to ndarray
        Real ones count in double precision, others in their own type.

    Examples
    --------
    >>> digest({"dt": 0.1, "name": "lag"}) == digest({"name": "lag", "dt": 0.1})
    True
    >>> len({digest("", {"A": np.eye(2)}), digest("", {"A": np.ones((2, 2))}), digest("", {"B": np.eye(2)})})
    3
    """
    key = hashlib.sha256(json.dumps(content, sort_keys=True).encode())
    for name, array in arrays.items():
        matrix = np.ascontiguousarray(array, dtype=complex if np.iscomplexobj(array) else np.float64)
        key.update(f"{name} {np.shape(array)}".encode() + matrix.tobytes())
    return key.hexdigest()[:32]


def plant_digest(
    dt: float,
    channels: Sequence[str],
    nominal: Mapping[str, float],
    sizes: Mapping[str, Sequence[int]],
    matrices: Sequence[NDArray[Any]],
) -> str:
    """Digest of an uncertain plant, by which a check says what its proof is about.

    Parameters
    ----------
    dt : float
        Sampling period [s], 0 for continuous time.
    channels : sequence of str
        Name of the element of each channel.
    nominal : mapping of str to float
        Nominal values of the real parameters.
    sizes : mapping of str to (int, int)
        Outputs and inputs of complex numbers, which have one each, and of dynamics.
    matrices : sequence of ndarray
        A, B, C and D, the channels first.
    """
    content = {"dt": dt, "channels": [*channels], "nominal": {**nominal}, "sizes": {k: [*v] for k, v in sizes.items()}}
    return digest(content, dict(zip("ABCD", matrices)))
