"""The loop of the paper's problem: continuous, without delay, hold and frames; fractional in the parameters.

The plant is :func:`titop_plant.telescope.control_plant.control_plant`, whose measurements are behind the washout and
the camera's low-pass. Responses, gradients and searches are those of :class:`los_loop.implemented_loop.ImplementedLoop`
with other responses of the commands; what is asked is :func:`los_loop.figures_of_merit.paper_figures`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy import linalg

from lftkit import System
from lftkit.arrays import ComplexArray, FloatArray
from lftkit.tuning.gains.loop import extended_plant
from los_loop.control_laws import transfer_matrices
from los_loop.figures_of_merit import FigureOfMerit, figure, paper_figures
from los_loop.implemented_loop import ImplementedLoop, LoopMetric, loop_metrics
from los_loop.open_loop import OpenLoop
from titop_plant.interface import COMMANDED, FORCE_STAGES, MEASURED, MIRROR, PLATFORM
from titop_plant.telescope.control_plant import control_plant, disturbances_of
from titop_plant.telescope.telescope import Telescope


def continuous_plant(telescope: Telescope) -> System:
    """Commands and disturbances to measurements, behind washout and low-pass, and line of sight."""
    plant = control_plant(telescope)
    return plant.select(inputs=(*COMMANDED, *disturbances_of(plant)), outputs=(*MEASURED, "los_controlled"))


def continuous_open_loop(telescope: Telescope) -> OpenLoop:
    """The telescope's LFT with commands that are not held."""
    return OpenLoop(continuous_plant(telescope), telescope, telescope.loop_ports.used_by(), held=False)


PROOF_MASSES_TO = 350.0
"""Frequency [rad/s] above which K_PMA adds little: behind the isolator's modes."""


FINE = replace(
    figure("RPE"),
    name="RPE, fine",
    limit=lambda telescope, _: telescope.weights.rpe_limit_fine,
    band=(PROOF_MASSES_TO, math.inf),
)
"""What a robust K_FSM is asked for, too: the limit of both controllers, where the proof masses do not act."""


def paper_gains(stage: str, fine: bool = False) -> tuple[FigureOfMerit, ...]:
    """What the paper's problem asks of the controller of a stage, but for the noise; `fine`: :data:`FINE` of K_FSM."""
    asked = tuple(row for row in paper_figures(stage) if not row.is_noise)
    return (*asked, FINE) if fine and stage not in FORCE_STAGES else asked


class ContinuousLoop(ImplementedLoop):
    """The loop of one stage with continuous controllers.

    Parameters
    ----------
    open_loop : OpenLoop
        Of :func:`continuous_open_loop`.
    k_fsm, k_pma : ndarray
        Gain matrices ``[[A, B], [C, D]]``, shapes (n + 2, n + 22) and (m + 6, m + 6): from the measurements behind
        their washout to the estimate [rad], from the platform's accelerations to the forces [N].
    stage : {"fsm", "fsm+pma"}
    fine : bool
        Whether K_FSM is asked for :data:`FINE`, too.
    """

    def __init__(
        self, open_loop: OpenLoop, k_fsm: FloatArray, k_pma: FloatArray, stage: str, fine: bool = False
    ) -> None:
        self.fine = fine
        self.open, self.system, self.telescope = open_loop, open_loop.system, open_loop.telescope
        self.stage, self.names, self.ports = stage, open_loop.names, open_loop.ports
        self.matrices = mirror_law(k_fsm, self.telescope.fsm.los_sensitivity), k_pma

    def metrics(self) -> dict[str, LoopMetric]:
        """Gains that the paper's problem asks for, by name."""
        return loop_metrics(self.telescope, self.stage, self.ports, rows=paper_gains(self.stage, self.fine))

    def exact_gain(self, metric: LoopMetric, omega: float, values: Mapping[str, float]) -> float | None:
        """None: the response of the LFT is that of the loop."""
        return None

    def controls(self, omega: FloatArray) -> ComplexArray:
        """Commands by measurements at N frequencies [rad/s], shape (N, 8, 22)."""
        k_fsm, k_pma = self.matrices
        out = np.zeros((len(omega), self.ports.commands, self.ports.measurements), complex)
        out[:, MIRROR] = _responses(k_fsm, MIRROR.stop - MIRROR.start, omega)
        if self.stage in FORCE_STAGES:
            forces = self.ports.forces
            out[:, forces, PLATFORM] = _responses(k_pma, forces.stop - forces.start, omega)
        return out

    def decay(self, values: Mapping[str, float]) -> float:
        """Largest real part of the poles of the closed loop at parameter values [rad/s]; infinite without a loop."""
        model = self.system.at(dict(values))
        controller = joint_gain_matrix(*self.matrices, forces=self.stage in FORCE_STAGES)
        order = len(controller) - self.ports.commands
        try:
            A = extended_plant(model, MEASURED, COMMANDED, order).closed(controller).A
        except linalg.LinAlgError:
            return np.inf
        return float(linalg.eigvals(A).real.max()) if np.isfinite(A).all() else np.inf


def mirror_law(k_fsm: FloatArray, sensitivity: float) -> FloatArray:
    """K_FSM with the mirror turned against its estimate: the last two rows over minus the sensitivity."""
    law = np.array(k_fsm, dtype=float)
    law[-2:] /= -sensitivity
    return law


def joint_gain_matrix(mirror: FloatArray, force_law: FloatArray, *, forces: bool) -> FloatArray:
    """Both controllers as one, from all measurements to all commands; without `forces` these are zero."""
    n, commands, count = len(mirror) - 2, len(force_law) - 6, PLATFORM.stop - PLATFORM.start
    m, measured = commands if forces else 0, mirror.shape[1] - n
    K = np.zeros((n + m + 8, n + m + measured))
    own = np.r_[0:n, n + m : n + m + 2]
    K[np.ix_(own, np.r_[0:n, n + m : n + m + measured])] = mirror
    if forces:
        rows = np.r_[n : n + m, n + m + 2 : n + m + 8]
        K[np.ix_(rows, np.r_[n : n + m, n + m + PLATFORM.start : n + m + PLATFORM.start + count])] = force_law
    return K


def _responses(K: FloatArray, outputs: int, omega: FloatArray) -> ComplexArray:
    """Of a gain matrix at N frequencies [rad/s], shape (N, outputs, inputs)."""
    n = len(K) - outputs
    return transfer_matrices((K[:n, :n], K[:n, n:], K[n:, :n], K[n:, n:]), np.asarray(1j * omega))


__all__ = [
    "ContinuousLoop",
    "continuous_open_loop",
    "continuous_plant",
    "joint_gain_matrix",
    "mirror_law",
    "paper_gains",
]
