"""Responses of a plant at pairs of a frequency and a parameter point."""

from __future__ import annotations

from dataclasses import InitVar, dataclass

import numpy as np

from lftkit.arrays import ComplexArray, FloatArray, IntArray
from lftkit.errors import InputError


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
    check : bool
        Look for sizes that do not agree and values that are not finite; left out for parts of checked samples.

    Raises
    ------
    ValueError
        Sizes that do not agree, or a response that is not finite.
    """

    omega: FloatArray
    response: ComplexArray
    measurements: int
    commands: int
    check: InitVar[bool] = True

    def __post_init__(self, check: bool) -> None:
        if not check:
            return
        if self.response.ndim != 3 or len(self.response) != len(self.omega):
            raise InputError(
                f"response must have one matrix for each of {len(self.omega)} frequencies, got {self.response.shape}"
            )
        rows, columns = self.response.shape[1:]
        if not (0 < self.measurements < rows and 0 < self.commands < columns):
            raise InputError(
                f"response must have more rows than {self.measurements} measurements and more columns than "
                f"{self.commands} commands, got {rows} x {columns}"
            )
        if not np.isfinite(self.response).all():
            at = float(self.omega[~np.isfinite(self.response).all(axis=(1, 2))][0])
            raise InputError(f"response must be finite, got a value that is not at {at:.6g} rad/s")

    def __len__(self) -> int:
        return len(self.omega)

    @property
    def disturbances(self) -> int:
        """Number of disturbances."""
        return int(self.response.shape[2]) - self.commands

    def chosen(self, index: IntArray | slice) -> PlantSamples:
        """The samples at `index`; those of a slice share their memory with these."""
        return PlantSamples(self.omega[index], self.response[index], self.measurements, self.commands, check=False)


class GrowingSamples:
    """Samples of one plant to which others are added; what is there is seldom copied.

    Parameters
    ----------
    first : PlantSamples
    """

    def __init__(self, first: PlantSamples) -> None:
        self._omega, self._response, self._count = [first.omega], first.response, len(first)
        self._ports = first.measurements, first.commands

    def append(self, part: PlantSamples) -> None:
        """Add samples of the same plant."""
        end = self._count + len(part)
        if end > len(self._response):
            longer = np.empty((max(end, 2 * self._count), *part.response.shape[1:]), complex)
            longer[: self._count] = self._response[: self._count]
            self._response = longer
        self._response[self._count : end] = part.response
        self._omega.append(part.omega)
        self._count = end

    def all(self) -> PlantSamples:
        """All samples: a view that stays as it is when others are added."""
        return PlantSamples(np.concatenate(self._omega), self._response[: self._count], *self._ports, check=False)
