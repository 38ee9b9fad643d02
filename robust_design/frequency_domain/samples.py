"""Responses of a plant at pairs of a frequency and a parameter point."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
IntArray = NDArray[np.intp]


@dataclass(frozen=True)
class PlantSamples:
    """N responses of a plant with its controller taken away.

    Parameters
    ----------
    omega : ndarray, shape (N,)
        Frequencies [rad/s].
    response : ndarray, complex, shape (N, measurements + errors, disturbances + commands)
        Rows: measurements, then errors. Columns: disturbances, then commands.
    measurements, commands : int

    Raises
    ------
    ValueError
        Sizes that do not agree, or a response that is not finite.
    """

    omega: FloatArray
    response: ComplexArray
    measurements: int
    commands: int

    def __post_init__(self) -> None:
        if self.response.ndim != 3 or len(self.response) != len(self.omega):
            raise ValueError(
                f"response must have one matrix for each of {len(self.omega)} frequencies, got {self.response.shape}"
            )
        rows, columns = self.response.shape[1:]
        if not (0 < self.measurements < rows and 0 < self.commands < columns):
            raise ValueError(
                f"response must have more rows than {self.measurements} measurements and more columns than "
                f"{self.commands} commands, got {rows} x {columns}"
            )
        if not np.isfinite(self.response).all():
            at = float(self.omega[~np.isfinite(self.response).all(axis=(1, 2))][0])
            raise ValueError(f"response must be finite, got a value that is not at {at:.6g} rad/s")

    def __len__(self) -> int:
        return len(self.omega)

    @property
    def disturbances(self) -> int:
        """Number of disturbances."""
        return int(self.response.shape[2]) - self.commands

    def chosen(self, index: IntArray) -> PlantSamples:
        """The samples at `index`."""
        return PlantSamples(self.omega[index], self.response[index], self.measurements, self.commands)

    @classmethod
    def joined(cls, parts: Sequence[PlantSamples]) -> PlantSamples:
        """All samples of several sets of the same plant."""
        first = parts[0]
        return cls(
            np.concatenate([p.omega for p in parts]),
            np.concatenate([p.response for p in parts]),
            first.measurements,
            first.commands,
        )
