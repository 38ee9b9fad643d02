"""The steering-mirror and proof-mass laws at run time: one `step` per tick (numpy only)."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Protocol

import numpy as np

from fsm_pma_controller.fade import FADE_TICKS, Fade
from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from lftkit.systems.ports import Port, port_slices
from lftkit.systems.sampled.sampled_system import SampledSystem
from titop_plant.held_samples import HeldSamples
from titop_plant.interface import COMMANDED, DT, FORCE_STAGES, MIRROR, MIRROR_STAGES, STAGES

if TYPE_CHECKING:
    from titop_plant.telescope.loop_ports import LoopPorts

FORCE_PORT = COMMANDED[1]
"""Port of the proof-mass actuators, whose limit is that of the run."""


class ForceLaw(Protocol):
    """Proof-mass law at run time; :class:`lftkit.systems.sampled.sampled_system.SampledSystem` is one."""

    @property
    def order(self) -> int:
        """Number of states."""

    def require(self, inputs: Iterable[Port], outputs: Iterable[Port], dt: float) -> None:
        """Raise a ValueError for other ports or another period [s] than its own."""

    def step(self, u: FloatArray, out: FloatArray, /) -> None:
        """Write the commands of this tick, such as forces (6,) [N]; `u` are the values of its sensors."""

    def reset(self, state: FloatArray | None = None) -> None:
        """Back to the zero state, or to another `state` (order,)."""


class FsmPmaController:
    """Mirror law ``u_fsm = -LOS_hat / los_sensitivity`` and proof-mass law ``u_pma = K_PMA y``.

    ======== ============ ==== =========================================
    port     name         size content
    ======== ============ ==== =========================================
    input    los_estimate 2    output of the observer [rad]
    input    of a sensor       one for each of `ports`: ``accel_Ip`` of the stored K_PMA
    output   fsm_command  2    mirror angles [rad]
    output   of actuators      one for each of `ports`: ``pma_force`` (6) [N] of the stored K_PMA
    ======== ============ ==== =========================================

    **A positive LOS estimate drives the mirror to a negative angle.** Both outputs are saturated at
    the authority of their actuators. Stages without a loop give zeros on it. A change of the stage between two steps
    fades the outputs of a loop in or out, so that no command steps.

    Parameters
    ----------
    k_pma : ForceLaw
        Inputs and outputs of `ports`, period one tick.
    loop : {"none", "isolator", "fsm", "fsm+pma"}
        Stage: which of the loops are closed.
    los_sensitivity : float
        Line of sight by an angle of the mirror, rad/rad, that the observer was made for
        (:meth:`titop_plant.interface.DesignBasis.mirror_sensitivity`).
    fsm_authority, pma_authority : float
        Limits per channel [rad], [N].
    ports : LoopPorts
        Sensors and actuators of K_PMA, which between samples of a slow sensor takes the last.
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
    >>> from titop_plant.telescope.load import load_telescope
    >>> rows = load_telescope().loop_ports.of_law("k_pma")
    >>> k = SampledSystem([], [], [], np.zeros((6, 6)), rows.measured, rows.commanded, DT)
    >>> limits = {"los_sensitivity": 0.1, "fsm_authority": 2e-3, "pma_authority": 30.0}
    >>> controller = FsmPmaController(k, rows, "fsm", **limits)
    >>> u = np.zeros(8)
    >>> controller.step(np.array([1e-6, -1e-3]), np.zeros(6), u)
    >>> [round(float(x), 9) for x in u[MIRROR]]
    [-1e-05, 0.002]
    """

    def __init__(
        self,
        k_pma: ForceLaw,
        ports: LoopPorts,
        loop: str = STAGES[-1],
        *,
        los_sensitivity: float,
        fsm_authority: float,
        pma_authority: float,
        fade_ticks: int = FADE_TICKS,
    ) -> None:
        if loop not in STAGES:
            raise InputError(f"loop must be one of {', '.join(STAGES)}, got {loop!r}")
        positive = {
            "los_sensitivity": los_sensitivity,
            "fsm_authority": fsm_authority,
            "pma_authority": pma_authority,
            **{f"authority of {a.port.name}": a.authority for a in ports.actuators if a.port.name != FORCE_PORT},
        }
        for name, value in positive.items():
            if not (np.isfinite(value) and value > 0):
                raise InputError(f"{name} must be positive and finite, got {value}")
        k_pma.require(ports.measured, ports.commanded, DT)
        self.k_pma = k_pma
        self.los_sensitivity = los_sensitivity
        self._mirror_gain = -1.0 / los_sensitivity
        self.ports = ports
        self._limit: FloatArray = np.concatenate([np.zeros(MIRROR.stop), ports.limits])
        self._negative_limit = -self._limit
        self.limit(fsm_authority, pma_authority)
        self._mirror_fade, self._force_fade = Fade(fade_ticks), Fade(fade_ticks)
        self._begun = False
        self.switch(loop)
        self._force = np.zeros(self._limit.size - MIRROR.stop)
        self._start: FloatArray = np.zeros(k_pma.order)
        self._held = HeldSamples(ports.sensors)
        self._measured = np.zeros(ports.measurements)

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
            forces = port_slices(self.ports.commanded).get(FORCE_PORT, slice(0, 0))
            self._limit[MIRROR.stop :][forces] = pma_authority
        np.negative(self._limit, out=self._negative_limit)

    @property
    def limits(self) -> FloatArray:
        """Copy of the largest commands, shape (2 + outputs of K_PMA,): mirror [rad], forces [N]."""
        return self._limit.copy()

    @property
    def closed(self) -> tuple[bool, bool]:
        """Whether the loops of mirror and forces are closed."""
        return self._fsm_closed, self._pma_closed

    @property
    def mirror_gain(self) -> float:
        """From the estimate to the command of the mirror, rad/rad."""
        return self._mirror_gain

    def step(self, los_estimate: FloatArray, measured: FloatArray, out: FloatArray) -> None:
        """Write the command of this tick into `out`: mirror angles [rad], then the outputs of K_PMA.

        `measured` are the values of the sensors of K_PMA, such as ``accel_Ip`` (6).
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
                self._measured[:] = measured
                self._held.fill(self._measured)
                measured = self._measured
            self.k_pma.step(measured, self._force)
            out[MIRROR.stop :] = self._force
        else:
            out[MIRROR.stop :] = 0.0
        np.minimum(out, self._limit, out=out)
        np.maximum(out, self._negative_limit, out=out)
        if mirror < 1.0:
            out[MIRROR] *= mirror
        if force < 1.0:
            out[MIRROR.stop :] *= force

    def steps(self, los_estimates: FloatArray, measurements: FloatArray) -> FloatArray:
        """Commands of the ticks with these inputs, a row for each: bit for bit those of :meth:`step`."""
        out: FloatArray = np.zeros((len(measurements), self._limit.size))
        single = 0
        linear = isinstance(self.k_pma, SampledSystem)
        while single < len(out) and not (linear and self._mirror_fade.settled and self._force_fade.settled):
            self.step(los_estimates[single], measurements[single], out[single])
            single += 1
        rest = slice(single, None)
        if self._mirror_fade.whole:
            np.multiply(los_estimates[rest], self._mirror_gain, out=out[rest, MIRROR])
        if self._force_fade.whole and isinstance(self.k_pma, SampledSystem):
            measured = measurements[rest]
            if self._held.columns.size:
                measured = measured.copy()
                self._held.fill_rows(measured)
            out[rest, MIRROR.stop :] = self.k_pma.steps(measured)
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
