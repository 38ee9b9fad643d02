"""Types of arrays of this package.

The same names stand in `lftkit.arrays`. They are stated again here because this package imports no other package of
the project: it evaluates recordings of any loop and is used without the models.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
"""Real numbers."""
ComplexArray = NDArray[np.complex128]
"""Complex numbers: spectra, amplitudes with phase."""
IntArray = NDArray[np.int64]
"""Indices, counts, stamps [ns]."""
BoolArray = NDArray[np.bool_]
"""Choices, one per element."""
