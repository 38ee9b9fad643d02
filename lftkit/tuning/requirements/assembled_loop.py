"""Closed loops as state-space models, for certificates: nothing here uses the code that tunes."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import scipy.linalg

from lftkit.arrays import ComplexArray
from lftkit.errors import InputError
from lftkit.systems.connection.feedback import cascade, close_loop
from lftkit.systems.delay import delay_radius, pade_delay
from lftkit.systems.sampled.image import rates
from lftkit.systems.system import System

PADE_ORDER = 8
"""Of the delay: another one than the tuner's."""
NO_DELAY = "loop_delay must be 0 in discrete time, where delays are states"


class AssembledLoop:
    """A model with a controller, in continuous or discrete time.

    Parameters
    ----------
    model, controller : System
    loop_delay : float
        Delay on the commands [s], a Padé approximation; 0 in discrete time, where delays are states.

    Raises
    ------
    ValueError
        A delay in discrete time, sampling periods that differ, ports that do not fit.
    """

    def __init__(self, model: System, controller: System, loop_delay: float = 0.0) -> None:
        if model.dt and loop_delay:
            raise InputError(f"{NO_DELAY}, got {loop_delay:g} s")
        self.model, self._plain, self.loop_delay = model, controller, loop_delay
        self.controller = delayed_controller(controller, loop_delay)
        self._closed = close_loop(model, self.controller, (), ())

    @property
    def dt(self) -> float:
        """Sampling period [s], 0 for continuous time."""
        return float(self._closed.dt)

    @cached_property
    def _poles(self) -> ComplexArray:
        return self._rates(self._closed)

    @property
    def abscissa(self) -> float:
        """Largest real part of the poles [rad/s], in discrete time of ``log(z) / T``."""
        return float(self._poles.real.max(initial=-np.inf))

    @property
    def poles(self) -> ComplexArray:
        """Poles [rad/s], in discrete time ``log(z) / T``, without those of the delay's approximation."""
        if not self.loop_delay:
            return self._poles
        return self._poles[np.abs(self._poles) < delay_radius(self.loop_delay, PADE_ORDER)]

    @property
    def controller_poles(self) -> ComplexArray:
        """Poles of the controller itself [rad/s], in discrete time ``log(z) / T``."""
        return self._rates(self._plain)

    def _rates(self, system: System) -> ComplexArray:
        poles = np.asarray(scipy.linalg.eigvals(system.A), dtype=complex)
        return rates(poles, self.dt) if self.dt else poles


def delayed_controller(controller: System, loop_delay: float) -> System:
    """Controller followed by the Padé approximation of the delay on its commands [s]."""
    if loop_delay == 0.0:
        return controller
    whole = cascade(controller, pade_delay(loop_delay, PADE_ORDER, controller.D.shape[0]))
    return System(*whole.matrices, controller.inputs, controller.outputs, controller.name)
