"""What a norm is taken of: a system, or its four matrices and their period."""

from __future__ import annotations

from typing import Any

from numpy.typing import ArrayLike

from lftkit.errors import InputError
from lftkit.systems.exchange import as_system

Given = tuple[ArrayLike, ArrayLike, ArrayLike, ArrayLike]


def given_system(
    A: Any, B: ArrayLike | None, C: ArrayLike | None, D: ArrayLike | None, dt: float | None
) -> tuple[Given, float | None]:
    """Matrices and period, of a system in place of A too.

    Parameters
    ----------
    A : array_like, or what :func:`lftkit.as_system` takes
        A certain system stands for all four matrices.
    B, C, D : array_like or None
    dt : float or None
        Not beside a system, which has its own.

    Raises
    ------
    ValueError
        Some of the matrices only, a system beside another period, an uncertain system.
    """
    if B is not None and C is not None and D is not None:
        return (A, B, C, D), dt
    if not (B is None and C is None and D is None):
        missing = [name for name, matrix in zip("BCD", (B, C, D)) if matrix is None]
        raise InputError(f"matrices must be A, B, C and D, or one system, got no {' and no '.join(missing)}")
    system = as_system(A)
    if dt is not None and dt != system.dt:
        raise InputError(f"dt must be that of the system, {system.dt:g} s, got {dt:g} s")
    return system.matrices, system.dt or None
