"""The loop of a run under a part of its disturbances alone: its tones, one source, user code, sensor noise.

The loop is the one of the run as implemented; it is linear while no command is limited. So the lines of sight of all
parts add up to that of the run, tick by tick: tones and sensor bias start in their steady states, which add up to the
one that the run starts in, the other parts at rest.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from lftkit.arrays import FloatArray
from lftkit.support.threads import one_thread
from lftkit.systems.sampled.sampled_system import SampledSystem
from los_testbed.parts.run_parts import RunParts
from los_testbed.parts.start import RunStart
from los_testbed.run.loop.closed_loop import SampleBlock, SimulatedLoop
from pointing_analysis.indices.errors import default_transient
from titop_plant.disturbances.sources import Sources
from titop_plant.interface import DT, MIRROR_STAGES
from titop_plant.simulation.driven_plant import DisturbanceInput, held_disturbance
from titop_plant.simulation.plant import Plant
from titop_plant.simulation.source_matrix import source_matrix

NOISE = "sensor noise"
"""Name of the part with noise and bias of the sensors."""


@dataclass(frozen=True)
class Part:
    """A part of the disturbances of a run.

    Parameters
    ----------
    name, kind, place : str
    los : callable
        Line of sight [rad] under it alone from tick 0 on, shape (ticks, 2), by the number of ticks.
    """

    name: str
    kind: str
    place: str
    los: Callable[[int], FloatArray]


def parts_of(parts: RunParts) -> list[Part]:
    """All disturbances of a run: tones of the scenario, user's disturbance, sources, noise of the sensors.

    Parameters
    ----------
    parts : RunParts
        Of the run, with the start that is recorded.
    """
    config, sources = parts.config, []
    if config.scenario_acts:
        sources.append(Part(str(config.scenario), "scenario", "wheels, drives", lambda n: _started(parts, False, n)))
    if config.disturbance and config.disturbance_source:
        sources.append(Part(config.disturbance_source, "code", "wheels, drives, bus", lambda n: _of_code(parts, n)))
    sources += [
        Part(source.name, source.kind, source.place, lambda n, i=i: _of_source(parts, i, n))  # type: ignore[misc]
        for i, source in enumerate(parts.sources)
    ]
    if config.noise and config.loop in MIRROR_STAGES:
        sources.append(Part(NOISE, "noise", "sensors", lambda n: _started(parts, True, n)))
    return sources


def errors_of_source(parts: RunParts, index: int, ticks: int) -> FloatArray:
    """Line of sight under one source alone, from rest, without its start-up.

    Parameters
    ----------
    parts : RunParts
        Of the run.
    index : int
        Place of the source in ``parts.sources``.
    ticks : int
        Length of the simulation.

    Returns
    -------
    ndarray, shape (n, 2)
        [rad].
    """
    return _of_source(parts, index, ticks)[round(default_transient(ticks * DT) / DT) :]


def _of_source(parts: RunParts, index: int, ticks: int) -> FloatArray:
    alone, source = _quiet(parts), parts.sources[index : index + 1]
    with one_thread():
        family, telescope = alone.loop_family, _at_rest(alone)
        held = source_matrix(family, alone.settings, source, telescope.dt)
        driving = DisturbanceInput(held, Sources(source, telescope.dt), source[0].name)
        driven = replace(telescope, inputs=(driving,))
    return _simulated(alone, driven, ticks)


def _of_code(parts: RunParts, ticks: int) -> FloatArray:
    alone, disturbance = _quiet(parts), parts.disturbance()
    disturbance.reset()
    with one_thread():
        family, telescope = alone.loop_family, _at_rest(alone)
        held = held_disturbance(family, alone.settings, telescope.dt)
        driven = replace(telescope, inputs=(DisturbanceInput(held, disturbance, disturbance.name),))
    return _simulated(alone, driven, ticks)


def _started(parts: RunParts, noise: bool, ticks: int) -> FloatArray:
    """Under the noise and the bias of the sensors alone, or the scenario's tones alone, from their own steady state."""
    config = replace(parts.config, noise=noise, disturbance=not noise, disturbance_source=None, disturbance_files=None)
    alone = RunParts(config, _laws(parts), known_family=parts.family)
    start = RunStart(None if noise else parts.start.tone)
    if parts.start.steady and (laws := alone.linear) is not None:
        start = alone.find_start(laws, start.tone)
    alone = RunParts(config, _laws(parts), start, parts.family)
    with one_thread():
        family = alone.loop_family
        state = np.zeros(family.control_loop.order) if start.states is None else start.states.plant
        telescope = family.build(alone.physical, state)
    return _simulated(alone, telescope, ticks)


def _quiet(parts: RunParts) -> RunParts:
    """The loop at rest, without noise and disturbance."""
    config = replace(parts.config, start="rest", noise=False, disturbance=False)
    return RunParts(config, _laws(parts), known_family=parts.family)


def _laws(parts: RunParts) -> dict[str, SampledSystem] | None:
    """Controllers with separate states; None for code, which is created again."""
    return None if parts.code else {name: replace(law) for name, law in parts.models.items()}


def _at_rest(alone: RunParts) -> Plant:
    family = alone.loop_family
    return family.build(alone.settings, np.zeros(family.control_loop.order))


def _simulated(alone: RunParts, telescope: Plant, ticks: int) -> FloatArray:
    """True line of sight of the loop with this plant."""
    estimator, controller = alone.estimator(), alone.controller()
    for part in (telescope, estimator, controller):
        part.reset()
    los = np.zeros((ticks, 2))
    done = 0

    def keep(block: SampleBlock, rows: int) -> None:
        nonlocal done
        los[done : done + rows] = block.truth[:rows]
        done += rows

    with one_thread():
        first = None if alone.states is None else alone.states.command
        used = alone.used["k_fsm"], alone.used["k_pma"]
        SimulatedLoop(telescope, estimator, controller, alone.loop_ports, used, first).run(ticks, keep)
    return los
