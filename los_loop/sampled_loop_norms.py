"""Pointing metrics of the implemented loop, from the sampled matrices: gains, noise, stability.

Independent of the tuner: the plant is sampled exactly, commands act one tick late, controllers are the sampled files.
A disturbance tone is not held but integrated over each tick, so its response at the ticks is exact at every frequency.
The zero-order hold of the values of slower sensors makes the loop periodic: a tone at w causes a response also at the
sidebands w + k w_period. Gains include the power of the sidebands, noise is the mean variance over a period, and
stability is that of the product of the one-tick matrices over a period. **The metrics of an unstable loop are
infinite.**
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import linalg

from lftkit import SampledSystem, System
from lftkit.analysis.batched_linalg import largest_gains
from lftkit.analysis.frequency_grid import frequency_grid
from lftkit.analysis.frequency_response import FrequencyResponse
from lftkit.arrays import ComplexArray, FloatArray
from los_loop.closing import sampled_loop
from los_loop.control_laws import ControlLaws
from los_loop.figures_of_merit import figure
from los_loop.noise import covariances, noise_rms
from los_loop.sampled_loop import SampledLoop
from los_loop.spec import LOS_ROWS, held_response
from titop_plant.interface import (
    DT,
    MIRROR_STAGES,
    TRUTH,
)
from titop_plant.simulation.modal_plant import ModalPlant
from titop_plant.telescope.telescope import Telescope
from titop_plant.telescope.weights import rpe_weight, weight_amplitudes

SIDEBANDS = 4
"""Sidebands of a sensor's rate that are included on each side."""


@dataclass(frozen=True)
class SampledLoopMetrics:
    """Largest values of one loop at one parameter point, normalised unless stated otherwise; infinite if unstable.

    Parameters
    ----------
    ape, rpe, rpe_fine : float
        Peak gain from normalised disturbances to the line of sight, over the limit of the APE; weighted with the window
        of the RPE, over its limits of the mirror alone and of both.
    mirror, force : float
        Peak gain to the commands, over 5.3 mrad and over 31.6 N.
    noise_ape, noise_rpe : float
        Line of sight due to sensor noise [rad rms, both axes], plain and weighted with the window of 20 ms; NaN where
        not asked for.
    radius : float
        Largest growth factor per tick (:meth:`SampledLoop.spectral_radius`); stable below 1.
    omega_rpe : float
        Frequency of the peak of `rpe` [rad/s]; NaN if unstable.
    """

    ape: float
    rpe: float
    rpe_fine: float
    mirror: float
    force: float
    noise_ape: float
    noise_rpe: float
    radius: float
    omega_rpe: float

    @property
    def stable(self) -> bool:
        """Whether every motion decays."""
        return self.radius < 1.0


def sampled_loop_metrics(
    plant: System,
    k_fsm: SampledSystem,
    k_pma: SampledSystem,
    telescope: Telescope,
    *,
    loop: str,
    noise: bool = True,
    sensors: str | None = None,
) -> SampledLoopMetrics:
    """All metrics of the implemented loop at one parameter point.

    Parameters
    ----------
    plant : System
        As for :func:`los_loop.closing.sampled_loop`.
    k_fsm, k_pma : SampledSystem
    telescope : Telescope
        Telescope parameters (weights, sensors, authority).
    loop : {"isolator", "fsm", "fsm+pma"}
    noise : bool
        Compute the noise metrics too (a Lyapunov equation).
    sensors : {None, "platform"}
        Noise of all sensors, or of the accelerometers of the payload base only.
    """
    sensitivity, ports = telescope.fsm.los_sensitivity, telescope.loop_ports.used_by(k_fsm, k_pma)
    closed = sampled_loop(plant, ControlLaws(k_fsm, k_pma, loop, ports, sensitivity))
    radius = closed.spectral_radius()
    if not radius < 1.0:
        inf = np.inf
        return SampledLoopMetrics(inf, inf, inf, inf, inf, inf, inf, radius, omega_rpe=np.nan)
    omega, response, relative = weighted_response(closed, plant, telescope)
    mirrors, both = MIRROR_STAGES
    ape, rpe, mirror, force = (figure(name) for name in ("APE", "RPE", "mirror", "force"))
    parts = [response[:, ports.rows_of(row.output)] for row in (ape, mirror, force)]
    los = float(largest_gains(parts[0]).max())
    angle, push = (float(np.linalg.norm(part, ord=2, axis=(1, 2)).max()) for part in parts[1:])
    worst = float(relative.max())
    rms = noise_rms(covariances(closed, telescope, sensors)) if noise else (float("nan"), float("nan"))
    return SampledLoopMetrics(
        los / ape.limit(telescope, both),
        worst / rpe.limit(telescope, mirrors),
        worst / rpe.limit(telescope, both),
        angle / mirror.limit(telescope, both),
        push / force.limit(telescope, both),
        *rms,
        radius,
        float(omega[relative.argmax()]),
    )


def weighted_response(
    loop: SampledLoop, plant: System, telescope: Telescope, low: float = 1e-2
) -> tuple[FloatArray, ComplexArray, FloatArray]:
    """Frequencies [rad/s], response to normalised disturbances (k, 10, 22), and the relative error's gain [rad].

    The gain is the largest root mean square of the weighted line of sight over the frame period, times the square
    root of 2: the amplitude of a tone of that power.
    """
    omega = loop_grid(plant, loop.free, low)
    return omega, *weighted_gains(loop, plant, telescope, omega)


def weighted_gains(
    loop: SampledLoop, plant: System, telescope: Telescope, omega: FloatArray
) -> tuple[ComplexArray, FloatArray]:
    """What :func:`weighted_response` gives, at the frequencies `omega` (k,) [rad/s]."""
    tone = tone_response(loop, plant, omega)
    size = weight_amplitudes(telescope, omega)[:, None, :]
    window = telescope.weights.rpe_window
    weight = rpe_weight(omega, window)[:, None, None]
    stack = [weight * tone.fundamental[:, LOS_ROWS] * size]
    if tone.camera is not None:
        stack.append(tone.sideband_root(omega, window) @ tone.camera * size)
    relative = np.linalg.norm(np.concatenate(stack, axis=1), ord=2, axis=(1, 2))
    return np.asarray(tone.fundamental * size), np.asarray(relative)


def loop_grid(
    plant: System | ModalPlant, A: FloatArray, low: float = 1e-2, high: float = 3e3, modes: ToneModes | None = None
) -> FloatArray:
    """Frequencies refined at the modes of the plant and of the closed loop [rad/s]; `modes` if they are known."""
    if modes:
        poles, multipliers = modes.plant.poles, modes.loop.poles
    else:
        alone = plant.response.poles if isinstance(plant, ModalPlant) else linalg.eigvals(plant.A)
        poles, multipliers = (np.asarray(found, dtype=complex) for found in (alone, linalg.eigvals(A)))
    closed = np.log(multipliers + 1e-300) / DT
    return frequency_grid(np.concatenate([poles, closed]), low, high, points=150, offsets=(0.0, 3.0))


@dataclass(frozen=True)
class ToneResponse:
    """Response to tones ``exp(i w t)`` on the 22 disturbance inputs.

    Parameters
    ----------
    fundamental : ndarray, shape (k, 10, 22)
        Line of sight (2) and commands (8) at w.
    camera : ndarray, shape (k, c, 22), or None
        Held values at their samples: of each port that is held its components at the frequencies that differ at its
        samples, see :func:`tone_response`; with one camera c = 2. None where every tick has a sample.
    sidebands : list of (shift, gain)
        Line of sight at w + shift [rad/s] due to the held values, gains of shape (k, 2, c).
    """

    fundamental: ComplexArray
    camera: ComplexArray | None
    sidebands: list[tuple[float, ComplexArray]]

    def sideband_root(self, omega: FloatArray, window: float) -> ComplexArray:
        """Matrix (k, c, c) whose product with the held values has the power of all sidebands, as relative error."""
        size = 0 if self.camera is None else self.camera.shape[1]
        power = np.zeros((omega.size, size, size), complex)
        for shift, gain in self.sidebands:
            weighted = rpe_weight(np.abs(omega + shift), window)[:, None, None] * gain
            power += weighted.conj().swapaxes(1, 2) @ weighted
        values, vectors = np.linalg.eigh(power)
        return np.asarray(np.sqrt(np.maximum(values, 0.0))[:, :, None] * vectors.conj().swapaxes(1, 2))


def disturbance_response(loop: SampledLoop, plant: System, omega: FloatArray) -> ComplexArray:
    """Line of sight (2) and commands (u) at the frequency of tones on the m inputs, shape (k, 2 + u, m), complex."""
    return tone_response(loop, plant, omega).fundamental


@dataclass(frozen=True)
class ToneModes:
    """Loop and plant in forms in which their responses are cheap, for several calls of :func:`tone_response`.

    Parameters
    ----------
    plant : FrequencyResponse
        Of the continuous plant alone: disturbances to measurements (y) and line of sight (2).
    loop : FrequencyResponse
        Of the loop at a tick without held values: from what is added to the measurement (y), and the held values, to
        line of sight (2), commands (u) and the held values at their samples.
    sensed, whole : int
        Values of the measurement; rows of line of sight and commands.
    """

    plant: FrequencyResponse
    loop: FrequencyResponse
    sensed: int
    whole: int

    @classmethod
    def of(cls, loop: SampledLoop, plant: System | ModalPlant) -> ToneModes:
        """Of a loop and its continuous plant, each in its own coordinates."""
        n, size = loop.plant_order, loop.hold.shape[0] - loop.ports.held.size
        A, N = (matrix[:size] for matrix in loop.at(1))  # with the sensors that have a sample at every tick
        # Places of the values that are held beyond a tick among all held values
        parts = [np.arange(loop.ports.held.size)[part] for part, _, _ in _components(loop)]
        kept = size + (np.concatenate(parts) if parts else np.arange(0))
        commands, sensed = loop.commands, N.shape[1]
        outputs = np.zeros((LOS_ROWS.stop + commands, size))
        outputs[LOS_ROWS], outputs[LOS_ROWS.stop :, n : n + commands] = loop.truth[:, :size], np.eye(commands)
        C, B = np.vstack([outputs, loop.frame[kept, :size]]), np.hstack([N, A[:, kept]])
        D = np.zeros((len(C), B.shape[1]))
        D[LOS_ROWS.stop + commands :, :sensed] = loop.noise_frame[kept]
        if isinstance(plant, ModalPlant):
            alone = plant.response
        else:
            B_d, D_d = plant.B[:, commands:], plant.D[:, commands:]
            alone = FrequencyResponse.of(plant.A, B_d, plant.C, D_d, check=False)
        return cls(alone, FrequencyResponse.of_sampled(A[:, :size], B, C, D), sensed, len(outputs))

    @cached_property
    def without_commands(self) -> ToneModes:
        """The same with the line of sight as the only output."""
        rows = [*range(LOS_ROWS.stop), *range(self.whole, len(self.loop.D))]
        return replace(self, loop=self.loop.part(rows, slice(None)), whole=LOS_ROWS.stop)

    @cached_property
    def sides(self) -> FrequencyResponse:
        """Of the loop, from the held values to line of sight (2) and the held values at their samples."""
        rows = [*range(LOS_ROWS.stop), *range(self.whole, len(self.loop.D))]
        return self.loop.part(rows, slice(self.sensed, None))


def tone_response(
    loop: SampledLoop,
    plant: System | ModalPlant,
    omega: FloatArray,
    modes: ToneModes | None = None,
    commands: bool = True,
) -> ToneResponse:
    """Response at the ticks, the zero-order-hold values closed around the rest of the loop; `modes` if they are known.

    Without `commands` the fundamental is that of the line of sight alone, in a third of the time.

    A tone at w makes signals at ``w + l w_N`` with the frequency ``w_N`` of the period of N ticks. A sensor with a
    sample every n ticks sees those alike whose l differ by a multiple of ``N / n``: its samples have ``N / n``
    components, each of which is held and so makes n signals. The components of all sensors are one linear system.

    Sidebands of a component beyond the :data:`SIDEBANDS`-th on each side are omitted; the hold attenuates them. With at
    most ``2 SIDEBANDS + 1`` ticks from sample to sample all of them are included and the response is exact.
    """
    period, held = loop.frame_ticks, _components(loop)
    modes = modes or ToneModes.of(loop, plant)
    if not commands:
        modes = modes.without_commands
    z = np.exp(1j * omega * DT)
    alone, closed = modes.plant.at(omega), modes.loop.at_points(z)
    # the loop answers what the tone does to the measurement as it answers noise
    forced = closed[:, :, : modes.sensed] @ alone[:, :-TRUTH]
    forced[:, LOS_ROWS] += alone[:, -TRUTH:]
    whole = slice(0, modes.whole)
    if not held:
        return ToneResponse(forced, None, [])
    places, own = _places(held), np.cumsum([0, *(part.stop - part.start for part, _, _ in held)])
    total = sum(place.stop - place.start for place in places.values())
    loop_gain = np.zeros((omega.size, total, total), complex)
    sidebands: dict[int, ComplexArray] = {}
    for (s, m), place in places.items():
        ticks, classes = held[s][1:]
        sides = modes.sides.part(slice(None), slice(own[s], own[s + 1]))
        count = min(2 * SIDEBANDS + 1, ticks)  # a signal of the tick rate has no more than `ticks` different sidebands
        for k in range(-(count // 2), count - count // 2):
            side = (m + classes * k + period // 2) % period - period // 2
            zk = np.exp(1j * (omega + 2.0 * np.pi * side / (period * DT)) * DT)
            hold = held_response(zk, ticks)[:, None, None]
            gain = sides.at_points(zk) * hold
            for r, (_, _, others) in enumerate(held):
                loop_gain[:, places[r, side % others], place] += gain[:, 2 + own[r] : 2 + own[r + 1]]
            if side:
                sidebands.setdefault(side, np.zeros((omega.size, 2, total), complex))[:, :, place] += gain[:, :2]
    seen = np.zeros((omega.size, total, forced.shape[2]), complex)
    for s in range(len(held)):
        seen[:, places[s, 0]] = forced[:, whole.stop + own[s] : whole.stop + own[s + 1]]
    camera: ComplexArray = np.asarray(np.linalg.solve(np.eye(total) - loop_gain, seen), dtype=np.complex128)
    holds = [held_response(z, ticks)[:, None, None] * camera[:, places[s, 0]] for s, (_, ticks, _) in enumerate(held)]
    fundamental = forced[:, whole] + closed[:, whole, modes.sensed :] @ np.concatenate(holds, axis=1)
    return ToneResponse(
        fundamental, camera, [(2.0 * np.pi * side / (period * DT), gain) for side, gain in sidebands.items()]
    )


def _components(loop: SampledLoop) -> list[tuple[slice, int, int]]:
    """Of each port without a sample at every tick: part of the held values, ticks of a sample, components of it."""
    parts, period = loop.ports.held_parts, loop.ports.period
    return [(parts[name], n, period // n) for name, n in loop.ports.ticks.items() if n > 1]


def _places(held: list[tuple[slice, int, int]]) -> dict[tuple[int, int], slice]:
    """Place of each component (number of the port, number of its component) in the vector of all of them."""
    places, start = {}, 0
    for s, (part, _, classes) in enumerate(held):
        for m in range(classes):
            places[s, m] = slice(start, start := start + part.stop - part.start)
    return places
