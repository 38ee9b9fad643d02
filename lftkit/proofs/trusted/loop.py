"""A sampled loop around an uncertain plant, and its responses over a window of frequencies with bounded remainders.

The plant is a sum of modes; a channel w of its parameters is ``w = delta z``. Commands are held for a tick: what drives
the channels and what is seen of a disturbance is the fundamental, what a command makes in measurements and errors is
the sampled response of the nominal plant. The controller in z acts a tick late; a measurement held between frames acts
by its fundamental.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lftkit.proofs.trusted.arithmetic import INFLATE, TINY, UNIT
from lftkit.proofs.trusted.digests import digest
from lftkit.proofs.trusted.polynomials import Polynomial, constant, exponential, inverse, linear, reciprocal
from lftkit.proofs.trusted.proof import REAL, Box, ComplexArray, FloatArray, Strip

CHANGE = 2
"""Of :attr:`Loop.returned`: the change within a tick."""
ONE = constant(np.ones(1))


@dataclass(frozen=True)
class Loop:
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

    @property
    def digest(self) -> str:
        """Digest of all its numbers, by which a check says what its proof is about."""
        values = {field.name: getattr(self, field.name) for field in fields(Loop)}
        arrays = {name: value for name, value in values.items() if isinstance(value, np.ndarray)}
        others = {name: value for name, value in values.items() if name not in arrays}
        return digest(others, arrays)

    @property
    def kinds(self) -> tuple[str, ...]:
        """All parameters are real."""
        return (REAL,) * len(self.groups)

    def coordinates(self, strip: Strip, number: int, omega: float, level: float, /) -> ComplexArray:
        """As of :class:`~lftkit.proofs.trusted.strips.Responses`, of who searches proofs."""
        raise NotImplementedError

    def to_bisect(self, M: Polynomial, part: Box, /) -> int | None:
        """Parameter to bisect where the channels are M over a window, or None; of who searches proofs, untrusted."""
        raise NotImplementedError

    @cached_property
    def entry(self) -> FloatArray:
        """Signals added to the commands by (w, d), shape (u, q + d)."""
        q, _, _, d, u = self.sizes
        found = np.zeros((u, q + d))
        found[list(self.added), [q + k for k in range(len(self.added))]] = 1.0
        return found

    @cached_property
    def growth(self) -> tuple[Polynomial, Polynomial]:
        """``exp(p dt)`` and ``(exp(p dt) - 1) / p`` of the plant's poles, with bounds of their errors.

        Rounding of ``x = p dt`` is one of ``|x exp(x)| u`` in both; the second is small near multiples of 2 pi j.
        """
        x = self.poles * self.dt
        ahead, less = np.exp(x), np.expm1(x)
        error = 8.0 * UNIT * (np.abs(x) * np.abs(ahead) + 2.0 * np.abs(less)) + TINY
        of_gain = INFLATE * (error / np.abs(self.poles))
        return constant(ahead, 8.0 * UNIT * (1.0 + np.abs(x))), Polynomial((less / self.poles)[None], of_gain)

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
        q, y, _, d, u = self.sizes
        phi = reciprocal(constant(1j) * linear(middle, half) - constant(self.poles))
        given = constant(V)
        own = (constant(self.C) * phi) @ (constant(self.B[:, : q + d]) @ given) + constant(self.D[:, : q + d]) @ given
        if not u:
            return own[:q], own[q:][list(self.rows)]
        through = (constant(self.C[:q]) * phi) @ constant(self.B[:, q + d :]) + constant(self.D[:q, q + d :])
        felt = through * self.hold(middle, half)
        seen, K = self.sampled(middle, half, slice(q, None)), self.controller(middle, half)
        added = constant(self.entry @ V)
        loop, command = inverse(constant(np.eye(u)) - K @ seen[:y]), K @ own[q : q + y]
        commands = loop @ (command + added if self.added else command)
        channels, errors = own[:q] + felt @ commands, own[q + y :] + seen[y:] @ commands
        if self.returned:
            commands = commands - added
        if self.returned == CHANGE:
            commands = commands * (ONE - self.shift(middle, half))
        return channels, (commands if self.commands else errors)[list(self.rows)]

    def return_difference(self, middle: float, half: float) -> Polynomial:
        """``I - K G`` of the nominal loop over a window ``middle + half t`` [rad/s], (u, u).

        Raises
        ------
        ArithmeticError
            The window may contain a pole of the plant or the controller.
        """
        q, y, _, _, u = self.sizes
        return constant(np.eye(u)) - self.controller(middle, half) @ self.sampled(middle, half, slice(q, q + y))

    def shift(self, middle: float, half: float, ticks: float = -1.0) -> Polynomial:
        """``z^ticks`` over a window, (1,)."""
        return exponential(np.array([ticks * middle * self.dt]), np.array([ticks * half * self.dt]))

    def sampled(self, middle: float, half: float, rows: slice) -> Polynomial:
        """Rows of the plant's sampled response to held commands."""
        first = self.sizes[0] + self.sizes[3]
        growth, gain = self.growth
        held = reciprocal(self.shift(middle, half, 1.0) - growth)
        driven = gain[:, None] * constant(self.B[:, first:])
        return (constant(self.C[rows]) * held) @ driven + constant(self.D[rows, first:])

    def controller(self, middle: float, half: float) -> Polynomial:
        """Commands by measurements, with the delay of a tick and the hold of frames."""
        modes = reciprocal(self.shift(middle, half, 1.0) - constant(self.K_poles))
        K = (constant(self.K_C) * modes) @ constant(self.K_B) + constant(self.K_D)
        ticks = np.arange(self.frame.max(initial=1), dtype=float)
        waves = exponential(-ticks * middle * self.dt, -ticks * half * self.dt)
        held = np.stack([np.where(ticks < n, 1.0 / n, 0.0) for n in self.frame])
        frames = constant(held, 2.0 * UNIT) @ waves[:, None]
        return K * frames[:, 0] * self.shift(middle, half)

    def hold(self, middle: float, half: float) -> Polynomial:
        """``(1 - exp(-j w dt)) / (j w dt)``."""
        x = linear(-1j * middle * self.dt, -1j * half * self.dt, 2.0 * UNIT * (middle + half) * self.dt)
        if (middle + half) * self.dt >= 0.05:
            return (self.shift(middle, half) - ONE) * reciprocal(x)
        total = power = ONE
        for k in range(1, 9):
            power = power * x * constant(1.0 / (k + 1), UNIT)
            total = total + power
        return Polynomial(total.c, total.rad + 0.05**9)

    def performance(self, middle: float, half: float) -> tuple[Polynomial, Polynomial]:
        """Squares of the output's weight (1,), and of one over the disturbances' amplitudes (d,)."""
        a, zero, pole = (constant(column**2, UNIT) for column in self.weights.T)
        square = linear(middle, half) * linear(middle, half)
        inputs = (square + pole) * reciprocal((square + zero) * a)
        output = constant(np.array([self.scale**-2.0]), 4.0 * UNIT)
        if self.window:
            # |y (y + sqrt 12) / (y^2 + 6 y + 12)|^2 at y = j w window
            y, twelve = square * constant(np.array([self.window**2]), UNIT), constant(12.0 * np.ones(1))
            output = output * (y * (y + twelve)) * reciprocal(y * y + twelve * y + twelve * twelve)
        return output, inputs
