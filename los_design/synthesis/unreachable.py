"""Limits that no controller can keep, found before a design begins.

Two lower bounds for each stage, for the relative and for the absolute error, at the nominal telescope:

* **conflict**: sensor noise against tones. A tone of the normalised disturbances is a noise in a narrow band that keeps
  the limits of the band as tones do; so all figures are root mean squares, of which no linear controller of any order
  makes the largest less than :func:`lftkit.synthesis.shared_h2.shared_bound`. The controller has all measurements of
  the loop at every tick without their washout and hold, and commands act a tick later: better than any that is tuned.
* **reach**: at one frequency, what the commands do to the line of sight within their authorities.

Both are relative to what is tuned for (:mod:`los_loop.figures_of_merit`): above 1 a design is in vain.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from scipy import linalg
from scipy.signal import find_peaks

from lftkit import Port, System, transfer
from lftkit.analysis.batched_linalg import largest_gains, solve
from lftkit.arrays import ComplexArray, FloatArray, IntArray
from lftkit.errors import InputError
from lftkit.synthesis.shared_h2 import Noise, SampledPlant, SharedBound, shared_bound
from lftkit.systems.ports import port_slices
from lftkit.systems.sampling import discretise
from los_design.synthesis.pair_problem import LOWEST
from los_loop.figures_of_merit import FigureOfMerit, figures
from los_loop.implemented_loop import HIGHEST
from los_loop.open_loop import OpenLoop
from los_loop.spec import DISTURBANCE, LINE_OF_SIGHT
from pointing_analysis.units import RAD_PER_ARCSEC, RAD_PER_MAS
from titop_plant.interface import COLUMNS, COMMANDED, DT, FORCE_STAGES, MEASURED, MIRROR, TRUTH
from titop_plant.telescope.control_plant import disturbances_of
from titop_plant.telescope.telescope import Telescope
from titop_plant.telescope.weights import relative_error_weight, rpe_weight, weight_amplitudes

TONES = 10
"""Bands of tones: those in which the line of sight without control is largest beside its limit."""
HIGHEST_TONE = 1000.0
"""Frequency up to which their bands are [rad/s]: what a hold adds to a tone is small."""
MARGIN = 0.02
"""Part by which a bound must exceed 1: the response of a tone that is held differs by less."""
DAMPING = 0.3
"""Relative width of a band."""
GRID, DENSITY = 800, 1500
NEWTON, LEAST_STEP, NEAR = 5, 0.1, 0.03
"""Steps to the part of the sensor noise with which a bound is 1, the least factor of one, and how near it is enough."""
LEAST_NOISE = 1e-3
"""Part below which sensor noise is not the reason."""
RELATIVE, ABSOLUTE = "relative error", "absolute error"
NOTED = 0.02
"""Weight of a noise or tone from which it is named."""


@dataclass(frozen=True)
class Unreachable:
    """Limits of a stage that no controller keeps.

    Parameters
    ----------
    stage : str
    names : tuple of str
        Figures of merit that are in conflict.
    factor : float
        Lower bound of the largest of them, 1 being what is tuned for: the limits must be larger by this factor.
    error : str
        Relative or absolute error.
    limit : float
        Its limit [rad].
    tones : tuple of float
        Frequencies that matter [rad/s].
    noise : float or None
        Part of the sensor noise with which the limits might be kept; None: noise is not the reason.
    """

    stage: str
    names: tuple[str, ...]
    factor: float
    error: str
    limit: float
    tones: tuple[float, ...]
    noise: float | None = None

    def __str__(self) -> str:
        at = ", ".join(f"{w:.3g}" for w in self.tones)
        size, unit = (RAD_PER_MAS, "mas") if self.error == RELATIVE else (RAD_PER_ARCSEC, "arcsec")
        text = (
            f"unreachable with {self.stage}: no linear controller of any order keeps {', '.join(self.names)}; the "
            f"least is {self.factor:.3g} times what is tuned for (tones at {at} rad/s). The limit of the {self.error} "
            f"must be at least {self.factor * self.limit / size:.3g} {unit}, got {self.limit / size:.3g} {unit}"
        )
        return text if self.noise is None else f"{text}, or sensor noise at most {self.noise:.2g} times what it is"


@dataclass(frozen=True)
class StageBounds:
    """Bounds of a stage for one of the errors.

    Parameters
    ----------
    open_loop : OpenLoop
        Of the telescope with all sensors and actuators of its file.
    stage : str
        Name of a stage with fine control.
    relative : bool
        The relative or the absolute error.
    deadline : float
        Of :func:`time.monotonic` [s]; a bound that is found by then counts.
    """

    open_loop: OpenLoop
    stage: str
    relative: bool
    deadline: float = np.inf

    @property
    def error(self) -> str:
        """Name of the error."""
        return RELATIVE if self.relative else ABSOLUTE

    @property
    def telescope(self) -> Telescope:
        """The telescope."""
        return self.open_loop.telescope

    def _rows(self, noise: bool) -> list[FigureOfMerit]:
        rows = [row for row in figures(self.stage) if row.is_noise == noise and row.relative == self.relative]
        return [row for row in rows if noise or row.is_error]

    def limits(self, omega: FloatArray) -> FloatArray:
        """Least of the limits of tones at N frequencies [rad]; infinite where there is none."""
        least: FloatArray = np.full(len(omega), np.inf)
        for row in self._rows(noise=False):
            low, high = row.band_of(self.telescope)
            inside = (omega >= low) & (omega < high)
            least[inside] = np.minimum(least[inside], row.tuned_for(self.telescope, self.stage))
        return least

    @property
    def limit(self) -> float:
        """The limit of the error, of which the figures have shares [rad]."""
        return float(self._rows(noise=False)[0].limit(self.telescope, self.stage))

    @property
    def omega(self) -> FloatArray:
        """Frequencies [rad/s] at which the open loop is seen."""
        return _nominal(self.open_loop)[0]

    @cached_property
    def responses(self) -> ComplexArray:
        """From disturbances and commands to the line of sight (weighted) at these frequencies, shape (N, 2, m + u)."""
        omega, nominal = _nominal(self.open_loop)
        return (
            nominal * rpe_weight(omega, self.telescope.weights.rpe_window)[:, None, None] if self.relative else nominal
        )

    def reach(self) -> Unreachable | None:
        """Tones that the commands do not lower to their limit within their authorities."""
        corrected, names = np.zeros(len(self.omega)), []
        for row in figures(self.stage):
            if row.inputs == (DISTURBANCE,) and row.output in self._commands:
                by_command = largest_gains(self.responses[:, :, self._commands[row.output]])
                corrected += by_command * row.tuned_for(self.telescope, self.stage)
                names.append(row.name)
        factors = largest_gains(self._by_disturbances) / (self.limits(self.omega) + corrected)
        worst = int(np.argmax(factors))
        return self._unreachable(float(factors[worst]), self.omega[worst : worst + 1], names)

    def conflict(self) -> Unreachable | None:
        """Tones and sensor noise that no controller keeps below their limits together."""
        if not self._excess.max() > 1.0:  # kept without control
            return None
        plant, tones = self.plant_with_noises()
        bound = shared_bound(plant, self._decided)
        matter = bound.weights > NOTED
        names = [row.name for row, named in zip(self._rows(noise=True), matter[len(tones) :], strict=True) if named]
        unreachable = self._unreachable(bound.value, tones[matter[: len(tones)]], names)
        if unreachable is None and bound.reached.max() > 1.0 and self._out_of_time(bound):
            raise TimeoutError("the time limit is over")
        return (
            unreachable
            if unreachable is None
            else replace(unreachable, noise=self._allowed_noise(plant, bound, len(tones)))
        )

    def _decided(self, bound: SharedBound) -> bool:
        """Whether no bound above 1 will be found."""
        return bool(bound.reached.max() <= 1.0) or self._out_of_time(bound)

    def _out_of_time(self, bound: SharedBound) -> bool:
        return time.monotonic() >= self.deadline

    def _allowed_noise(self, plant: SampledPlant, bound: SharedBound, tones: int) -> float | None:
        """Part of the sensor noise with which a controller just reaches 1, by Newton's method in logarithms."""
        part, sensors = 1.0, plant.noises[tones:]
        for _ in range(NEWTON):
            share = float(bound.weights[tones:] @ (bound.reached[tones:] / bound.value) ** 2)
            part *= max(bound.value ** (-1.0 / max(share, 1e-3)), LEAST_STEP)
            if part < LEAST_NOISE:
                return None
            noises = (*plant.noises[:tones], *(replace(one, measurement=part * one.measurement) for one in sensors))
            try:
                bound = shared_bound(replace(plant, noises=noises), self._out_of_time, bound.weights)
            except (ArithmeticError, linalg.LinAlgError):  # equations of nearly exact measurements
                return None
            if abs(bound.value - 1.0) <= NEAR:
                break
        return part if bound.reached.max() <= 1.0 + 2.0 * NEAR else None

    def _unreachable(self, factor: float, tones: FloatArray, others: Sequence[str]) -> Unreachable | None:
        if not factor > 1.0 + MARGIN:
            return None
        rows = [(row, *row.band_of(self.telescope)) for row in self._rows(noise=False)]
        names = [row.name for row, low, high in rows if np.any((tones >= low) & (tones < high))]
        at = tuple(tones.tolist())
        return Unreachable(self.stage, (*names, *others), factor, self.error, self.limit, at)

    @property
    def _excess(self) -> FloatArray:
        """Line of sight without control, over the limits."""
        return largest_gains(self._by_disturbances) / self.limits(self.omega)

    @property
    def _by_disturbances(self) -> ComplexArray:
        return self.responses[:, :, : self.open_loop.disturbances]

    @property
    def _commands(self) -> dict[str, slice]:
        """Columns of the responses for the commands of the stage."""
        m, ports = self.open_loop.disturbances, self.open_loop.ports
        columns = {COMMANDED[0]: MIRROR}
        if self.stage in FORCE_STAGES:
            columns[COMMANDED[1]] = ports.forces
        return {name: slice(m + part.start, m + part.stop) for name, part in columns.items()}

    def plant_with_noises(self) -> tuple[SampledPlant, FloatArray]:
        """The sampled telescope with tones as noises in bands, then sensor noise, each over its limit.

        Returns
        -------
        (SampledPlant, ndarray)
            With the frequencies of the tones [rad/s].
        """
        excess = np.where(self.omega < HIGHEST_TONE, self._excess, 0.0)
        maxima = find_peaks(excess)[0]
        peaks = sorted(maxima[np.argsort(-excess[maxima])][:TONES].tolist()) or [int(np.argmax(excess))]
        A, B, disturbed, C, direct, M, seen = self._loop()
        bands = [self._band(k) for k in peaks]
        states = linalg.block_diag(*(band.A for band in bands))
        tones, into = np.hstack([band.C for band in bands]), linalg.block_diag(*(band.B for band in bands))
        n, k = len(A), len(states)
        process = np.vstack([np.zeros((n, into.shape[1])), into])
        noises = [Noise(process[:, 2 * at : 2 * at + 2], np.zeros(len(M))) for at in range(len(peaks))]
        noises += [Noise(np.zeros((n + k, 0)), self._sensor_noise(row)) for row in self._rows(noise=True)]
        plant = SampledPlant(
            np.block([[A, disturbed @ tones], [np.zeros((k, n)), states]]),
            np.vstack([B, np.zeros((k, B.shape[1]))]),
            np.hstack([C, direct @ tones]),
            np.hstack([M, seen @ tones]),
            tuple(noises),
        )
        return plant, self.omega[peaks]

    def _loop(self) -> tuple[FloatArray, ...]:
        """The sampled telescope: ``x+ = A x + B u + E d``, error ``C x + F d``, measurement ``M x + N d``.

        Commands act a tick late; d are the disturbances in their units.
        """
        system = discretise(self.open_loop.system.at({}), DT, method="hold")
        inputs, outputs = port_slices(system.inputs), port_slices(system.outputs)
        of_disturbances = np.concatenate([_indices(inputs[name]) for name in disturbances_of(system)])
        of_commands = np.setdiff1d(np.arange(system.B.shape[1]), of_disturbances)
        if self.stage not in FORCE_STAGES:
            of_commands = of_commands[MIRROR]
        los = _indices(outputs[LINE_OF_SIGHT])
        measured = np.setdiff1d(np.arange(len(system.C)), los)
        A, B, C, D = system.matrices
        n, late = len(A), len(of_commands)
        A = np.block([[A, B[:, of_commands]], [np.zeros((late, n + late))]])
        disturbed = np.vstack([B[:, of_disturbances], np.zeros((late, len(of_disturbances)))])
        C, D = np.hstack([C, D[:, of_commands]]), D[:, of_disturbances]
        into = np.vstack([np.zeros((n, late)), np.eye(late)])
        if not self.relative:
            return A, into, disturbed, C[los], D[los], C[measured], D[measured]
        weight = discretise(relative_error_weight(self.telescope.weights.rpe_window, len(los)), DT)
        w, (rows, states) = weight.matrices, (len(measured), weight.order)
        return (
            np.block([[A, np.zeros((len(A), states))], [w[1] @ C[los], w[0]]]),
            np.vstack([into, np.zeros((states, late))]),
            np.vstack([disturbed, w[1] @ D[los]]),
            np.hstack([w[3] @ C[los], w[2]]),
            w[3] @ D[los],
            np.hstack([C[measured], np.zeros((rows, states))]),
            D[measured],
        )

    def _sensor_noise(self, row: FigureOfMerit) -> FloatArray:
        """Standard deviation of a sample of each measured value, over the limit of the error by noise."""
        amplitude = self.open_loop.ports.noise_of_ticks
        for name in set(MEASURED) - set(row.inputs):
            amplitude[COLUMNS[name]] = np.finfo(float).eps * amplitude[COLUMNS[name]]
        return np.asarray(amplitude / row.tuned_for(self.telescope, self.stage))

    def _band(self, k: int) -> System:
        """From two white noises to the disturbances in their units, in a band about a frequency.

        Disturbances of this spectrum make a root mean square of at most 1 where each tone is within its limit.
        """
        centre = float(self.omega[k])
        direction = linalg.svd(self._by_disturbances[k])[2][0].conj()
        numerator, denominator = [2.0 * DAMPING * centre, 0.0], [1.0, 2.0 * DAMPING * centre, centre**2]
        held = discretise(transfer(numerator, denominator), DT, method="hold")
        omega: FloatArray = np.asarray(np.geomspace(LOWEST, HIGHEST, DENSITY), dtype=float)
        resolvents = np.exp(1j * omega * DT)[:, None, None] * np.eye(2) - held.A
        response = (held.C @ solve(resolvents, np.broadcast_to(held.B, (len(omega), 2, 1)).astype(complex)))[:, 0, 0]
        there, everywhere = (weight_amplitudes(self.telescope, at) for at in (centre, omega))
        size = np.divide(there, everywhere, out=np.zeros_like(everywhere), where=everywhere > 0.0)
        normalised = np.sum((np.abs(direction) * size) ** 2, axis=1)
        power = np.trapezoid(np.abs(response * self.limits(omega)) ** 2 * normalised, omega) * DT / np.pi
        both = np.column_stack([direction.real, direction.imag]) * there.T
        both = np.asarray(both, dtype=float)
        A, B, C = (np.asarray(np.kron(np.eye(2), M), dtype=float) for M in held.matrices[:3])
        ports = (Port("noise", 2),), (Port("disturbance", len(both)),)
        return System(A, B, both @ C / np.sqrt(power), np.zeros((len(both), 2)), *ports, "band", DT)


def unreachable_limits(
    open_loop: OpenLoop, stages: Iterable[str], report: Callable[[str], None], deadline: float = np.inf
) -> list[Unreachable]:
    """Limits of stages with fine control that no controller keeps, each reported as it is found.

    Where there is no bound (a telescope that is not stable without control, equations without a solution, no time), the
    reason is reported; without time the bounds that follow are left out.

    Parameters
    ----------
    open_loop : OpenLoop
    stages : iterable of str
    report : callable
    deadline : float
        Of :func:`time.monotonic` [s].
    """
    limits: list[Unreachable] = []
    for stage, relative in itertools.product(stages, (True, False)):
        bounds = StageBounds(open_loop, stage, relative, deadline)
        for bound in (bounds.reach, bounds.conflict):
            if time.monotonic() >= deadline:
                report(f"{stage}, {bounds.error}: no bound for all controllers within the time limit")
                return limits
            try:
                one = bound()
            except (ArithmeticError, InputError, TimeoutError, linalg.LinAlgError) as error:
                report(f"{stage}, {bounds.error}: no bound for all controllers, {error}")
                continue
            if one is not None:
                report(str(one))
                limits.append(one)
    return limits


@lru_cache(maxsize=1)
def _nominal(open_loop: OpenLoop) -> tuple[FloatArray, ComplexArray]:
    """Frequencies [rad/s], the telescope's modes among them, and the nominal line of sight there: of all stages."""
    point = open_loop.point({})
    modes = open_loop.modes(point, LOWEST, HIGHEST)
    omega: FloatArray = np.asarray(np.unique(np.concatenate([np.geomspace(LOWEST, HIGHEST, GRID), modes])), dtype=float)
    responses = [open_loop.closed_over(lft, point[None])[0, -TRUTH:] for lft in open_loop.at(omega)]
    return omega, np.asarray(responses)


def _indices(part: slice) -> IntArray:
    return np.arange(part.start, part.stop)
