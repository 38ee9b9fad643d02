"""State propagation of a telescope with constant parameters: one matrix for all ticks.

The arithmetic of a tick, its coordinates and its order are those of :mod:`titop_plant.simulation.plant_step`.
:meth:`ConstantStep.advance` computes them with numpy or with the compiled code of
:mod:`titop_plant.simulation.kernel`. **Both are bit-identical.**
"""

from __future__ import annotations

import numpy as np

from lftkit.arrays import FloatArray, IntArray
from lftkit.systems.sampled.ordered_product import OrderedProduct, add_up
from titop_plant.interface import DT
from titop_plant.simulation.compilation import kernel
from titop_plant.simulation.kernel_arrays import Course, StepArrays
from titop_plant.simulation.plant_step import PlantStep

NO_COURSE = Course(np.zeros(0), np.zeros((0, 0)))
"""That of constant parameters."""


class ConstantStep:
    """State at the start of a telescope with constant parameters, and its next state.

    Parameters
    ----------
    numbers : PlantStep
        Of order n, with K tones.
    start : ndarray, shape (n,)
        State at tick 0.
    tones : ndarray, shape (K,)
        Frequencies of the disturbance [rad/s], for reports.
    dt : float
        Sampling period [s].

    Attributes
    ----------
    arrays : StepArrays
        For compiled code.
    compiled : bool
        Whether :meth:`advance` and :meth:`turn` use it.
    """

    motion = None
    """Motion for reports: none."""

    def __init__(self, numbers: PlantStep, start: FloatArray, tones: FloatArray, dt: float = DT) -> None:
        self.numbers, self.start, self.tones, self.dt = numbers, start, tones, dt
        self.arrays = StepArrays(
            numbers.pairs,
            numbers.own,
            numbers.cross,
            numbers.driven,
            numbers.block,
            numbers.outputs,
            numbers.turn,
            np.zeros((0, 0, 0)),
        )
        self.compiled = False
        self._block = OrderedProduct(numbers.block.T)
        self._products = np.zeros_like(numbers.outputs)
        self._terms = np.zeros((2 + len(numbers.driven), max(len(numbers.own), 2)))
        self._later = np.zeros(numbers.order)

    def begin(self, phasors: FloatArray) -> None:
        """Write the phasors (2 K,) of tick 0, real and imaginary parts in turn."""
        phasors[0::2], phasors[1::2] = 1.0, 0.0

    def advance(self, tick: int, values: FloatArray, sums: FloatArray) -> None:
        """Write outputs and next coordinates.

        Parameters
        ----------
        tick : int
            Number of the tick.
        values : ndarray, shape (n + c + 2 K,)
            Coordinates, which are replaced by the next ones; commands; phasors.
        sums : ndarray, shape (m + 2,)
            Measurement and truth of this tick, without noise; written.
        """
        later = self._later
        if self.compiled and (compiled := kernel()) is not None:
            compiled.advance(self.arrays, values, later, sums)
            return
        numbers, terms = self.numbers, self._terms
        n, plain, m = numbers.order, len(numbers.own), numbers.pairs
        add_up(numbers.outputs, values, self._products, sums)
        np.multiply(numbers.own, values[:plain], out=terms[0, :plain])
        np.multiply(numbers.cross[:m], values[m : 2 * m], out=terms[1, :m])
        np.multiply(numbers.cross[m : 2 * m], values[:m], out=terms[1, m : 2 * m])
        np.multiply(numbers.driven, values[n : n + len(numbers.driven), None], out=terms[2:, :plain])
        if n > plain:
            self._block.values[:] = values[plain : plain + len(numbers.block)]
            later[plain:] = self._block()
        values[:plain] = np.add.reduce(terms, axis=0)[:plain]
        values[plain:n] = later[plain:]

    def turn(self, tick: int, phasors: FloatArray) -> None:
        """Write the phasors (2 K,) of the tick after this one."""
        if self.compiled and (compiled := kernel()) is not None:
            compiled.turn(self.numbers.turn, phasors)
            return
        re, im = phasors[0::2].copy(), phasors[1::2].copy()
        cos, sin = self.numbers.turn
        phasors[0::2] = re * cos - im * sin
        phasors[1::2] = re * sin + im * cos

    def course(self, ticks: IntArray) -> Course:
        """Places and phasors of these consecutive ticks: none."""
        return NO_COURSE


__all__ = ["ConstantStep"]
