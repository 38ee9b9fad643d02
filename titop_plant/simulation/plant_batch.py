"""Several telescopes that step together, each with the bits that it has alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lftkit.arrays import FloatArray
from titop_plant.interface import CAMERA, COMMANDS, MEASUREMENTS
from titop_plant.simulation.sampled_plant import SampledPlant, slow_sensors


class PlantBatch:
    """Telescopes of constant matrices and equal sizes; one call of numpy does the tick of all of them.

    The products are those of :meth:`titop_plant.simulation.sampled_plant.SampledPlant.step`, matrix by matrix, so that
    each telescope has the bits that it has alone.

    Parameters
    ----------
    plants : sequence of SampledPlant
        As they were built or reset; they are left alone but for their random numbers.

    Raises
    ------
    ValueError
        No plants, several segments, or other sizes, limits or frame rates.
    """

    def __init__(self, plants: Sequence[SampledPlant]) -> None:
        if not plants or len({self.kind(plant) for plant in plants}) != 1:
            raise ValueError(f"plants must be of one kind, got {len({self.kind(plant) for plant in plants})}")
        first, count = plants[0], len(plants)
        self._plants, self._n, self.tick = plants, first._n, 0
        self.frame_ticks, self._limits, self._lowest = first.frame_ticks, first.limits, first._lowest
        self._slow = slow_sensors(self.frame_ticks)
        self._step = np.stack([plant._segments[0].step for plant in plants])
        self._turn = np.stack([plant._segments[0].turn for plant in plants])
        self._z = np.stack([plant._z for plant in plants])
        self._out = np.empty((count, self._step.shape[1]))
        self._x, self._v = self._z[:, : self._n], self._z[:, self._n : self._n + COMMANDS]
        self._p = self._z[:, self._n + COMMANDS :].view(complex)
        self._noise = np.empty((count, *first._block.shape))
        self._bias = np.stack([plant._sensors.bias for plant in plants])

    @staticmethod
    def kind(plant: SampledPlant) -> tuple[object, ...]:
        """What plants of one batch have in common."""
        return (
            type(plant),
            len(plant._segments),
            plant._segments[0].step.shape,
            plant.frame_ticks,
            plant._noisy,
            plant._disturbed,
            plant.limits.tobytes(),
        )

    def step(self, command: FloatArray, measurement: FloatArray, truth: FloatArray) -> None:
        """Apply `command` (m, 8) from this tick on; write `measurement` (m, 22) and `truth` (m, 2) of this tick."""
        n = self._n
        np.minimum(command, self._limits, out=self._v)
        np.maximum(self._v, self._lowest, out=self._v)
        np.matmul(self._step, self._z[:, :, None], out=self._out[:, :, None])
        row = self.tick % self._noise.shape[1]
        if row == 0:
            for plant, block in zip(self._plants, self._noise):
                plant._noise.standard_normal(out=block)
                block *= plant._sensors.sigma
        noisy = self._plants[0]._noisy
        np.add(self._out[:, n : n + MEASUREMENTS], self._noise[:, row] if noisy else 0.0, out=measurement)
        measurement += self._bias
        truth[:] = self._out[:, n + MEASUREMENTS :]
        for columns, ticks in self._slow:
            if self.tick % ticks:
                measurement[:, columns] = np.nan
        if self.tick % self.frame_ticks:
            measurement[:, CAMERA] = np.nan
        else:
            for plant, values in zip(self._plants, measurement):
                if plant._dropout > 0.0:
                    plant._camera.random(out=plant._frame)
                    if plant._frame[0] < plant._dropout:
                        values[CAMERA] = np.nan
        self._x[:] = self._out[:, :n]
        np.multiply(self._p, self._turn, out=self._p)
        self.tick += 1
