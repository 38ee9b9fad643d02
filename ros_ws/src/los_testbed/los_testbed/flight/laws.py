"""Exported laws: those of a pair of designs, as the testbed runs them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from fsm_pma_controller.runtime import FsmPmaController
from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from lftkit.systems.sampled.sampled_system import SampledSystem
from los_estimator.runtime import LosEstimator
from los_testbed.bags.cdr import codec_for
from los_testbed.config.run_config import RunConfig
from los_testbed.config.run_settings import of_designs
from los_testbed.config.topics import FSM_COMMAND, PMA_COMMAND
from los_testbed.flight.tables import Tables
from los_testbed.parts.controllers import assemble_controller
from los_testbed.parts.run_parts import RunParts
from los_testbed.run.loop.command_gate import CommandGate
from titop_plant.interface import FORCES, K_PMA_OUTPUTS, MIRROR, STAGES
from titop_plant.telescope.actuators import reference_actuators
from titop_plant.telescope.loop_ports import LoopPorts


@dataclass(frozen=True)
class FlightLaws:
    """Observer, controller and gates of a pair of designs.

    Parameters
    ----------
    k_fsm, k_pma : SampledSystem
        With the ports of the loop: a file that leaves sensors out has columns of zeros for them.
    ports : LoopPorts
        Sensors of K_FSM, whose values are the measurement; mirror and proof-mass actuators.
    measured : slice
        Columns of the inputs of K_PMA in the measurement.
    los_sensitivity : float
        Line of sight by an angle of the mirror, rad/rad.
    limits : ndarray, shape (8,)
        Largest commands: mirror [rad], forces [N].
    hold_ticks, fade_ticks : int
        Of the gates.
    warnings : tuple of str
        Differences between the design basis and the telescope.
    """

    k_fsm: SampledSystem
    k_pma: SampledSystem
    ports: LoopPorts
    measured: slice
    los_sensitivity: float
    limits: FloatArray
    hold_ticks: int
    fade_ticks: int
    warnings: tuple[str, ...] = ()

    @classmethod
    def of(cls, estimator: LosEstimator, controller: FsmPmaController, warnings: tuple[str, ...] = ()) -> FlightLaws:
        """The laws of an observer and a controller of the testbed, with the gates of a run.

        Raises
        ------
        ValueError
            A proof-mass law that is no `SampledSystem`, that commands actuators beside the proof masses, or reads other
            sensors than neighbouring ones of K_FSM with a sample at every tick.
        """
        if not isinstance(controller.k_pma, SampledSystem):
            raise InputError(f"k_pma must be a SampledSystem, got {type(controller.k_pma).__name__}")
        mirror, *forces = reference_actuators(*controller.limits[[0, -1]].tolist())
        ports = LoopPorts(estimator.ports.sensors, (mirror, *forces))
        others = [row.port.name for row in controller.ports.actuators if row.port not in K_PMA_OUTPUTS]
        if others:
            raise InputError(
                f"k_pma must command {K_PMA_OUTPUTS[0].name} alone in flight code, got {', '.join(others)}"
            )
        known = {row.name for row in ports.sensors}
        apart = [row.name for row in controller.ports.sensors if row.name not in known or row.framed]
        columns = None if apart else ports.measured_columns(row.port for row in controller.ports.sensors)
        if not isinstance(columns, slice):
            names = ", ".join(row.name for row in controller.ports.sensors)
            raise InputError(
                f"k_pma must read neighbouring sensors of k_fsm with a sample at every tick in flight code, got {names}"
            )
        run = RunConfig()
        return cls(
            estimator.k_fsm,
            controller.k_pma,
            ports,
            columns,
            controller.los_sensitivity,
            controller.limits,
            run.hold_ticks,
            run.fade_ticks,
            warnings,
        )

    def estimator(self) -> LosEstimator:
        """The observer of the testbed, at rest."""
        return LosEstimator(replace(self.k_fsm), self.ports)

    def controller(self, stage: str = STAGES[-1]) -> FsmPmaController:
        """The controller of the testbed, at rest."""
        mirror, force = self.authority
        read = tuple(row for row in self.ports.sensors if row.port in self.k_pma.inputs)
        return FsmPmaController(
            replace(self.k_pma),
            LoopPorts(read, self.ports.actuators[1:]),
            stage,
            los_sensitivity=self.los_sensitivity,
            fsm_authority=mirror,
            pma_authority=force,
            fade_ticks=self.fade_ticks,
        )

    @property
    def authority(self) -> tuple[float, float]:
        """Largest mirror angle [rad] and largest force of one actuator [N]."""
        return float(self.limits[MIRROR][0]), float(self.limits[FORCES][0])

    def gates(self) -> tuple[CommandGate, CommandGate]:
        """The gates of mirror and forces of the testbed."""
        times = self.hold_ticks, self.fade_ticks
        mirror, force = self.authority
        return CommandGate(codec_for(FSM_COMMAND), mirror, *times), CommandGate(codec_for(PMA_COMMAND), force, *times)

    def tables(self) -> Mapping[str, Tables]:
        """Numbers of each translation unit, by its name."""
        return {
            "k_fsm": Tables.of(TABLE=_step_matrix(self.k_fsm)),
            "k_pma": Tables.of(TABLE=_step_matrix(self.k_pma)),
            "controller": Tables.of(MIRROR_GAIN=[self.controller().mirror_gain], LIMITS=self.limits),
            "gate": Tables.of(LIMITS=self.authority, HOLD_TICKS=[self.hold_ticks], WEIGHTS=self.gates()[0].weights),
        }


def laws_of(designs: str | None = None) -> FlightLaws:
    """The laws of a folder of designs, or of the shipped pair.

    Raises
    ------
    ValueError
        A folder without its controllers, a file that is none, one that does not fit the telescope.
    """
    parts = RunParts(RunConfig.from_mapping({**of_designs(designs or ""), "loop": STAGES[-1]}))
    warnings = parts.check()
    models: Mapping[str, Any] = parts.models
    controller = assemble_controller(models, parts.basis, STAGES[-1], parts.used["k_pma"])
    return FlightLaws.of(LosEstimator(models["k_fsm"], parts.used["k_fsm"]), controller, warnings)


def laws_of_bundle(path: Path) -> FlightLaws:
    """The laws of a bundle of proofs; its proofs are not checked here.

    Raises
    ------
    ValueError
        A file that is no bundle, or is damaged.
    """
    from los_design.verification.bundle import open_bundle

    with open_bundle(path) as bundle:
        basis, rows = bundle.telescope.design_basis, bundle.telescope.loop_ports
        models = {"k_fsm": bundle.k_fsm, "k_pma": bundle.k_pma}
        observed, used = (rows.of_system(name, law) for name, law in models.items())
        controller = assemble_controller(models, basis, STAGES[-1], used)
        return FlightLaws.of(LosEstimator(bundle.k_fsm, observed), controller)


def _step_matrix(law: SampledSystem) -> FloatArray:
    return np.block([[law.A, law.B], [law.C, law.D]])
