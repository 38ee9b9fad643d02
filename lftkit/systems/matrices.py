"""The four matrices of a linear system: checks of shapes and numbers (numpy only)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from lftkit.arrays import FloatArray, Matrices
from lftkit.errors import InputError
from lftkit.systems.ports import read_only


def checked_matrices(
    A: ArrayLike, B: ArrayLike, C: ArrayLike, D: ArrayLike, inputs: int | None = None, outputs: int | None = None
) -> Matrices:
    """Read-only float copies of the four matrices after a check of shapes and finiteness.

    Parameters
    ----------
    A, B, C, D : array_like
        Shapes (n, n), (n, m), (p, n), (p, m). A matrix without entries may have any shape where it fits.
    inputs, outputs : int, optional
        m and p; those of D otherwise.

    Raises
    ------
    ValueError
        Wrong shape or an entry that is not finite; the message names the matrix, its required and its actual shape.
    """
    arrays = {key: real_array(f"matrix {key}", value) for key, value in zip("ABCD", (A, B, C, D))}
    d = np.atleast_2d(arrays["D"])
    m = d.shape[1] if inputs is None else inputs
    p = d.shape[0] if outputs is None else outputs
    n = arrays["A"].shape[0] if arrays["A"].size and arrays["A"].ndim else 0
    shapes = {"A": (n, n), "B": (n, m), "C": (p, n), "D": (p, m)}
    for key, shape in shapes.items():
        matrix = arrays[key]
        if matrix.size == 0 and 0 in shape:
            matrix = np.zeros(shape)
        matrix = np.atleast_2d(matrix)
        if matrix.shape != shape:
            raise InputError(
                f"matrix {key} must be {shape[0]} x {shape[1]} to fit states and ports, "
                f"got {' x '.join(map(str, matrix.shape))}"
            )
        if not np.all(np.isfinite(matrix)):
            row, column = np.argwhere(~np.isfinite(matrix))[0]
            raise InputError(f"matrix {key} must be finite, got {matrix[row, column]} in entry [{row}, {column}]")
        arrays[key] = read_only(matrix)
    return arrays["A"], arrays["B"], arrays["C"], arrays["D"]


def frequencies(omega: ArrayLike) -> FloatArray:
    """Frequencies (N,) [rad/s] from one or several real numbers; a ValueError where one is not finite."""
    got = ""
    try:
        grid = np.atleast_1d(np.asarray(omega, dtype=float))
    except (TypeError, ValueError):
        grid, got = np.zeros(0), type(omega).__name__
    if grid.ndim != 1:
        got = f"shape {grid.shape}"
    elif not np.all(np.isfinite(grid)):
        got = f"{grid[~np.isfinite(grid)][0]}"
    if got:
        raise InputError(f"omega must be a vector of finite numbers, got {got}")
    return grid


def real_array(what: str, value: ArrayLike) -> FloatArray:
    """`value` as an array of floats; a ValueError that begins with `what` where it holds anything but real numbers."""
    try:
        if np.iscomplexobj(value) or np.asarray(value).dtype.kind in "US":
            raise TypeError
        return np.asarray(value, dtype=float)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{what} must be a rectangular array of real numbers, got {type(value).__name__}") from None
