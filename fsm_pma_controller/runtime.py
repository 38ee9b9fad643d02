"""The steering-mirror and proof-mass laws at run time: one `step` per tick (numpy only)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Protocol

import numpy as np

from fsm_pma_controller.fade import FADE_TICKS, Fade
from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from lftkit.systems.ports import Port, total_size
from lftkit.systems.sampled.sampled_system import SampledSystem
from titop_plant.held_samples import HeldSamples
from titop_plant.interface import (
    COMMANDS,
    DT,
    FORCE_STAGES,
    FORCES,
    K_PMA_INPUTS,
    K_PMA_OUTPUTS,
    MIRROR,
    MIRROR_STAGES,
    STAGES,
)
from titop_plant.sensors import MEASURED_SENSORS, PLATFORM_PORT, Sensor, port_alone


class ForceLaw(Protocol):
    """Proof-mass law at run time; :class:`lftkit.systems.sampled.sampled_system.SampledSystem` is one."""

    @property
    def order(self) -> int:
        """Number of states."""

    def require(self, inputs: Iterable[Port], outputs: Iterable[Port], dt: float) -> None:
        """Raise a ValueError for other ports or another period [s] than its own."""

    def step(self, u: FloatArray, out: FloatArray, /) -> None:
        """Write the forces (6,) [N] of this tick; `u` (6,) is ``accel_Ip``; both with those of further devices."""

    def reset(self, state: FloatArray | None = None) -> None:
        """Back to the zero state, or to another `state` (order,)."""


class ForceActuator(Protocol):
    """A further actuator; :class:`titop_plant.telescope.actuators.Actuator` is one."""

    @property
    def port(self) -> Port:
        """Its force, an output of K_PMA."""

    @property
    def authority(self) -> float:
        """Largest force [N]."""


class FsmPmaController:
    """Mirror law ``u_fsm = -LOS_hat / los_sensitivity`` and proof-mass law ``u_pma = K_PMA accel_Ip``.

    ======== ============ ==== =========================================
    port     name         size content
    ======== ============ ==== =========================================
    input    los_estimate 2    output of the observer [rad]
    input    accel_Ip     6    twist derivative of the payload base
    output   fsm_command  2    mirror angles [rad]
    output   pma_force    6    forces of the proof-mass actuators [N]
    ======== ============ ==== =========================================

    **A positive LOS estimate drives the mirror to a negative angle.** Both outputs are saturated at
    the authority of their actuators. Stages without a loop give zeros on it. A change of the stage between two steps
    fades the outputs of a loop in or out, so that no command steps. A law of the user may read sensors and
    command actuators of a telescope's file: their values follow those of the table.

    Parameters
    ----------
    k_pma : ForceLaw
        Input ``accel_Ip`` (6), output ``pma_force`` (6), period one tick.
    loop : {"none", "isolator", "fsm", "fsm+pma"}
        Stage: which of the loops are closed.
    los_sensitivity : float
        Line of sight by an angle of the mirror, rad/rad, that the observer was made for
        (:meth:`titop_plant.interface.DesignBasis.mirror_sensitivity`).
    fsm_authority, pma_authority : float
        Limits per channel [rad], [N].
    sensors : sequence of Sensor
        Further inputs of K_PMA, which between samples of a slow one takes the last.
    actuators : sequence of ForceActuator
        Further outputs of K_PMA, with their limits.
    fade_ticks : int
        Length of the fade after a change of the stage.

    Raises
    ------
    ValueError
        Other ports, another period, unknown stage, a sensitivity or a limit that is not positive.

    Examples
    --------
    With a sensitivity of 0.1 the mirror turns by ten times the estimate, and stops at its limit:

    >>> from lftkit.systems.sampled.sampled_system import SampledSystem
    >>> k = SampledSystem([], [], [], np.zeros((6, 6)), K_PMA_INPUTS, K_PMA_OUTPUTS, DT)
    >>> controller = FsmPmaController(k, "fsm", los_sensitivity=0.1, fsm_authority=2e-3, pma_authority=30.0)
    >>> u = np.zeros(COMMANDS)
    >>> controller.step(np.array([1e-6, -1e-3]), np.zeros(6), u)
    >>> [round(float(x), 9) for x in u[MIRROR]]
    [-1e-05, 0.002]
    """

    def __init__(
        self,
        k_pma: ForceLaw,
        loop: str = STAGES[-1],
        *,
        los_sensitivity: float,
        fsm_authority: float,
        pma_authority: float,
        sensors: Sequence[Sensor] = (),
        actuators: Sequence[ForceActuator] = (),
        fade_ticks: int = FADE_TICKS,
    ) -> None:
        if loop not in STAGES:
            raise InputError(f"loop must be one of {', '.join(STAGES)}, got {loop!r}")
        positive = {
            "los_sensitivity": los_sensitivity,
            "fsm_authority": fsm_authority,
            "pma_authority": pma_authority,
            **{f"authority of {actuator.port.name}": actuator.authority for actuator in actuators},
        }
        for name, value in positive.items():
            if not (np.isfinite(value) and value > 0):
                raise InputError(f"{name} must be positive and finite, got {value}")
        inputs = (*K_PMA_INPUTS, *(sensor.port for sensor in sensors))
        k_pma.require(inputs, (*K_PMA_OUTPUTS, *(a.port for a in actuators)), DT)
        self.k_pma = k_pma
        self.los_sensitivity = los_sensitivity
        self._mirror_gain = -1.0 / los_sensitivity
        self._limit: FloatArray = np.array([0.0] * COMMANDS + [actuator.authority for actuator in actuators])
        self._negative_limit = -self._limit
        self.limit(fsm_authority, pma_authority)
        self._mirror_fade, self._force_fade = Fade(fade_ticks), Fade(fade_ticks)
        self._begun = False
        self.switch(loop)
        self._force = np.zeros(self._limit.size - FORCES.start)
        self._start: FloatArray = np.zeros(k_pma.order)
        platform = [port_alone(entry) for entry in MEASURED_SENSORS if entry.port.name == PLATFORM_PORT]
        self._held = HeldSamples((*platform, *sensors))
        self._measured = np.zeros(total_size(inputs))

    def start_at(self, state: FloatArray) -> None:
        """Say where the next reset leads to: `state` (order of K_PMA,), for a run that starts in its steady state.

        Raises
        ------
        ValueError
            Another shape.
        """
        if np.shape(state) != self._start.shape:
            raise InputError(f"state must have shape {self._start.shape}, got {np.shape(state)}")
        self._start = np.array(state, dtype=float)

    def switch(self, loop: str) -> None:
        """Close the loops of a stage, from the next step on; K_PMA starts from its zero state when its loop closes.

        Their commands fade in and out, but for a stage that is chosen before the first step.
        """
        self.loop = loop
        self._fsm_closed, self._pma_closed = loop in MIRROR_STAGES, loop in FORCE_STAGES
        self._whole = False
        self._mirror_fade.turn(self._fsm_closed)
        self._force_fade.turn(self._pma_closed)
        if not self._begun:
            self._mirror_fade.settle()
            self._force_fade.settle()
        elif self._pma_closed and self._force_fade.over:
            self.k_pma.reset()

    def limit(self, fsm_authority: float | None = None, pma_authority: float | None = None) -> None:
        """Saturate at these limits [rad], [N] from the next step on; None leaves one as it is."""
        if fsm_authority is not None:
            self._limit[MIRROR] = fsm_authority
        if pma_authority is not None:
            self._limit[FORCES] = pma_authority
        np.negative(self._limit, out=self._negative_limit)

    @property
    def limits(self) -> FloatArray:
        """Copy of the largest commands, shape (8,): mirror [rad], forces [N]; those of further actuators behind."""
        return self._limit.copy()

    @property
    def closed(self) -> tuple[bool, bool]:
        """Whether the loops of mirror and forces are closed."""
        return self._fsm_closed, self._pma_closed

    @property
    def mirror_gain(self) -> float:
        """From the estimate to the command of the mirror, rad/rad."""
        return self._mirror_gain

    def step(self, los_estimate: FloatArray, accel_Ip: FloatArray, out: FloatArray) -> None:
        """Write the command of this tick into `out` (8,): mirror angles [rad], forces [N].

        Values of further sensors stand behind `accel_Ip` (6,), forces of further actuators at the end of `out`.
        """
        self._begun = True
        mirror = force = 1.0
        if not self._whole:
            mirror, force = self._weights()
        if mirror:
            np.multiply(los_estimate, self._mirror_gain, out=out[MIRROR])
        else:
            out[MIRROR] = 0.0
        if force:
            if self._held.columns.size:
                self._measured[:] = accel_Ip
                self._held.fill(self._measured)
                accel_Ip = self._measured
            self.k_pma.step(accel_Ip, self._force)
            out[FORCES.start :] = self._force
        else:
            out[FORCES.start :] = 0.0
        np.minimum(out, self._limit, out=out)
        np.maximum(out, self._negative_limit, out=out)
        if mirror < 1.0:
            out[MIRROR] *= mirror
        if force < 1.0:
            out[FORCES.start :] *= force

    def steps(self, los_estimates: FloatArray, accel_Ip: FloatArray) -> FloatArray:
        """Commands (k, 8) of the ticks with these inputs, (k, 2) and (k, 6): bit for bit those of :meth:`step`."""
        out: FloatArray = np.zeros((len(accel_Ip), self._limit.size))
        single = 0
        linear = isinstance(self.k_pma, SampledSystem)
        while single < len(out) and not (linear and self._mirror_fade.settled and self._force_fade.settled):
            self.step(los_estimates[single], accel_Ip[single], out[single])
            single += 1
        rest = slice(single, None)
        if self._mirror_fade.whole:
            np.multiply(los_estimates[rest], self._mirror_gain, out=out[rest, MIRROR])
        if self._force_fade.whole and isinstance(self.k_pma, SampledSystem):
            measured = accel_Ip[rest]
            if self._held.columns.size:
                measured = measured.copy()
                self._held.fill_rows(measured)
            out[rest, FORCES.start :] = self.k_pma.steps(measured)
        self._begun = True
        np.minimum(out[rest], self._limit, out=out[rest])
        np.maximum(out[rest], self._negative_limit, out=out[rest])
        return out

    def _weights(self) -> tuple[float, float]:
        """Weights of mirror and forces at this tick, where one of them is not whole."""
        fades = self._mirror_fade, self._force_fade
        mirror, force = (1.0 if fade.whole else fade.weight() for fade in fades)
        self._whole = all(fade.whole for fade in fades)
        return mirror, force

    def reset(self) -> None:
        """Back to the start: the zero state, or that of :meth:`start_at`; a fade is over."""
        self.k_pma.reset(self._start)
        self._held.values[:] = 0.0
        self._begun = False
        self._mirror_fade.settle()
        self._force_fade.settle()
        self._whole = False
