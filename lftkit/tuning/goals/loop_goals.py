"""Goals for the loop at commands or measurements of the controller: sensitivity, margins, loop gain.

Where a loop is looked at (`location`), a signal is added to it: ``u.added``; its sum with what the controller says (or
the plant measures) is ``u.applied``, and what comes back around the loop is ``u.returned``, their difference. With the
loop gain L of negative feedback, ``applied = S added`` and ``returned = -T added``, where ``S = (I + L)^-1`` and
``T = I - S``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy import linalg

from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from lftkit.systems.arguments import checked
from lftkit.systems.connection.filters import transfer
from lftkit.systems.ports import Port
from lftkit.systems.system import System
from lftkit.tuning.goals.goal import with_output
from lftkit.tuning.requirements import HinfGain, TuningRequirement
from lftkit.tuning.requirements.gains import as_weight


@dataclass(frozen=True)
class _AtLoop:
    """A goal for the loop at some commands or measurements."""

    location: tuple[str, ...]

    def __post_init__(self) -> None:
        location = (self.location,) if isinstance(self.location, str) else tuple(self.location)
        if not location:
            raise InputError("location must name at least one command or measurement of the controller, got none")
        object.__setattr__(self, "location", location)

    def prepared(self, model: System) -> System:
        """The model with ``added``, ``applied`` and ``returned`` at the location.

        Raises
        ------
        ValueError
            Neither an input nor an output of the model.
        """
        for name in self.location:
            model = _opened(model, name)
        return model

    def _ports(self, kind: str) -> tuple[str, ...]:
        return tuple(f"{name}.{kind}" for name in self.location)

    def _size(self, model: System) -> int:
        return len(model.input_indices(self._ports("added")))

    def _name(self, name: str) -> str:
        return name or f"{type(self).__name__} {'+'.join(self.location)}"


@checked
@dataclass(frozen=True)
class Sensitivity(_AtLoop):
    """Largest sensitivity S at a location, at most `bound` (times the weight's inverse).

    Parameters
    ----------
    location : tuple of str (or one str)
        Commands or measurements of the controller.
    bound : float
    weight : System, or what :func:`lftkit.systems.exchange.as_system` takes, optional
        Stable, of the size of the location or 1: ``weight S`` is at most `bound`.
    complementary : bool
        T instead of S.
    hard : bool
    name : str
    """

    bound: float = 1.0
    weight: System | None = None
    complementary: bool = False
    hard: bool = False
    name: str = ""

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "weight", as_weight(self.weight, "weight"))

    def requirements_on(self, model: System) -> tuple[TuningRequirement, ...]:
        """One gain."""
        weight = None if self.weight is None else _repeated(self.weight, self._size(model))
        out = self._ports("returned" if self.complementary else "applied")
        common = {"weight_out": weight, "hard": self.hard, "name": self._name(self.name)}
        return (HinfGain(self._ports("added"), out, self.bound, **common),)  # type: ignore[arg-type]


@checked
@dataclass(frozen=True)
class Margins(_AtLoop):
    """Disk margin at a location: gains and phases of all its loops change at once, independently.

    Parameters
    ----------
    location : tuple of str (or one str)
        With several the disk is that of the largest singular value, for changes that may couple the loops: margins of
        each loop by itself are goals of their own.
    gain_margin : float
        Factor above 1 by which a gain may rise or fall.
    phase_margin : float
        [deg]
    hard : bool
    name : str

    Notes
    -----
    The largest disk of skew 0 is of size ``alpha = 1 / ||S - I/2||``; it holds gains up to ``(2 + alpha)/(2 - alpha)``
    and phases up to ``2 atan(alpha / 2)`` (Seiler, Packard and Gahinet 2020). The value is the size that the margins
    ask for over that of the loop.

    Examples
    --------
    >>> round(Margins("u", gain_margin=3.0, phase_margin=0.0).size, 12)
    1.0
    """

    gain_margin: float = 1.0
    phase_margin: float = 0.0
    hard: bool = False
    name: str = ""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.gain_margin >= 1.0 or not 0.0 <= self.phase_margin < 180.0:
            raise InputError(
                "gain_margin must be at least 1 and phase_margin between 0 and 180 degrees, got "
                f"{self.gain_margin} and {self.phase_margin}"
            )
        if not self.size > 0.0:
            raise InputError("gain_margin or phase_margin must ask for something, got 1 and 0")

    @property
    def size(self) -> float:
        """Of the disk that has both margins."""
        gain = 2.0 * (self.gain_margin - 1.0) / (self.gain_margin + 1.0)
        return max(gain, 2.0 * float(np.tan(0.5 * np.deg2rad(self.phase_margin))))

    def requirements_on(self, model: System) -> tuple[TuningRequirement, ...]:
        """One gain."""
        middle = self._ports("middle")
        common = {"hard": self.hard, "name": self._name(self.name)}
        return (HinfGain(self._ports("added"), middle, 1.0 / self.size, **common),)  # type: ignore[arg-type]


@dataclass(frozen=True)
class _LoopGain(_AtLoop):
    """A goal for the loop gain, relative to that of an integrator, ``crossover / s``.

    A lower bound weighs what is ``applied``, an upper one what is ``returned``.
    """

    crossover: float = 1.0
    hard: bool = False
    name: str = ""

    bounds: ClassVar[tuple[str, ...]]

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (np.isfinite(self.crossover) and self.crossover > 0.0):
            raise InputError(f"crossover must be positive [rad/s], got {self.crossover}")

    def requirements_on(self, model: System) -> tuple[TuningRequirement, ...]:
        """One gain, of all bounds."""
        w = self.crossover
        # An integrator from 1e-4 times the crossover on, and a differentiator up to 1e4 times it
        integrator = transfer([w], [1.0, 1e-4 * w])
        weights = {"applied": integrator, "returned": transfer([1.0 / w, 0.0], [1.0 / (1e4 * w), 1.0])}
        parts = (_repeated(weights[kind], self._size(model)) for kind in self.bounds)
        out = tuple(port for kind in self.bounds for port in self._ports(kind))
        weight, name = _side_by_side(*parts), self._name(self.name)
        return (HinfGain(self._ports("added"), out, weight_out=weight, hard=self.hard, name=name),)


@checked
@dataclass(frozen=True)
class MinLoopGain(_LoopGain):
    """Loop gain at a location of at least ``crossover / omega`` where it is large: ``(crossover / s) S`` below 1.

    Parameters
    ----------
    location : tuple of str (or one str)
    crossover : float
        [rad/s]
    hard : bool
    name : str
    """

    bounds = ("applied",)


@checked
@dataclass(frozen=True)
class MaxLoopGain(_LoopGain):
    """Loop gain at a location of at most ``crossover / omega`` where it is small: ``(s / crossover) T`` below 1.

    Parameters
    ----------
    location, crossover, hard, name
        As in :class:`MinLoopGain`.
    """

    bounds = ("returned",)


@checked
@dataclass(frozen=True)
class LoopShape(_LoopGain):
    """Loop gain at a location like that of an integrator, ``crossover / s``: both bounds at once.

    The gain of ``[(crossover / s) S; (s / crossover) T]`` is 1 for that loop at all frequencies.

    Parameters
    ----------
    location, crossover, hard, name
        As in :class:`MinLoopGain`.
    """

    bounds = ("applied", "returned")


def _repeated(weight: System, size: int) -> System:
    """A weight of one signal for each of `size`; others as they are."""
    return weight if weight.D.shape != (1, 1) else _side_by_side(*(weight for _ in range(size)))


def _side_by_side(*weights: System) -> System:
    parts = [w.matrices for w in weights]
    n, m, p = sum(w.order for w in weights), *(sum(w.D.shape[k] for w in weights) for k in (1, 0))
    blocks = [linalg.block_diag(*(part[k] for part in parts)) for k in range(4)]
    shapes = ((n, n), (n, m), (p, n), (p, m))
    A, B, C, D = (np.asarray(block).reshape(shape) for block, shape in zip(blocks, shapes))
    return System(A, B, C, D, (Port("in", m),), (Port("out", p),), "weights")


def _opened(model: System, name: str) -> System:
    """The model with ``added``, ``applied``, ``returned`` and ``middle`` (their mean) at a command or a measurement."""
    if any(p.name == f"{name}.added" for p in model.inputs):
        return model
    commands, measurements = {p.name for p in model.inputs}, {p.name for p in model.outputs}
    if name not in commands | measurements:
        raise InputError(
            f"location must be an input or an output of {model.name}: {', '.join(sorted(commands | measurements))}; "
            f"got {name!r}"
        )
    B: FloatArray
    D: FloatArray
    C_own: FloatArray
    unit: FloatArray
    if name in commands:
        columns = model.input_indices([name])
        size = len(columns)
        unit = np.eye(model.D.shape[1])[columns]
        B, D, C_own = model.B[:, columns], model.D[:, columns], np.zeros((size, model.order))
    else:
        rows = model.output_indices([name])
        size, unit, C_own = len(rows), model.D[rows], model.C[rows]
        B, D = np.zeros((model.order, size)), np.eye(len(model.D))[:, rows]
    wide = System(
        model.A,
        np.hstack([model.B, B]),
        model.C,
        np.hstack([model.D, D]),
        (*model.inputs, Port(f"{name}.added", size)),
        model.outputs,
        model.name,
        dt=model.dt,
    )
    for kind, share in (("applied", 1.0), ("returned", 0.0), ("middle", 0.5)):
        wide = with_output(wide, f"{name}.{kind}", C_own, np.hstack([unit, share * np.eye(size)]))
    return wide
