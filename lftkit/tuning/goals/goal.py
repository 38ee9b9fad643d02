"""What a goal is: requirements on a model with further ports."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from lftkit.systems.ports import Port
from lftkit.systems.system import System
from lftkit.tuning.requirements import TuningRequirement


@runtime_checkable
class Goal(Protocol):
    """What becomes requirements on a model with further ports."""

    def prepared(self, model: System) -> System:
        """The model with the ports that the requirements name."""
        ...

    def requirements_on(self, model: System) -> tuple[TuningRequirement, ...]:
        """Requirements on the prepared model."""
        ...


def resolved(
    models: Sequence[System], goals: Sequence[TuningRequirement | Goal]
) -> tuple[tuple[System, ...], tuple[TuningRequirement, ...]]:
    """Models with the ports of all goals, and the requirements that the goals are."""
    if not models:
        raise InputError("a design needs at least one model, got none")
    for model in models:
        model.require_certain()
    ready = tuple(_prepared(model, goals) for model in models)
    requirements: list[TuningRequirement] = []
    for goal in goals:
        requirements += goal.requirements_on(ready[0]) if isinstance(goal, Goal) else (goal,)
    return ready, tuple(requirements)


def resolved_build(
    build: Callable[[Mapping[str, float]], System],
    goals: Sequence[TuningRequirement | Goal],
    example: Mapping[str, float],
) -> tuple[Callable[[Mapping[str, float]], System], tuple[TuningRequirement, ...]]:
    """As :func:`resolved` for models that are built from parameter values, `example` being some."""
    of_kind = tuple(goal for goal in goals if isinstance(goal, Goal))
    if not of_kind:
        return build, tuple(goal for goal in goals if not isinstance(goal, Goal))
    return PreparedBuild(build, of_kind), resolved([build(example)], goals)[1]


@dataclass(frozen=True)
class PreparedBuild:
    """Builds models with the ports of goals."""

    build: Callable[[Mapping[str, float]], System]
    goals: tuple[Goal, ...]

    def __call__(self, values: Mapping[str, float]) -> System:
        """Model at parameter values."""
        return _prepared(self.build(values), self.goals)


def _prepared(model: System, goals: Sequence[TuningRequirement | Goal]) -> System:
    for goal in goals:
        model = goal.prepared(model) if isinstance(goal, Goal) else model
    return model


def with_output(model: System, name: str, C: FloatArray, D: FloatArray) -> System:
    """The model with one more output; as it is if there is one of this name."""
    if any(p.name == name for p in model.outputs):
        return model
    outputs = (*model.outputs, Port(name, len(C)))
    C, D = np.vstack([model.C, C]), np.vstack([model.D, D])
    return System(model.A, model.B, C, D, model.inputs, outputs, model.name, dt=model.dt)
