"""Poles that no controller moves: unreachable from the commands, or unseen in the measurements."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from lftkit.systems.system import System
from lftkit.tuning.structures.structures import Structure

MIN_DECAY = 1e-6
"""Decay [rad/s] that every pole of a stable loop exceeds where no fixed pole is slower."""


@dataclass(frozen=True)
class FixedPole:
    """A pole of a model [rad/s] that is the same in the loop with every controller.

    Attributes
    ----------
    model : str
    value : complex
    missing : str
        What does not reach it: ``commands`` or ``measurements``.
    stable : bool
        Whether its real part is negative by more than `slowest` times the norm of the model.
    """

    model: str
    value: complex
    missing: str
    stable: bool

    def advice(self, min_decay: float) -> str:
        """What to do about it."""
        smaller, value = "give a smaller min_decay, " if self.stable else "", self.value
        shown = f"{value.real:.6g}" if not value.imag else f"{value.real:.6g} +- {abs(value.imag):.6g}j"
        return (
            f"no controller moves the pole {shown} rad/s of {self.model or 'the model'}: the "
            f"{self.missing} do not reach it; every pole must be faster than min_decay = {min_decay:g} rad/s: "
            f"{smaller}make the pole of the weight faster, or change the model"
        )


def least_decay(model: System, structure: Structure) -> float:
    """Decay [rad/s] that a loop of this model is asked for: `MIN_DECAY`, or half that of a slower stable fixed pole.

    Such a pole is that of a nearly integrating weight.
    """
    slowest = slow_fixed_pole([model], structure, MIN_DECAY)
    return -0.5 * slowest.value.real if slowest is not None and slowest.stable else MIN_DECAY


def slow_fixed_pole(
    models: Sequence[System],
    structure: Structure,
    min_decay: float,
    *,
    rounding: float = 1e-13,
    slowest: float = 1e-13,
    margin: float = 1e-3,
) -> FixedPole | None:
    """The slowest fixed pole of the models that is not faster than `min_decay` [rad/s]; None where there is none.

    By the test of Popov, Belevitch and Hautus: a pole s is fixed if [A - s I, B] of the commands or [A - s I; C] of the
    measurements has not the full rank.

    Parameters
    ----------
    models : sequence of System
    structure : Structure
    min_decay : float
        [rad/s]
    rounding : float
        Singular value, relative to the norm and per state, that counts as zero: of a fixed pole in other coordinates.
    slowest : float
        Decay, relative to the norm of a model, below which computed eigenvalues do not show that a loop is stable.
    margin : float
        Share of the least decay by which a fixed pole must be faster: at the limit itself no step is possible.
    """
    limits = -(1.0 + margin) * min_decay, rounding, slowest
    poles = [pole for model in models for pole in _of(model, structure, *limits)]
    return max(poles, key=lambda pole: pole.value.real, default=None)


def _of(model: System, structure: Structure, limit: float, rounding: float, slowest: float) -> list[FixedPole]:
    if not model.order:
        return []
    commands = model.input_indices([port.name for port in structure.outputs])
    measurements = model.output_indices([port.name for port in structure.inputs])
    A, B, C = model.A, model.B[:, commands], model.C[measurements]
    unsure, poles = slowest * float(linalg.norm(A)), []
    for value in linalg.eigvals(A):
        if value.real < limit or value.imag < 0.0:
            continue
        shifted = A - value * np.eye(len(A))
        for missing, matrix in (("commands", np.hstack([shifted, B])), ("measurements", np.vstack([shifted, C]))):
            sizes = linalg.svdvals(np.asarray(matrix))
            if sizes[-1] <= rounding * len(sizes) * max(float(sizes[0]), np.finfo(float).tiny):
                poles.append(FixedPole(model.name, complex(value), missing, bool(value.real < -unsure)))
                break
    return poles
