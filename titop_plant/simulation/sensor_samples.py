"""Samples of the sensors without a mount: noise, bias, frames of the camera and those that are lost."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lftkit.arrays import FloatArray, IntArray
from titop_plant.interface import CAMERA
from titop_plant.simulation.kernel_arrays import SensorArrays

_NOISE_BLOCK = 64


@dataclass(frozen=True)
class SensorModel:
    """Noise, bias and frame rate.

    Parameters
    ----------
    sigma : ndarray, shape (m,)
        Standard deviation of the samples (of a frame for the camera).
    bias : ndarray, shape (m,)
        Added to every sample.
    frame_ticks : int
        Ticks between camera frames.
    dropout : float
        Probability that a frame is lost (read as NaN).
    seed : int
    """

    sigma: FloatArray
    bias: FloatArray
    frame_ticks: int
    dropout: float
    seed: int


class SensorSamples:
    """The samples of a run, tick by tick or many ticks at a time: the same random numbers either way.

    Parameters
    ----------
    model : SensorModel
    """

    def __init__(self, model: SensorModel) -> None:
        self.model = model
        self._block = np.zeros((_NOISE_BLOCK, model.sigma.size))
        self._frame = np.zeros(3)
        self.reset()

    def reset(self) -> None:
        """Return to tick 0: same seed, bit-identical noise."""
        noise, camera = np.random.SeedSequence(self.model.seed).spawn(2)
        self._noise, self._camera = np.random.default_rng(noise), np.random.default_rng(camera)
        self.noisy = True
        self._dropout = self.model.dropout

    def change(self, name: str, value: float) -> None:
        """Change ``noise`` (the bias stays) or ``camera_dropout``, see `Plant.change`; other names have no effect."""
        if name == "noise":
            self.noisy = bool(value)
        elif name == "camera_dropout":
            self._dropout = float(value)

    def write(self, tick: int, true: FloatArray, out: FloatArray) -> None:
        """Write the measurement `out` (m,) of a tick, with the values `true` (m,) and NaN where there is no sample.

        Ticks follow each other.
        """
        row = tick % _NOISE_BLOCK
        if row == 0:
            self._draw()
        np.add(true, self._block[row] if self.noisy else 0.0, out=out)
        out += self.model.bias
        if tick % self.model.frame_ticks or self._lost():
            out[CAMERA] = np.nan

    def ahead(self, ticks: IntArray) -> SensorArrays:
        """Noise added to the true values at the next consecutive ticks."""
        rows, done = len(ticks), 0
        noise = np.empty((rows, self.model.sigma.size))
        absent = np.zeros(noise.shape, bool)
        while done < rows:
            row = int(ticks[done]) % _NOISE_BLOCK
            if row == 0:
                self._draw()
            some = min(_NOISE_BLOCK - row, rows - done)
            noise[done : done + some] = self._block[row : row + some]
            done += some
        framed = ticks % self.model.frame_ticks == 0
        absent[:, CAMERA] = ~framed[:, None]
        if self._dropout > 0.0:
            for row in np.flatnonzero(framed):
                absent[row, CAMERA] = self._lost()
        return SensorArrays(noise, self.model.bias, absent)

    def _draw(self) -> None:
        """Noise of the next ticks."""
        self._noise.standard_normal(out=self._block)
        self._block *= self.model.sigma

    def _lost(self) -> bool:
        """Whether the frame of this tick is lost."""
        if not self._dropout > 0.0:
            return False
        self._camera.random(out=self._frame)
        return bool(self._frame[0] < self._dropout)


__all__ = ["SensorModel", "SensorSamples"]
