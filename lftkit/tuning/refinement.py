"""Grids refined at the peaks of the certificate: the exact norms say what the tuner has missed between frequencies."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from lftkit.arrays import FloatArray
from lftkit.tuning.certificate import AGREEMENT, Certificate, certify
from lftkit.tuning.descent.minimax.minimax import DescentOptions
from lftkit.tuning.descent.single_start import StartResult, tune_from
from lftkit.tuning.problem import Problem
from lftkit.tuning.rounds import Worse, in_rounds
from lftkit.tuning.structures.structures import controller


def refined_runs(
    problem: Problem,
    runs: Sequence[StartResult],
    seed: int,
    limits: DescentOptions,
    band: float,
    refinements: int = 2,
) -> list[StartResult]:
    """Further runs from the best point, on grids refined at the peaks of the certificate that the tuner had missed."""
    design = _Certified(problem, min(runs, key=lambda run: run.rank), seed, limits, band)
    in_rounds(design, refinements + 1, deadline=limits.deadline)
    return design.added


def agree(certificate: Certificate, values: FloatArray) -> bool:
    """Whether both sides of a certificate are those of tuned values (requirements, models)."""
    known = np.isfinite(values)
    scale = np.maximum(np.abs(values[known]), 1e-6 * float(np.abs(values[known]).max(initial=0.0))) + 1e-9
    low, high = certificate.values[known] - values[known], certificate.upper[known] - values[known]
    return bool(np.all(np.maximum(np.abs(low), np.abs(high)) <= AGREEMENT * scale))


@dataclass
class _Certified:
    """Frequencies of the grids: worse are the peaks that the certificate finds beside them."""

    problem: Problem
    best: StartResult
    seed: int
    limits: DescentOptions
    band: float
    added: list[StartResult] = field(default_factory=list)

    def tuned(self, number: int) -> StartResult:
        """The best start, then others from it."""
        if number:
            self.best = tune_from(self.problem, self.best.x, self.seed, self.limits, self.band)
            self.added.append(self.best)
        return self.best

    def worse(self, number: int, tuned: StartResult, last: bool) -> Worse[FloatArray]:
        """Peak frequencies of the certificate (requirements,) of each model where it does not agree."""
        problem = self.problem
        if last or tuned.rank[0] == 2 or time.monotonic() > self.limits.deadline:
            return Worse(())
        evaluation = problem.evaluate(tuned.x, gradients=False)
        K = controller(problem.structure, tuned.x)
        certificate = certify(problem.models, K, problem.given, problem.loop_delay)
        if agree(certificate, evaluation.values[: len(problem.given)]) or not np.all(np.isfinite(certificate.values)):
            return Worse(())
        return Worse([certificate.peak_frequencies[list(problem.hinf), k] for k in range(len(problem.models))])

    def add(self, tuned: StartResult, worse: Worse[FloatArray]) -> None:
        """More frequencies."""
        for loop, omega in zip(self.problem.gains, worse.new):
            loop.add(omega)
