"""Goals for the response of an output to a reference: tracking, step response, overshoot."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from lftkit.systems.connection.filters import transfer
from lftkit.systems.system import System
from lftkit.tuning.goals.goal import with_output
from lftkit.tuning.requirements import H2Gain, HinfGain, Requirement

GAP_LEAK = 1e-3  # of the integrator in the weight of a step, relative to the speed of the reference model


@dataclass(frozen=True)
class _FromReference:
    """A goal for the response of an output to a reference of the same size."""

    reference: str
    output: str

    def prepared(self, model: System) -> System:
        """The model with the output ``output-reference``.

        Raises
        ------
        ValueError
            Ports that do not exist, or of different sizes.
        """
        name, columns, rows = self._error, model.input_indices([self.reference]), model.output_indices([self.output])
        if len(columns) != len(rows):
            raise ValueError(
                f"{self.output} and {self.reference} must have the same size, got {len(rows)} and {len(columns)}"
            )
        D = model.D[rows].copy()
        D[:, columns] -= np.eye(len(rows))
        return with_output(model, name, model.C[rows], D)

    @property
    def _error(self) -> str:
        return f"{self.output}-{self.reference}"

    def _name(self, given: str) -> str:
        return given or f"{type(self).__name__} {self.reference} -> {self.output}"


@dataclass(frozen=True)
class Tracking(_FromReference):
    """Largest relative error of tracking: `dc_error` at frequency 0, `peak_error` at high frequency.

    The gain from the reference to the error is at most ``(peak_error s + w dc_error) / (s + w)`` with
    ``w = 2 / response_time``.

    Parameters
    ----------
    reference, output : str
        Ports of the same size.
    response_time : float
        [s]
    dc_error, peak_error : float
    hard : bool
    name : str
    """

    response_time: float = 1.0
    dc_error: float = 1e-3
    peak_error: float = 1.0
    hard: bool = False
    name: str = ""

    def __post_init__(self) -> None:
        for name in ("response_time", "dc_error", "peak_error"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)}")

    def requirements_on(self, model: System) -> tuple[Requirement, ...]:
        """One gain."""
        w, size = 2.0 / self.response_time, len(model.input_indices([self.reference]))
        weight = transfer([1.0, w], [self.peak_error, w * self.dc_error], size)
        common = {"weight_out": weight, "hard": self.hard, "name": self._name(self.name)}
        return (HinfGain((self.reference,), (self._error,), **common),)  # type: ignore[arg-type]


@dataclass(frozen=True)
class StepTracking(_FromReference):
    """Step response near that of ``1 / (time_constant s + 1)``: relative mismatch of at most `relative_gap`.

    ``||(T - M) / s|| <= relative_gap ||(1 - M) / s||`` in the H2 norm, for the response T and the model M; steps of
    all references at once. The error must vanish in the end, else the norm is large.

    Parameters
    ----------
    reference, output : str
    time_constant : float
        [s]
    relative_gap : float
    hard : bool
    name : str
    """

    time_constant: float = 1.0
    relative_gap: float = 0.1
    hard: bool = False
    name: str = ""

    def __post_init__(self) -> None:
        for name in ("time_constant", "relative_gap"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)}")

    @property
    def _mismatch(self) -> str:
        return f"{self._error}.mismatch {self.time_constant:g} s"

    def prepared(self, model: System) -> System:
        """The model with the difference of the output and the reference model's (held between samples)."""
        model = super().prepared(model)
        if any(p.name == self._mismatch for p in model.outputs):
            return model
        columns, rows = model.input_indices([self.reference]), model.output_indices([self.output])
        size, n, tau = len(rows), model.order, self.time_constant
        pole, gain = (-1.0 / tau, 1.0 / tau) if not model.dt else (self._decay(model.dt), 1.0 - self._decay(model.dt))
        A = linalg.block_diag(model.A, pole * np.eye(size))
        B = np.vstack([model.B, np.zeros((size, model.B.shape[1]))])
        B[n:, columns] = gain * np.eye(size)
        C = np.hstack([model.C, np.zeros((len(model.C), size))])
        wide = System(A, B, C, model.D, model.inputs, model.outputs, model.name, dt=model.dt)
        difference = np.hstack([model.C[rows], -np.eye(size)])
        return with_output(wide, self._mismatch, difference, model.D[rows])

    def _decay(self, time: float) -> float:
        """Of the reference model in this time [s]."""
        return float(np.exp(-time / self.time_constant))

    def requirements_on(self, model: System) -> tuple[Requirement, ...]:
        """One H2 norm."""
        size, leak, dt = len(model.input_indices([self.reference])), GAP_LEAK / self.time_constant, model.dt
        # (1 - M) / s = tau / (tau s + 1): its norm is the root of tau / 2 for each reference; of samples a sum
        square, weight = 0.5 * self.time_constant, transfer([1.0], [1.0, leak], size)
        if dt:
            square, left = dt / (1.0 - self._decay(dt) ** 2), float(np.exp(-leak * dt))
            one = np.eye(size)
            weight = System(left * one, one, dt * left * one, dt * one, weight.inputs, weight.outputs, "step", dt=dt)
        bound = self.relative_gap * float(np.sqrt(square * size))
        common = {"weight_in": weight, "hard": self.hard, "name": self._name(self.name)}
        return (H2Gain((self.reference,), (self._mismatch,), bound, **common),)  # type: ignore[arg-type]


@dataclass(frozen=True)
class Overshoot(_FromReference):
    """Overshoot of the step response of at most `percent`, by the peak gain of a system of second order.

    Parameters
    ----------
    reference, output : str
    percent : float
    hard : bool
    name : str

    Notes
    -----
    A damping ratio z overshoots by ``exp(-pi z / sqrt(1 - z^2))`` and has a peak gain of ``1 / (2 z sqrt(1 - z^2))``,
    or 1 from z = 0.707 on. For loops that are far from second order the overshoot may be another one.

    Examples
    --------
    >>> round(Overshoot("r", "y", percent=10.0).peak_gain, 4)
    1.0487
    """

    percent: float = 10.0
    hard: bool = False
    name: str = ""

    def __post_init__(self) -> None:
        if not 0.0 < self.percent < 100.0:
            raise ValueError(f"percent must be between 0 and 100, got {self.percent}")

    @property
    def peak_gain(self) -> float:
        """Of the system of second order."""
        decay = -float(np.log(0.01 * self.percent))
        z = decay / float(np.hypot(np.pi, decay))
        return 1.0 if z >= np.sqrt(0.5) else 0.5 / (z * float(np.sqrt(1.0 - z * z)))

    def prepared(self, model: System) -> System:
        """The model as it is."""
        return model

    def requirements_on(self, model: System) -> tuple[Requirement, ...]:
        """One gain."""
        common = {"hard": self.hard, "name": self._name(self.name)}
        return (HinfGain((self.reference,), (self.output,), self.peak_gain, **common),)  # type: ignore[arg-type]
