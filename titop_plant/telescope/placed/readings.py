"""What the further sensors of a run say: true values with noise, bias, range and quantisation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from lftkit.arrays import FloatArray
from titop_plant.telescope.devices import PlacedSensor

SEED_KEY = 19
"""Of their random numbers among those of a run: the noise of the loop stays as it is."""


class SensedPlant(Protocol):
    """A telescope that knows the true values of its further sensors."""

    @property
    def sensed(self) -> FloatArray:
        """At the last tick."""

    def reset(self) -> None:
        """Back to tick 0."""

    def change(self, name: str, value: float) -> None:
        """A setting, see `SampledPlant.change`."""

    def step(self, command: FloatArray, measurement: FloatArray, truth: FloatArray) -> None:
        """One tick."""


class PlantWithReadings:
    """A telescope whose further sensors are read at every tick; its other attributes are those of the telescope.

    A reading is ``clip(value + bias + noise, -range, range)``, rounded to the step.

    Parameters
    ----------
    plant : SensedPlant
    sensors : sequence of PlacedSensor
    seed : int
        Of the run.
    noise : bool
        Whether there is noise and bias.
    """

    dt: float
    frame_ticks: int
    limits: FloatArray
    tones: FloatArray
    parameters_hash: str

    def __init__(self, plant: SensedPlant, sensors: Sequence[PlacedSensor], seed: int, noise: bool) -> None:
        self.plant, self._seed, self._with_noise = plant, seed, noise
        for name in ("dt", "frame_ticks", "limits", "tones", "parameters_hash"):
            setattr(self, name, getattr(plant, name))
        sizes = [len(one.axes) for one in sensors]
        self._noise, self._bias, self._step, self._range = (
            np.repeat([getattr(one, name) for one in sensors], sizes) for name in ("noise", "bias", "step", "range")
        )
        self._coarse = self._step > 0.0
        self.readings = np.zeros(sum(sizes))
        """Of all sensors at the last tick, in the order of the file."""
        self._restart()

    def reset(self) -> None:
        """Back to tick 0: same seed, same bits."""
        self.plant.reset()
        self._restart()

    def _restart(self) -> None:
        self._rng = np.random.default_rng(np.random.SeedSequence(self._seed, spawn_key=(SEED_KEY,)))
        self._noisy = self._with_noise
        self.readings[:] = 0.0

    def change(self, name: str, value: float) -> None:
        """Change a setting, see `SampledPlant.change`; without ``noise`` the bias stays."""
        self.plant.change(name, value)
        if name == "noise":
            self._noisy = bool(value)

    def step(self, command: FloatArray, measurement: FloatArray, truth: FloatArray) -> None:
        """Apply `command` (8,) from this tick on; write `measurement` (22,) and `truth` (2,) of this tick."""
        self.plant.step(command, measurement, truth)
        drawn, out = self._rng.standard_normal(self.readings.size), self.readings
        out[:] = self.plant.sensed
        if self._with_noise:
            out += self._bias
        if self._noisy:
            out += self._noise * drawn
        np.clip(out, -self._range, self._range, out=out)
        out[self._coarse] = np.round(out[self._coarse] / self._step[self._coarse]) * self._step[self._coarse]
