"""From a configuration to plant, observer and controller; heavy packages are imported here when they are needed."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np

from fsm_pma_controller.runtime import FsmPmaController
from lftkit.arrays import FloatArray
from lftkit.support.threads import one_thread
from lftkit.systems.sampled_system import SampledSystem
from los_estimator.runtime import LosEstimator
from los_testbed.config import RunConfig, is_code
from los_testbed.plugins import RAISED, in_one_line, make
from los_testbed.run_start import RunStart, find_run_start, with_tones
from los_testbed.user_blocks import UserBlock, make_disturbance, make_law
from los_testbed.variants import check_ranges
from titop_plant.interface import FORCE_STAGES, MIRROR_STAGES, DesignBasis, design_warnings

if TYPE_CHECKING:
    from los_loop.steady_state import LoopStart
    from los_loop.tone_model import ToneModel
    from pointing_analysis.requirements.text import Requirement
    from titop_plant.simulation.build import PlantConfig
    from titop_plant.simulation.driven_plant import DrivenPlant
    from titop_plant.simulation.sampled_plant import SampledPlant


class Plant(Protocol):
    """What the loop needs of a plant: commands in, measurements and truth out, one step per tick.

    **Contract.** The vectors are those of :mod:`titop_plant.interface`. `step` number k applies the command that was
    computed from the measurement of step k - 1 and holds it until step k + 1; it limits the command to what its
    actuators can do. It overwrites all of `measurement` and `truth`, leaves `command` alone, and raises nothing: a
    plant that diverges returns values that are not finite. It takes well under a tick. After `reset` the same commands
    give the same bits.

    Two further attributes are recorded where a plant has them: ``tones``, the frequencies of its disturbance [rad/s],
    and ``parameters_hash``, a text that names its values.
    """

    frame_ticks: int
    """Ticks from one camera frame to the next: step k has a frame where k is a multiple of it."""

    def step(self, command: FloatArray, measurement: FloatArray, truth: FloatArray) -> None:
        """Apply `command` (8,) [rad, N]; write `measurement` (22,) [m/s2, rad/s2, rad] and `truth` (2,) [rad].

        The camera's columns are NaN where there is no frame or the frame is lost.
        """

    def reset(self) -> None:
        """Back to the state before the first step, noise included."""


def controller_files(config: RunConfig) -> dict[str, Path]:
    """Files of K_FSM and K_PMA: the named ones, else the stored designs.

    Raises
    ------
    ValueError
        One of them is code of the user, of which no model is known.
    """
    for name in (code := code_of(config)):
        raise ValueError(f"{name} must be a file here, only `los-testbed run` takes code, got {code[name]}")
    return recorded_files(config)


def code_of(config: RunConfig) -> dict[str, str]:
    """Names of the controllers that are code of the user."""
    return {name: getattr(config, name) for name in ("k_fsm", "k_pma") if is_code(getattr(config, name))}


def recorded_files(config: RunConfig) -> dict[str, Path]:
    """Files of the controllers of a run, those aside that are code of the user."""
    import fsm_pma_controller
    import los_estimator

    stored = {
        "k_fsm": Path(str(los_estimator.__file__)).parent / "designs" / "k_fsm.json",
        "k_pma": Path(str(fsm_pma_controller.__file__)).parent / "designs" / "k_pma.json",
    }
    code = code_of(config)
    return {name: Path(getattr(config, name) or path) for name, path in stored.items() if name not in code}


def requirements_of(config: RunConfig) -> tuple[Requirement, ...]:
    """Pointing requirements of the telescope of a run, those of all stages; ValueError as :func:`telescope_basis`."""
    from titop_plant.telescope.parameters import REFERENCE, load_parameters
    from titop_plant.telescope.requirements import telescope_requirements

    return telescope_requirements(load_parameters(config.parameters or REFERENCE))


def telescope_basis(config: RunConfig) -> DesignBasis:
    """What the controllers of a run must have been made for: the telescope's values, with the limits of the run.

    Raises
    ------
    ValueError
        The parameter file cannot be read.
    """
    from titop_plant.telescope.parameters import REFERENCE, design_basis, load_parameters

    own = design_basis(load_parameters(config.parameters or REFERENCE))
    limits = {
        name: value for name in ("fsm_authority", "pma_authority") if (value := getattr(config, name)) is not None
    }
    return replace(own, **limits)


def load_controllers(config: RunConfig) -> dict[str, SampledSystem]:
    """``k_fsm`` and ``k_pma`` of a configuration.

    Raises
    ------
    ValueError
        A file is missing or holds no controller.
    """
    return {name: SampledSystem.from_file(path) for name, path in controller_files(config).items()}


def run_controllers(config: RunConfig) -> dict[str, SampledSystem | UserBlock]:
    """``k_fsm`` and ``k_pma`` of a run: of a file, or code of the user.

    Raises
    ------
    ValueError
        A file is missing or holds no controller; code that cannot be used.
    """
    found: dict[str, SampledSystem | UserBlock] = {name: make_law(config, name) for name in code_of(config)}
    found |= {name: SampledSystem.from_file(path) for name, path in recorded_files(config).items()}
    return found


def compare_with_telescope(
    controllers: Mapping[str, SampledSystem | UserBlock], telescope: DesignBasis, loop: str
) -> tuple[str, ...]:
    """Compare controllers with the telescope of a run; one line for each made for other parameters or limits.

    K_FSM counts in every stage, since its estimates are recorded; K_PMA only where its loop is closed.

    Raises
    ------
    ValueError
        A loop is closed with a controller that was made for another sensitivity of the mirror.
    """
    lines = design_warnings([controllers["k_fsm"]], telescope, closed=loop in MIRROR_STAGES)
    if loop in FORCE_STAGES:
        lines += design_warnings([controllers["k_pma"]], telescope, closed=True)
    return lines


def check_controllers(config: RunConfig) -> tuple[str, ...]:
    """Refuse controllers that cannot be used; one line for each made for other parameters or limits than the run's.

    Raises
    ------
    ValueError
        A file that is no controller, or one with other ports or another period; one that would close a loop and was
        made for another sensitivity of the mirror; code of the user that breaks its contract.
    """
    found, telescope = run_controllers(config), telescope_basis(config)
    if isinstance(k_fsm := found["k_fsm"], SampledSystem):
        LosEstimator(k_fsm)
    assemble_controller(found, telescope, config.loop)
    return compare_with_telescope(found, telescope, config.loop)


def build_estimator(config: RunConfig) -> LosEstimator | UserBlock:
    """Observer of the configuration; its reset leads to the start of the run.

    Raises
    ------
    ValueError
        As :func:`check_controllers`, for K_FSM.
    """
    code = "k_fsm" in code_of(config)
    k_fsm = make_law(config, "k_fsm") if code else SampledSystem.from_file(recorded_files(config)["k_fsm"])
    design_warnings([k_fsm], telescope_basis(config), closed=config.loop in MIRROR_STAGES)
    if isinstance(k_fsm, UserBlock):
        return k_fsm
    estimator = LosEstimator(k_fsm)
    states = _states(config)
    if states is not None:
        estimator.start_at(states.k_fsm, states.camera)
    return estimator


def build_controller(config: RunConfig) -> FsmPmaController:
    """Mirror and proof-mass laws of the configuration; the mirror's gain is that of the file of K_FSM.

    Its reset leads to the start of the run.

    Raises
    ------
    ValueError
        As :func:`check_controllers`.
    """
    found, telescope = run_controllers(config), telescope_basis(config)
    compare_with_telescope(found, telescope, config.loop)
    controller = assemble_controller(found, telescope, config.loop)
    states = _states(config)
    if states is not None:
        controller.start_at(states.k_pma)
    return controller


def _states(config: RunConfig) -> LoopStart | None:
    """States in which the run starts; None at rest, where nothing needs to be computed."""
    return None if config.start == "rest" else run_start(config).states


def assemble_controller(
    controllers: Mapping[str, SampledSystem | UserBlock], telescope: DesignBasis, loop: str
) -> FsmPmaController:
    """Mirror and proof-mass laws.

    Parameters
    ----------
    controllers : mapping
        ``k_fsm``, which says the sensitivity of the mirror that it was made for, and ``k_pma``.
    telescope : DesignBasis
        With the limits of the run; its sensitivity counts where the file of K_FSM says none.
    loop : str
        Stage.

    Raises
    ------
    ValueError
        Other ports, another period, an unknown stage, a value that neither the file nor the telescope says.
    """
    k_fsm = controllers["k_fsm"]
    mirror, force = telescope.authority
    return FsmPmaController(
        controllers["k_pma"],
        loop,
        los_sensitivity=DesignBasis.from_mapping(k_fsm.design_basis, k_fsm.name).mirror_sensitivity(telescope),
        fsm_authority=mirror,
        pma_authority=force,
    )


def build_plant(config: RunConfig) -> Plant:
    """Telescope of the configuration, sampled at the tick rate, in the state in which the run starts; or its own plant.

    Raises
    ------
    ValueError
        A parameter outside its range; the message names both. A file that is no controller. A plant that cannot be
        made.
    """
    if config.plant:
        return _user_plant(config)
    from titop_plant.simulation import build as simulation

    start = run_start(config)
    physical = plant_config(config, start)
    with one_thread():
        state = np.zeros(simulation.plant_order(physical)) if start.states is None else start.states.plant
        telescope = simulation.build_plant(physical, state)
    own = config.disturbance_source if config.disturbance else None
    plant = telescope if own is None else _driven(telescope, config, physical, own)
    if not config.nonlinear:
        return plant
    from titop_plant.simulation.nonlinear_plant import DeviceLimits, NonlinearPlant
    from titop_plant.telescope.parameters import REFERENCE, load_parameters

    return NonlinearPlant(plant, DeviceLimits(), load_parameters(config.parameters or REFERENCE)["pma"])


def _user_plant(config: RunConfig) -> Plant:
    own: Plant = make(config)
    try:
        own.reset()
    except RAISED as error:
        raise ValueError(f"plant {config.plant} must have a reset that works, got {in_one_line(error)}") from error
    return own


def _driven(plant: SampledPlant, config: RunConfig, physical: PlantConfig, source: str) -> DrivenPlant:
    """The telescope under the disturbance of the user."""
    from titop_plant.simulation.driven_plant import DrivenPlant, held_disturbance

    disturbance = make_disturbance(config)
    disturbance.reset()
    with one_thread():
        return DrivenPlant(plant, held_disturbance(physical, plant.dt), disturbance, source)


def run_start(config: RunConfig, controllers: Mapping[str, SampledSystem] | None = None) -> RunStart:
    """Worst-case tone of a run and the states in which it starts.

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
    if config.plant:
        return RunStart()
    if code_of(config):  # no model of the code is known: the tone that is worst without fine control
        config = replace(config, k_fsm=None, k_pma=None, loop="isolator" if config.loop != "none" else "none")
    chosen = load_controllers(config) if controllers is None else controllers
    return find_run_start(config, _physical(config), chosen, telescope_basis(config).authority)


def plant_config(config: RunConfig, start: RunStart | None = None) -> PlantConfig:
    """Physical settings of a run.

    Parameters
    ----------
    config : RunConfig
    start : RunStart, optional
        With the tone of the scenario worst_case; default: that of :func:`run_start`.

    Raises
    ------
    ValueError
        A parameter outside its range; the message names both. A start without the tone that the scenario needs.
    """
    physical = _physical(config)
    if config.scenario != "worst_case" or not config.disturbance or config.disturbance_source:
        return physical
    return with_tones(physical, run_start(config) if start is None else start)


def _physical(config: RunConfig) -> PlantConfig:
    """Physical settings but for the worst-case tone: the scenario worst_case comes without disturbance."""
    from titop_plant.simulation.build import PlantConfig

    check_ranges(config)
    told = config.disturbance and config.scenario != "worst_case" and config.disturbance_source is None
    return PlantConfig.of(config, isolated=config.loop != "none", disturbance=told)


def tone_model(
    config: RunConfig, controllers: Mapping[str, SampledSystem] | None = None, start: RunStart | None = None
) -> ToneModel:
    """Model of the loop that runs, with its tones, for comparisons with a record.

    Parameters
    ----------
    config : RunConfig
    controllers : mapping, optional
        ``k_fsm`` and ``k_pma``; default: those of the files that the configuration names.
    start : RunStart, optional
        Start of the recorded run; default: that of :func:`run_start`.

    Raises
    ------
    ValueError
        A telescope outside its family, a file that is missing or no controller.
    """
    from los_loop.tone_model import ToneModel

    if controllers is None:
        controllers = load_controllers(config)
    if start is None:
        start = run_start(config, controllers)
    with one_thread():
        return ToneModel.of(
            plant_config(config, start),
            controllers,
            loop=config.loop,
            authority=telescope_basis(config).authority,
            steady=start.states is not None,
        )


def plant_notes(plant: Plant) -> dict[str, str]:
    """Tones, motion and name of the values of a plant, for the metadata of a bag."""
    notes = {}
    tones = getattr(plant, "tones", None)
    if tones is not None:
        notes["tones_rad_s"] = "[" + ", ".join(f"{tone:.9g}" for tone in np.ravel(tones)) + "]"
    motion = getattr(getattr(plant, "plant", plant), "motion", None)  # of the telescope behind its devices
    if motion is not None:
        notes["motion"] = json.dumps(motion)
    parameters_hash = getattr(plant, "parameters_hash", None)
    if parameters_hash is not None:
        notes["plant_parameters_hash"] = str(parameters_hash)
    return notes
