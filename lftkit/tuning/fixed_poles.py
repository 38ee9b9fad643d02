"""Poles that no controller moves: unreachable from the commands, or unseen in the measurements."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from lftkit.arrays import FloatArray
from lftkit.systems.system import System
from lftkit.tuning.problem import Problem

ROUNDING = 10 * np.finfo(float).eps
"""Singular value, relative to the norm and per state, that counts as zero."""
MARGIN = 1e-3
"""Share of the least decay by which a fixed pole must be faster: at the limit itself no step is possible."""


@dataclass(frozen=True)
class FixedPole:
    """A pole of a model [rad/s] that is the same in the loop with every controller.

    Attributes
    ----------
    model : str
    value : complex
    missing : str
        What does not reach it: ``commands`` or ``measurements``.
    """

    model: str
    value: complex
    missing: str

    def advice(self, min_decay: float) -> str:
        """What to do about it."""
        return (
            f"no controller moves the pole {_shown(self.value)} rad/s of {self.model or 'the model'}: the "
            f"{self.missing} do not reach it; every pole must be faster than min_decay = {min_decay:g} rad/s: give a "
            "smaller min_decay, make the pole of the weight faster, or change the model"
        )


def _shown(value: complex) -> str:
    return f"{value.real:.6g}" if not value.imag else f"{value.real:.6g} +- {abs(value.imag):.6g}j"


def slow_fixed_pole(problem: Problem) -> FixedPole | None:
    """The slowest fixed pole that is not faster than the least decay of a problem; None where there is none.

    By the test of Popov, Belevitch and Hautus: a pole s is fixed if [A - s I, B] of the commands or [A - s I; C] of the
    measurements has not the full rank.
    """
    found = [pole for model in problem.models for pole in _of(model, problem)]
    return max(found, key=lambda pole: pole.value.real, default=None)


def _of(model: System, problem: Problem) -> list[FixedPole]:
    if not model.order:
        return []
    commands = model.input_indices([port.name for port in problem.structure.outputs])
    measurements = model.output_indices([port.name for port in problem.structure.inputs])
    A, B, C = model.A, model.B[:, commands], model.C[measurements]
    found = []
    for value in linalg.eigvals(A):
        if value.real < -(1.0 + MARGIN) * problem.min_decay or value.imag < 0.0:
            continue
        shifted = A - value * np.eye(len(A))
        for missing, matrix in (("commands", np.hstack([shifted, B])), ("measurements", np.vstack([shifted, C]))):
            if _loses_rank(np.asarray(matrix)):
                found.append(FixedPole(model.name, complex(value), missing))
                break
    return found


def _loses_rank(matrix: FloatArray) -> bool:
    sizes = linalg.svdvals(matrix)
    return bool(sizes[-1] <= ROUNDING * len(sizes) * max(float(sizes[0]), np.finfo(float).tiny))
