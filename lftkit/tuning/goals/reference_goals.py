"""Goals for the response of an output to a reference: tracking, step response, overshoot."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lftkit.errors import InputError
from lftkit.support.scalars import as_positive
from lftkit.systems.arguments import checked
from lftkit.systems.connection.filters import transfer
from lftkit.systems.ports import Port
from lftkit.systems.system import System
from lftkit.tuning.goals.goal import with_output
from lftkit.tuning.requirements import H2Gain, HinfGain, TuningRequirement


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
            raise InputError(
                f"{self.output} and {self.reference} must have the same size, got {len(rows)} and {len(columns)}"
            )
        D = model.D[rows].copy()
        D[:, columns] -= np.eye(len(rows))
        return with_output(model, name, model.C[rows], D)

    @property
    def _error(self) -> str:
        return f"{self.output}-{self.reference}"

    def _name(self, name: str) -> str:
        return name or f"{type(self).__name__} {self.reference} -> {self.output}"


@checked
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
            as_positive(getattr(self, name), name)

    def requirements_on(self, model: System) -> tuple[TuningRequirement, ...]:
        """One gain."""
        w, size = 2.0 / self.response_time, len(model.input_indices([self.reference]))
        weight = transfer([1.0, w], [self.peak_error, w * self.dc_error], size)
        common = {"weight_out": weight, "hard": self.hard, "name": self._name(self.name)}
        return (HinfGain((self.reference,), (self._error,), **common),)  # type: ignore[arg-type]


@checked
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
            as_positive(getattr(self, name), name)

    def prepared(self, model: System) -> System:
        """The model with an input for what the reference model says, and the output's difference from it."""
        name, modelled = self._ports
        if any(p.name == modelled for p in model.inputs):
            return model
        model = super().prepared(model)
        rows = model.output_indices([self.output])
        size, nothing = len(rows), np.zeros((len(model.D), len(rows)))
        B, D = np.hstack([model.B, np.zeros((model.order, size))]), np.hstack([model.D, nothing])
        inputs = (*model.inputs, Port(modelled, size))
        wide = System(model.A, B, model.C, D, inputs, model.outputs, model.name, dt=model.dt)
        return with_output(wide, name, model.C[rows], np.hstack([model.D[rows], -np.eye(size)]))

    @property
    def _ports(self) -> tuple[str, str]:
        """Difference of the output and the reference model's, and the latter."""
        return f"{self._error}.mismatch", f"{self._error}.modelled"

    def requirements_on(self, model: System) -> tuple[TuningRequirement, ...]:
        """One H2 norm, of the step through the plant and through the reference model."""
        size, dt, tau = len(model.input_indices([self.reference])), model.dt, self.time_constant
        one, leak = np.eye(size), 1e-3 / tau  # of the integrator in the weight of a step
        # states: integral, reference model; outputs: integral, what the model makes of it
        A, B = np.array([[-leak, 0.0], [1.0 / tau, -1.0 / tau]]), np.array([[1.0], [0.0]])
        C, D = np.diag([1.0, 1.0]), np.array([[0.0], [0.0]])
        square = 0.5 * tau  # of (1 - M) / s = tau / (tau s + 1)
        if dt:  # the reference model is held between samples, integrals are sums
            left, decay = float(np.exp(-leak * dt)), float(np.exp(-dt / tau))
            A, B = np.array([[left, 0.0], [(1.0 - decay) * dt * left, decay]]), np.array([[1.0], [(1.0 - decay) * dt]])
            C, D = np.diag([dt * left, 1.0]), np.array([[dt], [0.0]])
            square = dt / (1.0 - decay**2)
        outputs, direct = (np.vstack([np.kron(one, M[[row]]) for row in (0, 1)]) for M in (C, D))
        ports = (Port("step", size),), (Port("both", 2 * size),)
        weight = System(np.kron(one, A), np.kron(one, B), outputs, direct, *ports, "step", dt=dt)
        bound = self.relative_gap * float(np.sqrt(square * size))
        mismatch, modelled = self._ports
        common = {"weight_in": weight, "hard": self.hard, "name": self._name(self.name)}
        return (H2Gain((self.reference, modelled), (mismatch,), bound, **common),)  # type: ignore[arg-type]


@checked
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
            raise InputError(f"percent must be between 0 and 100, got {self.percent}")

    @property
    def peak_gain(self) -> float:
        """Of the system of second order."""
        decay = -float(np.log(0.01 * self.percent))
        z = decay / float(np.hypot(np.pi, decay))
        return 1.0 if z >= np.sqrt(0.5) else 0.5 / (z * float(np.sqrt(1.0 - z * z)))

    def prepared(self, model: System) -> System:
        """The model as it is."""
        return model

    def requirements_on(self, model: System) -> tuple[TuningRequirement, ...]:
        """One gain."""
        common = {"hard": self.hard, "name": self._name(self.name)}
        return (HinfGain((self.reference,), (self.output,), self.peak_gain, **common),)  # type: ignore[arg-type]
