"""Types of arrays, for all packages that import lftkit (numpy only: what runs in the loop imports it too)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
"""Real numbers."""
ComplexArray = NDArray[np.complex128]
"""Complex numbers: responses, eigenvalues, amplitudes with phase."""
IntArray = NDArray[np.intp]
"""Indices and counts."""
BoolArray = NDArray[np.bool_]
"""Choices, one per element."""
Matrix = np.ndarray[tuple[int, int], np.dtype[np.float64]]
"""Real numbers with two axes: for functions whose types ask for it."""
Matrices = tuple[FloatArray, FloatArray, FloatArray, FloatArray]
"""A (n, n), B (n, m), C (p, n), D (p, m) of a linear system."""
