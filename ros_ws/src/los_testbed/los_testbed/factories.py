"""From a configuration to the numeric cores; imports of heavy packages happen here and only when asked for."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from fsm_pma_controller.runtime import FsmPmaController
from los_estimator.runtime import LosEstimator
from los_testbed.config import PHYSICAL, RunConfig
from los_testbed.variants import check_ranges
from lti.sampled_system import SampledSystem
from lti.threads import one_thread

if TYPE_CHECKING:
    from los_design.tone_model import LoopModel
    from titop_plant.simulation import PlantConfig

FloatArray = NDArray[np.float64]


class Plant(Protocol):
    """What the loop needs of a plant: commands in, measurements and truth out, once per tick."""

    frame_ticks: int

    def step(self, command: FloatArray, measurement: FloatArray, truth: FloatArray) -> None:
        """One tick: apply `command` (8,), write `measurement` (22,) and `truth` (2,)."""

    def reset(self) -> None:
        """Back to the initial state."""


def controller_files(config: RunConfig) -> dict[str, Path]:
    """Files of K_FSM and K_PMA: the named ones, else the designs that ship."""
    import fsm_pma_controller
    import los_estimator

    shipped = {
        "k_fsm": Path(str(los_estimator.__file__)).parent / "designs" / "k_fsm.json",
        "k_pma": Path(str(fsm_pma_controller.__file__)).parent / "designs" / "k_pma.json",
    }
    return {name: Path(getattr(config, name) or path) for name, path in shipped.items()}


def build_estimator(config: RunConfig) -> LosEstimator:
    """Observer of the configuration.

    Raises
    ------
    ValueError
        The file is no controller, or one with other ports.
    """
    return LosEstimator(SampledSystem.from_file(controller_files(config)["k_fsm"]))


def build_controller(config: RunConfig) -> FsmPmaController:
    """Mirror and proof-mass laws of the configuration.

    Raises
    ------
    ValueError
        The file is no controller, or one with other ports.
    """
    k_pma = SampledSystem.from_file(controller_files(config)["k_pma"])
    return FsmPmaController(k_pma, config.loop, config.fsm_authority, config.pma_authority)


def build_plant(config: RunConfig) -> Plant:
    """Telescope of the configuration, sampled at 1 kHz.

    Raises
    ------
    ValueError
        A parameter outside its range; the message names both.
    """
    from titop_plant import simulation

    with one_thread():
        plant: Plant = simulation.build_plant(plant_config(config))
    return plant


def plant_config(config: RunConfig) -> PlantConfig:
    """Physical settings of a run.

    Raises
    ------
    ValueError
        A parameter outside its range; the message names both.
    """
    from titop_plant.simulation import PlantConfig

    check_ranges(config)
    values: dict[str, Any] = {name: getattr(config, name) for name in PHYSICAL}
    values["theta"], values["isolated"] = config.array_angle, config.loop != "none"
    for name in ("wheel_speed", "wheel_acceleration", "omega_1", "omega_2", "parameters"):  # the plant's own
        if not values[name]:
            del values[name]
    return PlantConfig(**values)


def tone_model(config: RunConfig, controllers: Mapping[str, SampledSystem] | None = None) -> LoopModel:
    """Model of a run from its disturbance tones to its line of sight.

    Parameters
    ----------
    config : RunConfig
    controllers : mapping, optional
        ``k_fsm`` and ``k_pma``; default: those of the files that the configuration names.

    Raises
    ------
    ValueError
        A telescope outside its family, a file that is missing or no controller.
    """
    from los_design.tone_model import LoopModel

    if controllers is None:
        controllers = {name: SampledSystem.from_file(path) for name, path in controller_files(config).items()}
    authority = config.fsm_authority, config.pma_authority
    with one_thread():
        return LoopModel.of(plant_config(config), controllers, loop=config.loop, authority=authority)


def plant_notes(plant: Plant) -> dict[str, str]:
    """What a plant says about itself for the metadata of a bag."""
    notes = {}
    tones = getattr(plant, "tones", None)
    if tones is not None:
        notes["tones_rad_s"] = "[" + ", ".join(f"{tone:.9g}" for tone in np.ravel(tones)) + "]"
    parameters_hash = getattr(plant, "parameters_hash", None)
    if parameters_hash is not None:
        notes["plant_parameters_hash"] = str(parameters_hash)
    return notes
