"""K_FSM and K_PMA together on the implemented loop: samples of the telescope, gains, noise.

The controllers' continuous state spaces are tuned as they will be sampled (bilinear), behind the washout of the
accelerometers, with one tick of delay; a camera value that is held between frames is the mean of the delays of one
frame period. So the tuned loop is that of :class:`los_loop.implemented_loop.ImplementedLoop`, and what is tuned is
what :class:`los_design.search.worst_case_search.Search` measures.

What is asked is :mod:`los_loop.figures_of_merit`, for the two stages, with what is tuned for as limits. The names of
the mirror alone have the suffix ``, alone``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property

import numpy as np

from fsm_pma_controller.problem import ORDER as ACTUATOR_ORDER
from lftkit.analysis.frequency_grid import logarithmic_grid
from lftkit.arrays import ComplexArray, FloatArray
from lftkit.systems.ports import Port, total_size
from lftkit.systems.sampled.bilinear import continuous_point
from lftkit.tuning.responses import (
    ControllerBlock,
    GrowingSamples,
    PlantSamples,
    ResponseGain,
    ResponseNoise,
    ResponseProblem,
)
from los_estimator.problem import ORDER as OBSERVER_ORDER
from los_loop.figures_of_merit import FigureOfMerit, gain_figures, noise_figures
from los_loop.implemented_loop import HIGHEST
from los_loop.open_loop import OpenLoop
from titop_plant.interface import (
    COLUMNS,
    COMMANDED,
    DT,
    MEASURED,
    MIRROR,
    MIRROR_STAGES,
)
from titop_plant.telescope.loop_ports import LoopPorts
from titop_plant.telescope.telescope import Telescope
from titop_plant.telescope.weights import rpe_weight

OBSERVER, ACTUATORS = 0, 1
ALONE, BOTH = (OBSERVER,), (OBSERVER, ACTUATORS)
STAGE_NAMES = dict(zip((ALONE, BOTH), MIRROR_STAGES))
COMMAND_COLUMNS = {name: COLUMNS[name] for name in COMMANDED}
ALONE_SUFFIX = ", alone"
LOWEST = 1e-4
"""Lowest frequency of the samples [rad/s]: poles that cross the origin show there."""
FINE, FINE_STEP = (120.0, 800.0), 0.003
"""Band of the structure's modes and the relative step of its grid."""
AROUND = np.arange(-4, 5) * 8e-4
"""Relative distances of the frequencies around a worst point."""
MODE_OFFSETS = (-5e-3, -2.5e-3, -1e-3, -3e-4, 3e-4, 1e-3, 2.5e-3, 5e-3)
"""The same around the telescope's own modes: below the band of the fine grid they are narrower than its steps."""
NOISE_FREQUENCIES = ((1e-2, 0.5, 60), (0.5, 20.0, 500), (20.0, 1000.0, 700), (1000.0, np.pi / DT, 120))
"""Bands [rad/s] and counts. What is below contributes nothing to the relative error, and to the absolute one some 2 %,
which the verification has."""


LEAST_DECAY = 5e-4
"""Of the controllers' own poles [rad/s]: they are stable without the loop, and no transient lasts for hours."""


def blocks(telescope: Telescope, tuned: Sequence[int]) -> tuple[ControllerBlock, ControllerBlock]:
    """The two controllers; those in `tuned` have free entries (no direct path from a held value to the estimate).

    Both measure with the sensors at places, behind their other inputs and the same washout; K_PMA commands the
    actuators at places.
    """
    mirror, rows = -1.0 / telescope.fsm.los_sensitivity, telescope.loop_ports
    observed, measured = (rows.of_design(name).measured for name in ("k_fsm", "k_pma"))

    def delay(omega: FloatArray) -> ComplexArray:
        return np.asarray(np.exp(-1j * omega * DT))

    estimates, forces = MIRROR.stop - MIRROR.start, rows.forces
    free = np.full((OBSERVER_ORDER + estimates, OBSERVER_ORDER + rows.measurements), OBSERVER in tuned)
    free[OBSERVER_ORDER:, OBSERVER_ORDER + rows.held] = False
    size = ACTUATOR_ORDER + forces.stop - forces.start, ACTUATOR_ORDER + total_size(measured)
    laws = np.full(size, ACTUATORS in tuned)
    return (
        ControllerBlock(
            "K_FSM",
            OBSERVER_ORDER,
            slice(0, rows.measurements),
            MIRROR,
            _bilinear,
            _filters(rows, observed),
            lambda omega: mirror * delay(omega),
            free,
            LEAST_DECAY,
        ),
        ControllerBlock(
            "K_PMA",
            ACTUATOR_ORDER,
            rows.measured_columns(measured),
            forces,
            _bilinear,
            _filters(rows, measured),
            delay,
            laws,
            LEAST_DECAY,
        ),
    )


def _bilinear(omega: FloatArray) -> ComplexArray:
    """The variable s of a controller that is sampled by the bilinear transformation."""
    return np.asarray(continuous_point(np.exp(1j * omega * DT), DT))


def _filters(rows: LoopPorts, ports: Sequence[Port]) -> Callable[[FloatArray], ComplexArray]:
    """Washout and hold of the values of some measured ports at N frequencies [rad/s], shape (N, values)."""
    chosen = [sensor for sensor in rows.sensors if sensor.port in ports]

    def at(omega: FloatArray) -> ComplexArray:
        factors: list[ComplexArray] = []
        for sensor in chosen:
            factor: ComplexArray = np.ones(len(omega), complex)
            if sensor.washout:
                factor = _bilinear(omega) / (_bilinear(omega) + sensor.washout)
            if sensor.framed:
                held = np.arange(sensor.ticks)
                factor = factor * np.mean(np.exp(-1j * omega[:, None] * DT * held), axis=1)
            factors += [factor] * sensor.port.size
        return np.stack(factors, axis=1)

    return at


def tuned_figures(stage: tuple[int, ...]) -> tuple[FigureOfMerit, ...]:
    """Gains of a stage in the order of the tuner: relative errors first, the upper band first."""

    def place(row: FigureOfMerit) -> tuple[bool, float]:
        low = row.band[0]
        return not row.relative, -math.inf if callable(low) else -low

    return tuple(sorted(gain_figures(STAGE_NAMES[stage]), key=place))


def limits(telescope: Telescope, stage: tuple[int, ...]) -> dict[str, float]:
    """What a gain of 1 stands for in a stage: shares of the budget [rad], and limits with what tuning leaves."""
    return {row.name: row.tuned_for(telescope, STAGE_NAMES[stage]) for row in tuned_figures(stage)}


def gains(telescope: Telescope, stages: Sequence[tuple[int, ...]]) -> tuple[ResponseGain, ...]:
    """What is asked of the stages; 1 is the entry of :func:`limits`."""
    window = telescope.weights.rpe_window

    def gain(stage: tuple[int, ...], row: FigureOfMerit) -> ResponseGain:
        limit, (low, high) = row.tuned_for(telescope, STAGE_NAMES[stage]), row.within(telescope, LOWEST, HIGHEST)

        def scale(omega: FloatArray) -> FloatArray:
            weight = rpe_weight(omega, window) if row.relative else np.ones(len(omega))
            return np.asarray(np.where((omega >= low) & (omega < high), weight / limit, 0.0))

        commands = {**COMMAND_COLUMNS, COMMANDED[1]: telescope.loop_ports.forces}
        outputs, inputs = commands.get(row.output), commands.get(row.inputs[0])
        return ResponseGain(named(row.name, stage), stage, outputs, inputs, scale, hard=row.hard)

    return tuple(gain(stage, row) for stage in stages for row in tuned_figures(stage))


def named(name: str, stage: tuple[int, ...]) -> str:
    """Name of a requirement of a stage."""
    return name if stage == BOTH else name + ALONE_SUFFIX


def noise_frequencies() -> FloatArray:
    """Frequencies [rad/s] at which the density of the noise is summed."""
    parts = [np.geomspace(low, high, count) for low, high, count in NOISE_FREQUENCIES]
    return np.asarray(np.unique(np.concatenate(parts))[:-1], dtype=float)


def noises(samples: Samples, stages: Sequence[tuple[int, ...]]) -> tuple[ResponseNoise, ...]:
    """Errors by sensor noise at the nominal point; they depend on the parameters by less than 1e-4."""
    telescope, nominal = samples.open_loop.telescope, samples.at_noise_frequencies
    omega, amplitude = nominal.omega, samples.open_loop.ports.noise_of_ticks

    def noise(stage: tuple[int, ...], row: FigureOfMerit) -> ResponseNoise:
        heard = amplitude.copy()
        for name in set(MEASURED) - set(row.inputs):
            heard[COLUMNS[name]] = 0.0
        density = np.broadcast_to(heard, (len(omega), len(heard)))
        step = np.gradient(omega) * (DT / np.pi)
        if row.relative:
            step = step * rpe_weight(omega, telescope.weights.rpe_window) ** 2
        limit = row.tuned_for(telescope, STAGE_NAMES[stage])
        return ResponseNoise(named(row.name, stage), stage, nominal, density, step, limit)

    return tuple(noise(stage, row) for stage in stages for row in noise_figures(STAGE_NAMES[stage]))


def sample(open_loop: OpenLoop, omega: FloatArray, points: FloatArray) -> PlantSamples:
    """Samples of all parameter points (N, 7) of the unit cube at all frequencies."""
    responses, ports = [], open_loop.ports
    for begin in range(0, len(omega), 50):
        responses += [open_loop.closed_over(lft, points) for lft in open_loop.at(omega[begin : begin + 50])]
    return PlantSamples(np.repeat(omega, len(points)), np.concatenate(responses), ports.measurements, ports.commands)


def grid(edge: float) -> FloatArray:
    """Frequencies [rad/s] at which every parameter point is sampled; `edge` is that of the bands."""
    low, high = FINE
    parts = [
        np.geomspace(0.02, edge, 160),
        np.geomspace(edge, low, 60),
        logarithmic_grid(low, high, FINE_STEP),
        np.geomspace(high, HIGHEST, 25),
    ]
    return np.asarray(np.unique(np.concatenate(parts)), dtype=float)


class Samples:
    """Samples that grow with the parameter points; what is there is not computed again.

    Parameters
    ----------
    open_loop : OpenLoop
    threads : int
        The result does not depend on their number.
    """

    def __init__(self, open_loop: OpenLoop, threads: int = 1) -> None:
        self.open_loop, self._threads = open_loop, threads
        nominal = open_loop.point({})
        low: FloatArray = np.asarray(np.geomspace(LOWEST, 0.02, 20), dtype=float)
        self._samples = GrowingSamples(sample(open_loop, low, nominal[None]))
        near = _near_modes(open_loop, nominal, FINE[0], HIGHEST)
        self._samples.append(sample(open_loop, near, nominal[None]))

    def add(self, points: FloatArray) -> None:
        """Parameter points (N, 7), each on the whole grid and at its slow modes."""
        self._samples.append(sample(self.open_loop, grid(self.open_loop.telescope.weights.band_edge), points))

        def at_modes(point: FloatArray) -> PlantSamples:
            return sample(self.open_loop, _near_modes(self.open_loop, point, 0.1, FINE[0]), point[None])

        with ThreadPoolExecutor(self._threads) as pool:
            for part in pool.map(at_modes, points):
                self._samples.append(part)

    def add_around(self, omega: float, point: FloatArray) -> None:
        """A worst point with the frequencies close to it."""
        self._samples.append(sample(self.open_loop, np.asarray(omega * (1.0 + AROUND), dtype=float), point[None]))

    @cached_property
    def at_noise_frequencies(self) -> PlantSamples:
        """Samples of the nominal point at the frequencies of :func:`noises`."""
        return sample(self.open_loop, noise_frequencies(), self.open_loop.point({})[None])

    def all(self) -> PlantSamples:
        """All samples."""
        return self._samples.all()


def _near_modes(open_loop: OpenLoop, point: FloatArray, low: float, high: float) -> FloatArray:
    """Frequencies around the modes of a parameter point."""
    modes = open_loop.modes(point, low, high)
    return np.sort(np.concatenate([modes * (1.0 + offset) for offset in MODE_OFFSETS]))


def pair_problem(
    samples: Samples, stages: Sequence[tuple[int, ...]], tuned: Sequence[int], threads: int = 1
) -> ResponseProblem:
    """The design problem of one or both controllers.

    Parameters
    ----------
    samples : Samples
    stages : sequence of {ALONE, BOTH}
        Whose requirements count.
    tuned : sequence of {OBSERVER, ACTUATORS}
    threads : int
    """
    telescope = samples.open_loop.telescope
    return ResponseProblem(
        blocks(telescope, tuned),
        samples.all(),
        gains(telescope, stages),
        noises(samples, stages),
        threads,
    )
