"""The implemented loop in the form of the proofs: its figures, its margins and its noise as models, its box.

See :mod:`los_design.verification.certify`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from lftkit import SampledSystem
from lftkit.analysis.eigenvectors import modal
from lftkit.arrays import FloatArray, IntArray
from lftkit.errors import InputError
from lftkit.proofs.sampled_loop import LoopModel
from lftkit.proofs.trusted.proof import Interval
from los_design.verification.error_sum import FAST, parts_of_band
from los_design.verification.frames import IMAGES, SEEN
from los_design.verification.frames import LIMITS as FRAME_LIMITS
from los_loop.angle_channels import kept_channels
from los_loop.implemented_loop import ImplementedLoop, LoopMetric, loop_metrics
from los_loop.open_loop import OpenLoop
from los_loop.spec import LOS_ROWS
from titop_plant.interface import COMMANDED, DT
from titop_plant.physical_settings import ANGLE
from titop_plant.sensors import TICKS_PER_SECOND, Sensor
from titop_plant.telescope.control_plant import loop_plant
from titop_plant.telescope.loop_ports import LoopPorts
from titop_plant.telescope.telescope import Telescope

Box = tuple[Interval, ...]
NYQUIST = math.pi / DT
HALVED, LATER = "gain x0.5", "one more tick"
RETURNED, LIMITS = {HALVED: 1, LATER: 2}, {HALVED: 2.0, LATER: 1.0}
"""Of margins that are no sensitivity: what is bounded (:class:`lftkit.proofs.sampled_loop.LoopModel`), and by what."""


def provable_open_loop(telescope: Telescope, k_fsm: SampledSystem, k_pma: SampledSystem) -> OpenLoop:
    """The telescope with the sensors and actuators that controllers use, for loops that can be proven.

    Raises
    ------
    ValueError
        As :func:`check_provable`.
    """
    check_provable(telescope, k_fsm, k_pma)
    ports = telescope.loop_ports.used_by(k_fsm, k_pma)
    return OpenLoop(loop_plant(telescope, ports), telescope, ports)


def check_provable(telescope: Telescope, k_fsm: SampledSystem, k_pma: SampledSystem) -> None:
    """Refuse controllers of which no loop can be proven.

    Raises
    ------
    ValueError
        Ports that the telescope does not have, or another period; a sensor slower than the tick at another rate than
        the camera: the proof of what is held has one such rate.
    """
    for name, law in (("k_fsm", k_fsm), ("k_pma", k_pma)):
        used = telescope.loop_ports.of_system(name, law)
        inputs, outputs = used.law_ports(name)
        law.with_inputs(inputs).require(inputs, outputs, DT)
        refuse_other_rates(used.sensors, telescope.frame_ticks)


def refuse_other_rates(sensors: Iterable[Sensor], frame_ticks: int) -> None:
    """Refuse sensors that are slower than the tick at another rate than the camera.

    Parameters
    ----------
    sensors : iterable of Sensor
        Of a loop that is to be proven.
    frame_ticks : int
        Ticks from one frame of the camera to the next.

    Raises
    ------
    ValueError
        The message names them.
    """
    other = [row.name for row in sensors if row.ticks not in (1, frame_ticks)]
    if other:
        raise InputError(
            f"sensors of a loop that is proven must have a sample at each tick or the rate of the camera, "
            f"{TICKS_PER_SECOND / frame_ticks:g} Hz, got {', '.join(other)}"
        )


def telescope_model(loop: ImplementedLoop, metric: LoopMetric) -> LoopModel:
    """The implemented loop with one figure, in the form of the proofs.

    Inputs are the normalised disturbances, or signals added to the commands of one port (a sensitivity).
    """
    if metric.name in FRAME_LIMITS:
        return frames_model(loop, metric.limit, opened=metric.name == IMAGES)
    los = LOS_ROWS
    commands = metric.rows != los
    first = metric.rows.start - (los.stop if commands else 0)
    rows = tuple(range(first, first + metric.rows.stop - metric.rows.start))
    window = loop.telescope.weights.rpe_window if metric.relative else 0.0
    if metric.disturbed:
        telescope = loop.telescope
        weights = telescope.weights
        wheels = [
            [a, weights.wheel_imbalance_zero, weights.wheel_imbalance_pole]
            for a in np.tile(weights.wheel_imbalance, len(telescope.turning_wheels))
        ]
        drives = [[bound, 1.0, 1.0] for bound in telescope.torque_bounds]
        inputs = np.array([*wheels, *drives], dtype=float)
        return _model(loop, inputs, None, window=window, rows=rows, scale=metric.limit, commands=commands)
    added = tuple(range(loop.ports.commands))[metric.columns]
    kind = RETURNED.get(metric.name.split(",")[0], 0)
    outcome = {"window": window, "rows": rows, "scale": metric.limit, "commands": commands}
    return _model(loop, np.ones((len(added), 3)), None, added=added, returned=kind, **outcome)


def noise_model(loop: ImplementedLoop) -> LoopModel:
    """The implemented loop from noise of the sensors at the ticks to the line of sight, over the limit of the APE.

    The samples of a sensor with frames count as if each tick had one
    (:meth:`titop_plant.telescope.loop_ports.LoopPorts.noise_of_ticks`): held, they have the same mean spectrum.
    """
    sigma = loop.ports.noise_of_ticks
    noisy = np.flatnonzero(sigma)
    inputs = np.column_stack([sigma[noisy], np.ones((len(noisy), 2))])
    limit = loop.telescope.weights.ape_limit
    rows = tuple(range(LOS_ROWS.stop))
    return _model(loop, inputs, noisy, window=0.0, rows=rows, scale=limit, commands=False)


def frames_model(loop: ImplementedLoop, limit: float, *, opened: bool) -> LoopModel:
    """The implemented loop from what is added to the camera's measurement to that measurement, before the hold.

    With the sum, in the closed loop (S of :mod:`los_design.verification.frames`); or without it and `opened`: what is
    added is all that the controllers see of the camera (L there, with the hold).
    """
    columns, every = loop.ports.columns, np.arange(loop.ports.measurements)
    seen = np.concatenate([every[columns[name]] for name, ticks in loop.ports.ticks.items() if ticks > 1])
    rows = tuple(range(len(seen)))
    model = _model(loop, np.ones((len(seen), 3)), seen, window=0.0, rows=rows, scale=limit, commands=False)
    q, y, _, d, _ = model.sizes
    C, D = model.C[q + seen], model.D[q + seen]
    C, D = np.vstack([model.C[: q + y], C]), np.vstack([model.D[: q + y], D])
    if opened:
        added = np.zeros((len(seen), D.shape[1]))
        added[:, q : q + d] = np.eye(len(seen))
        C[q + seen], D[q + seen] = 0.0, added
        D[q + y :] -= added
    return replace(model, C=C, D=D)


def _model(loop: ImplementedLoop, weights: FloatArray, noisy: IntArray | None, **outcome: Any) -> LoopModel:
    """The loop from disturbances, from noise of the measurements `noisy`, or from signals added to commands.

    Of the 32 occurrences of the arrays' angle 16 are left (:mod:`los_loop.angle_channels`).
    """
    system, commands = loop.system, loop.ports.commands
    names, q = system.channels, len(system.channels)
    if any(abs(p.nominal) > 0.0 for p in system.parameters if p.name == ANGLE):
        raise InputError(f"the nominal value of {ANGLE} must be 0")
    kept = kept_channels(system).tolist()
    rows = [*kept, *range(q, system.C.shape[0])]
    columns = [*kept, *range(q + commands, system.B.shape[1]), *range(q, q + commands)]
    poles, B, C = modal(system.A, system.B[:, columns], system.C[rows])
    K_poles, K_B, K_C, K_D = loop.control_laws.modes()
    order = [names[channel] for channel in kept]
    D, (first, last) = system.D[np.ix_(rows, columns)], (len(kept), len(columns) - commands)
    if outcome.get("added") or noisy is not None:
        B = np.hstack([B[:, :first], np.zeros((len(B), len(weights))), B[:, last:]])
        D = np.hstack([D[:, :first], np.zeros((len(D), len(weights))), D[:, last:]])
    if noisy is not None:
        D[first + noisy, first + np.arange(len(noisy))] = 1.0
    return LoopModel(
        DT,
        poles,
        C,
        B,
        D,
        K_poles,
        K_C,
        K_B,
        K_D,
        loop.control_laws.held_ticks,
        tuple(tuple(i for i, name in enumerate(order) if name == p.name) for p in system.parameters),
        tuple(p.name == ANGLE for p in system.parameters),
        weights,
        **outcome,
    )


def box_of(loop: ImplementedLoop) -> Box:
    """Deviations of the parameters from their nominal values; the angle of the arrays [rad]."""
    return tuple(
        (4.0 * math.atan(p.lower), 4.0 * math.atan(p.upper))
        if p.name == ANGLE
        else (p.lower - p.nominal, p.upper - p.nominal)
        for p in loop.system.parameters
    )


def figures_of(telescope: Telescope, stage: str, ports: LoopPorts) -> dict[str, LoopMetric]:
    """Figures of a stage that are proven; bands of the whole axis are from zero to half of the sampling rate.

    Parameters
    ----------
    telescope : Telescope
    stage : str
    ports : LoopPorts
        Rows of the loop.
    """
    metrics = loop_metrics(telescope, stage, ports, (0.0, NYQUIST))
    return {name: metric for name, metric in metrics.items() if metric.disturbed}


def margins_of(telescope: Telescope, stage: str, ports: LoopPorts) -> dict[str, LoopMetric]:
    """Margins of a stage that can be proven, each at the commands of one port, up to half of the sampling rate.

    ==========================  =====================================================================================
    name                        a gain below its limit means
    ==========================  =====================================================================================
    ``sensitivity, PORT``       disk margin one over its peak: the row of :mod:`los_loop.figures_of_merit`
    ``gain x0.5, PORT``         factors 0.5 to 1.5 of all commands of the port: the complementary sensitivity is below 2
    ``one more tick, mirror``   one more tick of delay: ``|1 - exp(-j w dt)|`` times the complementary one below 1
    ==========================  =====================================================================================

    At the forces one more tick breaks the last bound (near 2600 rad/s), though the loop bears it: the norm does not
    see the phase.
    """
    metrics = loop_metrics(telescope, stage, ports, (0.0, NYQUIST))
    margins = {name: metric for name, metric in metrics.items() if not metric.disturbed}
    for metric in list(margins.values()):
        port = metric.name.split(", ")[1]
        for kind in (HALVED, LATER) if metric.rows == telescope.loop_ports.rows_of(COMMANDED[0]) else (HALVED,):
            name = f"{kind}, {port}"
            margins[name] = replace(metric, name=name, limit=LIMITS[kind], band=(0.0, NYQUIST))
    return margins


def parts_near_edge(telescope: Telescope, stage: str, ports: LoopPorts) -> dict[str, LoopMetric]:
    """Parts of the fast tones' band that can have bounds of their own, by name."""
    fast = figures_of(telescope, stage, ports)[FAST]
    return {name: replace(fast, name=name, band=band) for name, band in parts_of_band(telescope).items()}


def frames_of(telescope: Telescope, stage: str, ports: LoopPorts) -> dict[str, LoopMetric]:
    """Gains that show what the camera's frames do to stability (:mod:`los_design.verification.frames`)."""
    if telescope.frame_ticks == 1:
        return {}
    edge, like = NYQUIST / telescope.frame_ticks, next(iter(margins_of(telescope, stage, ports).values()))
    bands = {SEEN: (0.0, edge), IMAGES: (edge, NYQUIST)}
    return {name: replace(like, name=name, limit=FRAME_LIMITS[name], band=band) for name, band in bands.items()}


def provable(telescope: Telescope, stage: str, ports: LoopPorts) -> dict[str, LoopMetric]:
    """All gains of a stage that can be proven: figures, margins, frames, parts of the fast tones' band."""
    asked = telescope, stage, ports
    return figures_of(*asked) | margins_of(*asked) | frames_of(*asked) | parts_near_edge(*asked)
