"""Samples of the sensors at places: true values with noise, bias, random walk, range and quantisation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lftkit.arrays import FloatArray
from titop_plant.interface import DT
from titop_plant.sensors import Sensor

SEED_KEY = 19
"""Of their random numbers among those of a run: the noise of the loop stays as it is."""


class SensorReadings:
    """Samples of sensors with a mount, a part of :class:`titop_plant.simulation.plant.Plant`.

    A reading is ``clip(value + bias + noise, -range, range)``, rounded to the step, and NaN where there is no sample.

    Parameters
    ----------
    sensors : sequence of Sensor
        Of a telescope.
    seed : int
        Of the run.
    noise : bool
        Whether there is noise and bias.

    Attributes
    ----------
    size : int
        Number of their values.
    """

    def __init__(self, sensors: Sequence[Sensor], seed: int, noise: bool) -> None:
        self._seed, self._with_noise = seed, noise
        sizes = [one.port.size for one in sensors]
        self._noise = np.concatenate([one.noise for one in sensors])
        self._bias = np.concatenate([one.bias for one in sensors])
        self._step = np.repeat([one.step for one in sensors], sizes)
        self._range = np.repeat([one.range for one in sensors], sizes)
        self._walk = np.repeat([one.random_walk * np.sqrt(DT) for one in sensors], sizes)
        self._ticks = np.repeat([one.ticks for one in sensors], sizes)
        self._slow, self._walking = bool(np.any(self._ticks > 1)), bool(self._walk.any())
        self.size = sum(sizes)
        self._drawn = np.zeros(self.size)
        self._coarse = self._step > 0.0
        self.reset()

    def reset(self) -> None:
        """Return to tick 0: same seed, bit-identical noise."""
        self._rng = np.random.default_rng(np.random.SeedSequence(self._seed, spawn_key=(SEED_KEY,)))
        self._walks = np.random.default_rng(np.random.SeedSequence(self._seed, spawn_key=(SEED_KEY, 1)))
        self._drift, self._step_of_walk, self._tick = *np.zeros((2, self.size)), 0
        self._noisy = self._with_noise

    def change(self, name: str, value: float) -> None:
        """Change ``noise``, see `Plant.change`: the bias stays; other names have no effect."""
        if name == "noise":
            self._noisy = bool(value)

    def read(self, out: FloatArray) -> None:
        """Turn the true values of this tick (size,) into samples, in place; NaN where there is none."""
        drawn = self._drawn
        self._rng.standard_normal(out=drawn)
        drawn *= self._noise
        if self._with_noise:
            out += self._bias
            if self._walking:
                out += self._drift
                self._walks.standard_normal(out=self._step_of_walk)
                self._step_of_walk *= self._walk
                self._drift += self._step_of_walk
        if self._noisy:
            out += drawn
        np.clip(out, -self._range, self._range, out=out)
        out[self._coarse] = np.round(out[self._coarse] / self._step[self._coarse]) * self._step[self._coarse]
        if self._slow:
            out[self._tick % self._ticks != 0] = np.nan
            self._tick += 1
