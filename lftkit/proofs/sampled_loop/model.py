"""A sampled loop around an uncertain plant, and its responses over a window of frequencies with bounded remainders.

The plant is a sum of modes; a channel w of its parameters is ``w = delta z``. Commands are held for a tick: what drives
the channels and what is seen of a disturbance is the fundamental, what a command makes in measurements and errors is
the sampled response of the nominal plant. The controller in z acts a tick late; a measurement held between frames acts
by its fundamental.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from lftkit.arrays import ComplexArray, FloatArray
from lftkit.proofs.sampled_loop.polynomials import (
    UNIT,
    Polynomial,
    constant,
    exponential,
    inverse,
    reciprocal,
)

CHANGE = 2
"""Of :attr:`LoopModel.returned`: the change within a tick."""


@dataclass(frozen=True)
class LoopModel:
    """The loop as it stands in a proof.

    Parameters
    ----------
    dt : float
        Tick [s].
    poles : ndarray, complex, shape (n,)
        Of the plant.
    C, B : ndarray, complex, shapes (q + y + e, n) and (n, q + d + u)
        Channels of the parameters, measurements and errors; channels, disturbances and commands.
    D : ndarray, shape (q + y + e, q + d + u)
    K_poles, K_C, K_B, K_D : ndarray
        Controller in z: shapes (k,), (u, k), (k, y), (u, y).
    frame : ndarray, shape (y,)
        Ticks for which a measurement is held, 1 where it is not.
    groups : tuple of tuple of int
        Channels of each parameter.
    angle : tuple of bool
        Whether a parameter is tan(theta / 2) of an angle theta.
    weights : ndarray, shape (d, 3)
        a, zero, pole [rad/s] of the disturbances' amplitudes ``a hypot(w, zero) / hypot(w, pole)``.
    window : float
        Length [s] of the relative error's window, 0 for the error itself.
    rows : tuple of int
        Errors, or commands, that are bounded.
    scale : float
        Divisor of them: the limit.
    commands : bool
        Whether commands are bounded in place of errors.
    added : tuple of int
        For each disturbance the command to which it is added; empty where none is, else `commands` are bounded.
    returned : int
        What is bounded with such signals: 0 the commands applied (the sensitivity), 1 those of the controller (the
        complementary sensitivity), 2 the change of these within a tick (what one more tick of delay adds).
    """

    dt: float
    poles: ComplexArray
    C: ComplexArray
    B: ComplexArray
    D: FloatArray
    K_poles: ComplexArray
    K_C: ComplexArray
    K_B: ComplexArray
    K_D: FloatArray
    frame: NDArray[np.int64]
    groups: tuple[tuple[int, ...], ...]
    angle: tuple[bool, ...]
    weights: FloatArray
    window: float
    rows: tuple[int, ...]
    scale: float
    commands: bool
    added: tuple[int, ...] = ()
    returned: int = 0

    @cached_property
    def sizes(self) -> tuple[int, int, int, int, int]:
        """Channels, measurements, errors, disturbances, commands."""
        q, y, u = sum(len(g) for g in self.groups), len(self.frame), len(self.K_C)
        return q, y, len(self.C) - q - y, len(self.weights), u

    @cached_property
    def entry(self) -> FloatArray:
        """Signals added to the commands by (w, d), shape (u, q + d)."""
        q, _, _, d, u = self.sizes
        found = np.zeros((u, q + d))
        found[list(self.added), [q + k for k in range(len(self.added))]] = 1.0
        return found

    @property
    def slowest(self) -> float:
        """Smallest magnitude of the plant's poles [rad/s], at most 1 / dt."""
        return float(np.abs(self.poles).min(initial=1.0 / self.dt))

    @cached_property
    def growth(self) -> tuple[ComplexArray, ComplexArray]:
        """``exp(p dt)`` and ``(exp(p dt) - 1) / p`` of the plant's poles."""
        x = self.poles * self.dt
        return np.exp(x), np.expm1(x) / self.poles

    def responses(self, middle: float, half: float, V: ComplexArray) -> tuple[Polynomial, Polynomial]:
        """``z`` and the bounded output over a window of frequency, as maps from the coordinates of V.

        Parameters
        ----------
        middle, half : float
            Frequencies ``middle + half t`` [rad/s].
        V : ndarray, complex, shape (q + d, N)
            (w, d) of the coordinates.

        Raises
        ------
        ArithmeticError
            The window may contain a pole of the plant or of the nominal loop.
        """
        q, y, _, d, _ = self.sizes
        omega = Polynomial(np.array([[middle], [half]], dtype=complex))
        z = exponential(np.array([middle * self.dt]), np.array([half * self.dt]))
        phi = reciprocal(constant(1j) * omega - constant(self.poles))
        hold = self._hold(middle, half)
        into = self.B[:, q + d :]
        driven = constant(self.B[:, : q + d]) @ constant(V)
        own = (constant(self.C) * phi) @ driven + constant(self.D[:, : q + d]) @ constant(V)
        if not len(self.K_C):
            return own.rows(slice(0, q)), own.rows(list(range(q, len(self.C)))).rows(list(self.rows))
        seen = self._sampled(z, slice(q, None))
        felt = ((constant(self.C[:q]) * phi) @ constant(into) + constant(self.D[:q, q + d :])) * hold
        K = self.controller(z, middle, half)
        loop = inverse(constant(np.eye(len(self.K_C))) - K @ seen.rows(slice(0, y)))
        command = K @ own.rows(slice(q, q + y))
        u = loop @ (command + constant(self.entry @ V) if self.added else command)
        channels = own.rows(slice(0, q)) + felt @ u
        outputs = own.rows(slice(q + y, None)) + seen.rows(slice(y, None)) @ u
        if self.returned:
            u = u - constant(self.entry @ V)
        if self.returned == CHANGE:
            u = u * (constant(np.ones(1)) - exponential(np.array([-middle * self.dt]), np.array([-half * self.dt])))
        return channels, (u if self.commands else outputs).rows(list(self.rows))

    def return_difference(self, middle: float, half: float) -> Polynomial:
        """``I - K G`` of the nominal loop over a window ``middle + half t`` [rad/s], (u, u).

        Raises
        ------
        ArithmeticError
            The window may contain a pole of the plant or the controller.
        """
        q, y = self.sizes[:2]
        z = exponential(np.array([middle * self.dt]), np.array([half * self.dt]))
        seen = self._sampled(z, slice(q, q + y))
        return constant(np.eye(len(self.K_C))) - self.controller(z, middle, half) @ seen

    def at(self, omega: float) -> tuple[ComplexArray, ComplexArray]:
        """``z`` and the bounded output by (w, d) at one frequency, (q, q + d) and (rows, q + d), without bounds."""
        q, y, _, d, _ = self.sizes
        s, z = 1j * omega, np.exp(1j * omega * self.dt)
        growth, gain = self.growth
        own = (self.C / (s - self.poles)) @ self.B[:, : q + d] + self.D[:, : q + d]
        if not len(self.K_C):
            return own[:q], np.asarray(own[q:][list(self.rows)])
        seen = (self.C[q:] * (gain / (z - growth))) @ self.B[:, q + d :] + self.D[q:, q + d :]
        felt = (self.C[:q] / (s - self.poles)) @ self.B[:, q + d :] + self.D[:q, q + d :]
        K = ((self.K_C / (z - self.K_poles)) @ self.K_B + self.K_D) / z
        K = K * np.array([np.mean(z ** -np.arange(n)) for n in self.frame])
        returned = np.eye(len(K)) - K @ seen[:y]
        scale = 1.0 / np.abs(returned).max(axis=1)[:, None]  # angles beside forces: else the angles lose six digits
        u = linalg.solve(scale * returned, scale * (K @ own[q : q + y] + self.entry))
        hold = (1.0 - 1.0 / z) / (s * self.dt)
        channels = own[:q] + hold * felt @ u
        if self.returned:
            u = (u - self.entry) * (1.0 - 1.0 / z if self.returned == CHANGE else 1.0)
        outputs = u if self.commands else own[q + y :] + seen[y:] @ u
        return channels, np.asarray(outputs[list(self.rows)])

    def amplitudes(self, omega: float) -> tuple[float, FloatArray]:
        """Weight of the bounded output (over the limit) and amplitudes of the disturbances, without bounds."""
        output, inputs = self.performance(omega, 0.0)
        return float(np.sqrt(output.c[0, 0].real)), np.asarray(inputs.c[0].real ** -0.5)

    def _sampled(self, z: Polynomial, rows: slice) -> Polynomial:
        """Rows of the plant's sampled response to held commands."""
        first = self.sizes[0] + self.sizes[3]
        growth, gain = self.growth
        error = 8.0 * UNIT * (1.0 + float(np.abs(self.poles).max()) * self.dt)
        held = reciprocal(z - constant(growth, error))
        driven = constant(gain[:, None] * self.B[:, first:], error)
        return (constant(self.C[rows]) * held) @ driven + constant(self.D[rows, first:])

    def controller(self, z: Polynomial, middle: float, half: float) -> Polynomial:
        """Commands by measurements, with the delay of a tick and the hold of frames."""
        K = (constant(self.K_C) * reciprocal(z - constant(self.K_poles))) @ constant(self.K_B) + constant(self.K_D)
        ticks = np.arange(int(self.frame.max(initial=1)))
        waves = exponential(-ticks * middle * self.dt, -ticks * half * self.dt)
        held = np.stack([np.where(ticks < n, 1.0 / n, 0.0) for n in self.frame])
        frames = constant(held, 2.0 * UNIT) @ waves[:, None]
        delay = exponential(np.array([-middle * self.dt]), np.array([-half * self.dt]))
        return K * Polynomial(frames.c[:, :, 0], frames.rad[:, 0]) * delay

    def _hold(self, middle: float, half: float) -> Polynomial:
        """``(1 - exp(-j w dt)) / (j w dt)``."""
        rounding = np.array([2.0 * UNIT * (middle + half) * self.dt])
        x = Polynomial(np.array([[-1j * middle * self.dt], [-1j * half * self.dt]]), rounding)
        if (middle + half) * self.dt < 0.05:
            total = power = constant(np.ones(1))
            for k in range(1, 9):
                power = power * x * constant(1.0 / (k + 1), UNIT)
                total = total + power
            return Polynomial(total.c, total.rad + 0.05**9)
        back = exponential(np.array([-middle * self.dt]), np.array([-half * self.dt]))
        return (back - constant(np.ones(1))) * reciprocal(x)

    def performance(self, middle: float, half: float) -> tuple[Polynomial, Polynomial]:
        """Squares of the output's weight (1,), and of one over the disturbances' amplitudes (d,)."""
        x = Polynomial(np.array([[middle], [half]], dtype=complex))
        square = x * x
        a, zero, pole = (self.weights[:, k] for k in range(3))
        inputs = (square + constant(pole**2, UNIT)) * reciprocal(
            (square + constant(zero**2, UNIT)) * constant(a**2, UNIT)
        )
        output = constant(np.array([self.scale**-2.0]), 4.0 * UNIT)
        if self.window:
            y = square * constant(np.array([self.window**2]), UNIT)
            # |y (y + sqrt 12) / (y^2 + 6 y + 12)|^2 at y = j w window
            output = (
                output
                * (y * (y + constant(12.0 * np.ones(1))))
                * reciprocal(y * y + constant(12.0 * np.ones(1)) * y + constant(144.0 * np.ones(1)))
            )
        return output, inputs
