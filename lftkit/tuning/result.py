"""Result of every way to tune: given models, discrete ones, or a box of parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from lftkit.arrays import FloatArray
from lftkit.systems.system import System
from lftkit.tuning.certificate import Certificate
from lftkit.tuning.descent.grid_source import FEASIBLE
from lftkit.tuning.status import TuningStatus


@dataclass(frozen=True)
class WorstCase:
    """Worst value found for one requirement.

    Parameters
    ----------
    requirement : str
    value : float
        Normalised; infinite where the loop is unstable.
    parameters : mapping of str to float
        Where it happens.
    omega : float
        Frequency of the peak [rad/s].
    sampled : float
        Best value before the local ascents.
    evaluations : int
        Closed loops evaluated, for all requirements together.
    others : tuple of (value, parameters)
        The worst samples that have their peak at another frequency, worst first.
    """

    requirement: str
    value: float
    parameters: Mapping[str, float]
    omega: float
    sampled: float
    evaluations: int
    others: tuple[tuple[float, Mapping[str, float]], ...] = ()


@dataclass(frozen=True)
class Round:
    """One round: value on the tuned set and worst value found (soft and hard), models and seconds so far."""

    models: int
    soft: float
    hard: float
    worst_soft: float
    worst_hard: float
    seconds: float


@dataclass(frozen=True)
class Level:
    """Requirements of a lexicographic tuning that were held together, and the normalised value that they reached."""

    requirements: tuple[str, ...]
    value: float


@dataclass(frozen=True)
class TuningResult:
    """A tuned controller with its certificate; of a robust design also with what it was searched for.

    Parameters
    ----------
    status : TuningStatus
        Of a robust design ``converged`` means that nothing worse was found and the last tuning was ``converged`` or
        ``target``; otherwise it is the status of the last tuning, ``rounds`` or ``out_of_time``.
    advice : str
        What to do about it.
    controller : System
        Best point so far.
    x : ndarray, shape (size,)
        Its parameters.
    soft, hard : float
        Worst soft and hard values (normalised) over requirements and models; minus infinity where there are none.
    values : ndarray, shape (requirements, models)
        Those of the certificate where there is no delay (which it approximates): gains are reached, and at most
        ``certificate.upper`` is.
    peak_frequencies : ndarray, shape (requirements, models)
        Frequencies of the values [rad/s].
    abscissa : float
        Largest real part of the closed-loop poles [rad/s].
    stationarity : float
        Norm of the smallest convex combination of the nearly active scaled gradients.
    certificate : Certificate or None
        Norms and eigenvalues recomputed on the assembled closed loops; None where the loop is unstable.
    seconds : float
    evaluations, iterations : int
        Of all starts.
    starts : tuple of float
        Worst soft value at the end of every start and of every short descent, in order (infinite: failed, not
        stabilised or not feasible); of a robust design those of the first round.
    requirement_names : tuple of str
    at_bounds : tuple of str
        Parameters that ended at a bound of their own, or at the limit of all.
    worst : tuple of WorstCase
        Of a robust design: worst value found of every requirement over the whole box, with the parameters.
    active : tuple of mapping
        Of a robust design: parameter values of the models that were tuned, of which the values and the certificate are.
    rounds : tuple of Round
        Of a robust design.
    lower_bound : float
        Largest soft value below which no controller of any order comes, of one gain and one model alone; minus infinity
        where none is known (:mod:`lftkit.tuning.lower_bound`). Numerical, not proven.
    levels : tuple of Level
        Of a lexicographic tuning, from the most critical requirements on.
    """

    status: TuningStatus
    advice: str
    controller: System
    x: FloatArray
    soft: float
    hard: float
    values: FloatArray
    peak_frequencies: FloatArray
    abscissa: float
    stationarity: float
    certificate: Certificate | None
    seconds: float
    evaluations: int
    iterations: int
    starts: tuple[float, ...]
    requirement_names: tuple[str, ...] = field(default=())
    at_bounds: tuple[str, ...] = field(default=())
    worst: tuple[WorstCase, ...] = field(default=())
    active: tuple[Mapping[str, float], ...] = field(default=())
    rounds: tuple[Round, ...] = field(default=())
    levels: tuple[Level, ...] = field(default=())
    lower_bound: float = -np.inf

    @property
    def gap(self) -> float:
        """Relative distance of the largest soft value from the lower bound; infinite without one."""
        return self.soft / self.lower_bound - 1.0 if self.lower_bound > 0.0 else np.inf

    @property
    def feasible(self) -> bool:
        """All hard requirements met."""
        return self.hard <= 1.0 + FEASIBLE
