"""What is asked of a loop that is known by its responses: largest gains, and noise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from lftkit.tuning.responses.samples import PlantSamples


@dataclass(frozen=True)
class ResponseGain:
    """Largest singular value of a part of the closed loop, at every pair.

    Parameters
    ----------
    name : str
    active : tuple of int
        Blocks of the loop that is closed; the other commands are zero.
    outputs : slice or None
        Commands, as applied to the plant; None: the errors.
    inputs : slice or None
        Signals added to these commands; None: the disturbances.
    scale : callable
        From N frequencies to the factor of the gain, shape (N,): 1 over the limit, 0 where it does not count.
    hard : bool
        Met first, then kept.
    """

    name: str
    active: tuple[int, ...]
    outputs: slice | None
    inputs: slice | None
    scale: Callable[[FloatArray], FloatArray]
    hard: bool = False


@dataclass(frozen=True)
class ResponseNoise:
    """Error [rms] that white noise of the measurements makes, at one parameter point.

    Parameters
    ----------
    name : str
    active : tuple of int
        As in :class:`ResponseGain`.
    samples : PlantSamples
        Over the whole frequency axis, as fine as the integral asks.
    density : ndarray, shape (N, measurements)
        Amplitude of each measurement's noise in the closed loop's error: the square root of its power density, with
        whatever weighs the error.
    step : ndarray, shape (N,)
        Weights of the integral over frequency.
    limit : float
        Error that counts as 1.
    hard : bool
        Met first, then kept.
    """

    name: str
    active: tuple[int, ...]
    samples: PlantSamples
    density: FloatArray
    step: FloatArray
    limit: float
    hard: bool = False

    def __post_init__(self) -> None:
        shape = (len(self.samples), self.samples.measurements)
        if self.density.shape != shape or self.step.shape != shape[:1]:
            raise InputError(
                f"density and step must have the shapes {shape} and {shape[:1]}, "
                f"got {self.density.shape} and {self.step.shape}"
            )
        if not self.limit > 0.0:
            raise InputError(f"limit must be positive, got {self.limit}")
