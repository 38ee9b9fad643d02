"""From a configuration to plant, observer and controller.

What computes with scipy is imported where it is used: the command line and the nodes of the controllers start without.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import fsm_pma_controller
import los_estimator
from fsm_pma_controller.runtime import FsmPmaController
from lftkit.errors import InputError
from lftkit.support.threads import one_thread
from lftkit.systems.ports import total_size
from lftkit.systems.sampled.sampled_system import SampledSystem
from los_estimator.runtime import LosEstimator
from los_testbed.config.members import check_ranges
from los_testbed.config.plugins import RAISED, in_one_line, make
from los_testbed.config.run_config import RunConfig, is_code
from los_testbed.config.run_settings import with_scenario
from los_testbed.config.topics import TOPICS, TopicDefinition, command_topics, image_topic, sensor_topics
from los_testbed.parts.controllers import assemble_controller, compare_with_telescope
from los_testbed.parts.image_camera import ImageCamera
from los_testbed.parts.start import AT_REST, RunStart, find_run_start, from_runner, needs_tone, with_tones
from los_testbed.parts.stepped_plant import SteppedPlant
from los_testbed.parts.user_blocks import UserBlock, make_disturbance, make_law, read_law, with_loop_ports
from titop_plant.interface import (
    COMMANDED,
    FORCE_STAGES,
    LAW_PORTS,
    MIRROR_STAGES,
    DesignBasis,
    design_warnings,
    frame_ticks,
)
from titop_plant.simulation.plant_config import PlantConfig, motion
from titop_plant.telescope.guide_camera import star_camera
from titop_plant.telescope.load import load_telescope
from titop_plant.telescope.loop_ports import LoopPorts

if TYPE_CHECKING:
    from los_loop.implemented_loop import ImplementedLoop
    from los_loop.sampled_loop import Delays
    from los_loop.steady_state import LoopStart
    from los_loop.tone_model import ToneModel
    from los_loop.worst_tone import WorstTone
    from pointing_analysis.image.optics import Optics
    from pointing_analysis.image.star_camera import StarCamera
    from titop_plant.disturbances.source_kinds import DisturbanceTable
    from titop_plant.disturbances.sources import PlacedSource
    from titop_plant.simulation.build import PlantFamily
    from titop_plant.simulation.plant import Plant
    from titop_plant.telescope.actuators import Actuator
    from titop_plant.telescope.telescope import Telescope


SWITCHED_ON = "no model of {} is known (define a method system()): the controllers are switched on at the start"
TONE_WITHOUT = ", under the worst tone of the stage {}"


@dataclass(frozen=True)
class RunParts:
    """Telescope, controllers and start of one run, each made once, when it is asked for first.

    Parameters
    ----------
    config : RunConfig
        Afterwards with the scenario that acts.
    recorded : mapping, optional
        ``k_fsm`` and ``k_pma`` of a record; default: those that the configuration names.
    recorded_start : RunStart, optional
        Start of a recorded run; default: computed.
    known_family : PlantFamily, optional
        The telescopes with these parameters on this mounting; default: assembled.
    """

    config: RunConfig
    recorded: Mapping[str, SampledSystem] | None = None
    recorded_start: RunStart | None = None
    known_family: PlantFamily | None = None

    def __post_init__(self) -> None:
        if self.config.scenario is None:
            known = None if self.known_family is None else self.known_family.telescope
            object.__setattr__(self, "config", with_scenario(self.config, known))
        if self.config.camera_rate is None:
            object.__setattr__(self, "config", replace(self.config, camera_rate=self.telescope.camera_rate))

    @cached_property
    def telescope(self) -> Telescope:
        """Values of the telescope; ValueError: the file cannot be read, an exposure that is longer than a frame."""
        known = self.known_family
        loaded = load_telescope(self.config.parameters) if known is None else known.telescope
        loaded.check_exposure(frame_ticks(self.config.camera_rate or loaded.camera_rate))
        return loaded

    @cached_property
    def sampled_telescope(self) -> Telescope:
        """The telescope with the frame rate of the run."""
        rate = self.config.camera_rate
        if rate in (None, self.telescope.camera_rate):
            return self.telescope
        return self.telescope.changed({"sensors": {"camera_rate": rate}})

    @cached_property
    def pupil_file(self) -> bytes:
        """Content of the file of the pupil, empty where there is none; InputError: it cannot be read."""
        from pointing_analysis.image.optics import read_pupil_file

        name = self.telescope.image_optics.pupil
        return read_pupil_file(Path(name)) if name else b""

    @cached_property
    def optics(self) -> Optics:
        """Optics of the images of the telescope; InputError: they make none."""
        from pointing_analysis.image.optics import from_mapping

        table = self.telescope.image_optics.to_mapping()
        return from_mapping(table, self.config.parameters or "reference.toml", self.pupil_file)

    @cached_property
    def basis(self) -> DesignBasis:
        """Required design basis of the controllers: the telescope's values, with the limits of the run."""
        limits = {name: getattr(self.config, name) for name in ("fsm_authority", "pma_authority")}
        return replace(self.telescope.design_basis, **{k: v for k, v in limits.items() if v is not None})

    @cached_property
    def code(self) -> dict[str, str]:
        """Names of the controllers in user code."""
        if self.recorded is not None:
            return {}
        named = {name: text for name in LAW_PORTS if (text := getattr(self.config, name))}
        return {name: text for name, text in named.items() if is_code(text)}

    @cached_property
    def files(self) -> dict[str, Path]:
        """Files of the controllers, the named ones, else the stored designs; without those in user code."""
        return {
            name: Path(getattr(self.config, name) or Path(str(package.__file__)).parent / "designs" / f"{name}.json")
            for name, package in (("k_fsm", los_estimator), ("k_pma", fsm_pma_controller))
            if name not in self.code
        }

    @cached_property
    def k_fsm(self) -> SampledSystem | UserBlock:
        """Observer: of a record, of a file, or user code.

        Raises
        ------
        ValueError
            A file is missing or holds no controller; code that cannot be used.
        """
        return self._law("k_fsm")

    @cached_property
    def k_pma(self) -> SampledSystem | UserBlock:
        """Proof-mass law, as :attr:`k_fsm`."""
        return self._law("k_pma")

    def _law(self, name: str) -> SampledSystem | UserBlock:
        if name in self.code:
            return make_law(self.config, name, self.telescope_ports)
        known = self.recorded
        law = read_law(name, self.files[name], self.config.ports_in_order) if known is None else known[name]
        return with_loop_ports(name, str(self.files[name]), law, self.telescope_ports)

    @property
    def controllers(self) -> dict[str, SampledSystem | UserBlock]:
        """``k_fsm`` and ``k_pma``."""
        return {"k_fsm": self.k_fsm, "k_pma": self.k_pma}

    @property
    def model_files(self) -> dict[str, Path]:
        """Files of the controllers; ValueError: one of them is user code, without a known model."""
        for name, text in self.code.items():
            raise InputError(f"{name} must be a file here, only `los-testbed run` takes code, got {text}")
        return self.files

    @property
    def models(self) -> dict[str, SampledSystem]:
        """Models of the controllers; ValueError as :attr:`model_files`."""
        return {name: law for name in self.model_files if isinstance(law := getattr(self, name), SampledSystem)}

    @cached_property
    def settings(self) -> PlantConfig:
        """Physical settings but for the worst-case tone: the scenario worst_case comes without disturbance.

        Raises
        ------
        ValueError
            A parameter outside its range; the message names both.
        """
        config = self.config
        check_ranges(config, self.telescope)
        acts = config.scenario_acts and config.scenario != "worst_case"
        return PlantConfig.of(config, isolated=config.loop != "none", disturbance=acts)

    @cached_property
    def family(self) -> PlantFamily:
        """The telescopes with these parameters on this mounting."""
        from titop_plant.simulation.build import PlantFamily

        if self.known_family is not None:
            return self.known_family
        with one_thread():
            return PlantFamily.of(self.settings)

    @cached_property
    def start(self) -> RunStart:
        """Worst-case tone of the run and the states in which it starts."""
        config = self.config
        if self.recorded_start is not None:
            return self.recorded_start
        if config.other_plant:
            return AT_REST
        if not self.recorded and self.known_family is None and (start := from_runner(config.to_plain())) is not None:
            return start
        laws = self.linear
        if laws is None:
            return self._start_without_model()
        return self.find_start(laws)

    def find_start(self, laws: Mapping[str, SampledSystem], tone: WorstTone | None = None) -> RunStart:
        """Tone and states of the loop with these controllers, see :func:`los_testbed.parts.start.find_run_start`."""
        family = self._loop_with(laws)
        return find_run_start(self.config, family, self.settings, laws, self.basis.authority, tone)

    def _start_without_model(self) -> RunStart:
        """The tone that is worst without the controllers, and the telescope's steady state without them."""
        config = self.config
        opened = "isolator" if config.loop != "none" else "none"
        alone = RunParts(replace(config, k_fsm=None, k_pma=None, loop=opened), known_family=self.family).start
        if config.start == "rest" or alone.states is None:
            return alone
        sizes = (law.order for law in (self.k_fsm, self.k_pma))
        still = [np.zeros(n) for n in (self.ports.commands, *sizes, alone.states.camera.size)]
        states = replace(alone.states, **dict(zip(("command", "k_fsm", "k_pma", "camera"), still)))
        unknown = [text for name, text in self.code.items() if self.model_of(name) is None]
        note = SWITCHED_ON.format(" and ".join(unknown)) + (TONE_WITHOUT.format(opened) if alone.tone else "")
        return replace(alone, states=states, note=note, switched_on=True)

    def model_of(self, name: str) -> SampledSystem | None:
        """A controller as a linear system; None of code without a model."""
        law = getattr(self, name)
        model = law.linear if isinstance(law, UserBlock) else law
        return model if isinstance(model, SampledSystem) else None

    @property
    def linear(self) -> dict[str, SampledSystem] | None:
        """Both controllers as linear systems; None where one of them is code without a model."""
        laws = {name: self.model_of(name) for name in LAW_PORTS}
        models = {name: law for name, law in laws.items() if law is not None}
        return models if len(models) == len(laws) else None

    def _loop_with(self, laws: Mapping[str, SampledSystem]) -> PlantFamily:
        """Telescopes in the loop with these controllers."""
        rows = self.telescope_ports
        return self.family.with_ports(
            LoopPorts(rows.used_by(*laws.values()).sensors, self._commanded(rows.of_system("k_pma", laws["k_pma"])))
        )

    @cached_property
    def physical(self) -> PlantConfig:
        """Physical settings, with the worst-case tone; ValueError: a recorded start without the tone that it needs."""
        return with_tones(self.settings, self.start) if needs_tone(self.config) else self.settings

    def check(self) -> tuple[str, ...]:
        """Refuse controllers that cannot be used; lines on those made for other parameters or limits, on idle devices.

        Raises
        ------
        ValueError
            A file that is no controller, or one with other ports or another period; one that would close a loop and was
            made for another sensitivity of the mirror; user code that violates its contract.
        """
        if isinstance(self.k_fsm, SampledSystem):
            LosEstimator(self.k_fsm, self.used["k_fsm"])
        self.control_law()
        self._check_commanded()
        return (*self.compare(), *([self.idle_devices] if self.idle_devices else []))

    def _check_commanded(self) -> None:
        """Reject an actuator that a source drives and a controller commands."""
        commanded = [row.name for row in self.ports.actuators if row.mount is not None]
        for source in self.sources if commanded else ():
            if source.place in commanded:
                raise InputError(
                    f"actuator {source.place} must have one driver, got source {source.name} and k_pma "
                    f"{self.config.k_pma}"
                )

    def compare(self) -> tuple[str, ...]:
        """Differences between controllers and telescope, see :func:`compare_with_telescope`."""
        return compare_with_telescope(self.controllers, self.basis, self.config.loop)

    @property
    def idle_devices(self) -> str:
        """A line on sensors that no controller reads and actuators that nothing drives, if any.

        Actuators of the loop are those of the stage; of a controller without a model it is not known what it drives.
        """
        acting = [ports for name, ports in self.used.items() if self.acts(name)]
        used = [port.name for ports in acting for port in (*ports.measured, *ports.commanded)]
        rows = self.telescope_ports
        sources = [source.place for source in self.sources] if any(row.mount for row in rows.actuators) else []
        idle, loop = rows.idle([*used, *sources]), self.config.loop
        driven = {"mirror": ("k_fsm", MIRROR_STAGES), "proof-mass actuators": ("k_pma", FORCE_STAGES)}
        still = [what for what, (name, stages) in driven.items() if loop in stages and self._drives_nothing(name)]
        lines = [f"in the stage {loop} nothing drives the {' and the '.join(still)}"] if still else []
        if loop in FORCE_STAGES and not self._acts_by_forces:
            lines.append(f"in the stage {loop} pma_force moves nothing: the telescope has no proof masses")
        return "; ".join([*lines, *([idle] if idle else [])])

    @property
    def _acts_by_forces(self) -> bool:
        """Whether a force of K_PMA acts on the telescope; of another plant it is not known."""
        placed = any(row.mount is not None for row in self.used["k_pma"].actuators)
        return placed or bool(self.config.other_plant) or bool(self.telescope.pma.azimuths_deg)

    def _drives_nothing(self, name: str) -> bool:
        """Whether the outputs of a controller to the loop are zero whatever it measures."""
        law, size = self.model_of(name), total_size(LAW_PORTS[name][1])
        return law is not None and not (law.C[:size].any() or law.D[:size].any())

    @property
    def states(self) -> LoopStart | None:
        """States in which the run starts; None at rest, where nothing needs to be computed."""
        return None if self.config.start == "rest" else self.start.states

    def estimator(self) -> LosEstimator | UserBlock:
        """Observer; its reset leads to the start of the run. ValueError as :meth:`check`, for K_FSM."""
        design_warnings([self.k_fsm], self.basis, closed=self.config.loop in MIRROR_STAGES)
        law = self.k_fsm
        estimator = law if isinstance(law, UserBlock) else LosEstimator(law, self.used["k_fsm"])
        if self.states is not None:
            estimator.start_at(self.states.k_fsm, self.states.camera)
        return estimator

    def controller(self) -> FsmPmaController:
        """Mirror and proof-mass laws; the mirror's gain is that of the file of K_FSM.

        Its reset leads to the start of the run. ValueError as :meth:`check`.
        """
        self.compare()
        controller = self.control_law()
        if self.states is not None:
            controller.start_at(self.states.k_pma)
        return controller

    def control_law(self) -> FsmPmaController:
        """Mirror and proof-mass laws at rest; ValueError as :meth:`check`."""
        config = self.config
        return assemble_controller(
            self.controllers, self.basis, config.loop, self.used["k_pma"], fade_ticks=config.fade_ticks
        )

    def plant(self, *, recorded: bool = True) -> SteppedPlant:
        """Telescope, sampled at the tick rate, in the state in which the run starts; or the user's own plant.

        Parameters
        ----------
        recorded : bool
            Whether sensors that no controller uses are simulated, too, for a record.

        Raises
        ------
        ValueError
            A parameter outside its range; the message names both. A file that is no controller. A plant that cannot be
            made.
        """
        config = self.config
        if config.plant:
            return _user_plant(config)
        with one_thread():  # of all parts: their bits depend on the number of threads
            state = np.zeros(self.family.control_loop.order) if self.start.states is None else self.start.states.plant
            family = self.family.with_ports(self.ports if recorded else self.loop_ports)
            telescope = family.build(self.physical, state)
            source = config.disturbance_source if config.disturbance else None
            driven = telescope if source is None else self._driven(telescope, source, family)
            return self._with_images(self._with_limits(self.with_sources(driven, family), family.ports))

    @cached_property
    def telescope_ports(self) -> LoopPorts:
        """Rows of the telescope, at the run's frame rate; of another plant those of the stored laws."""
        rows = self.sampled_telescope.loop_ports
        return rows.used_by() if self.config.other_plant else rows

    @cached_property
    def used(self) -> dict[str, LoopPorts]:
        """Rows that ``k_fsm`` and ``k_pma`` use."""
        rows = self.telescope_ports
        return {
            name: law.ports if isinstance(law, UserBlock) and law.ports else rows.of_system(name, law)
            for name, law in self.controllers.items()
        }

    @cached_property
    def ports(self) -> LoopPorts:
        """Rows of the run: all sensors of the telescope, the mirror and what ``k_pma`` commands."""
        return LoopPorts(self.telescope_ports.sensors, self._commanded(self.used["k_pma"]))

    @property
    def loop_family(self) -> PlantFamily:
        """The telescopes with the rows of `loop_ports`."""
        return self.family.with_ports(self.loop_ports)

    @cached_property
    def loop_ports(self) -> LoopPorts:
        """Rows of the run without the sensors that no controller reads."""
        read = {row.name for ports in self.used.values() for row in ports.sensors}
        return replace(self.ports, sensors=tuple(row for row in self.ports.sensors if row.name in read))

    def _commanded(self, k_pma: LoopPorts) -> tuple[Actuator, ...]:
        """Actuators of a loop in the order of its command: the mirror, then those of ``k_pma``."""
        mirror = [row for row in self.telescope_ports.actuators if row.name == COMMANDED[0]]
        return (*mirror, *k_pma.actuators)

    def acts(self, name: str) -> bool:
        """Whether what a controller computes is used in the stage: estimates always, as they are recorded."""
        return name == "k_fsm" or self.config.loop in FORCE_STAGES

    def _with_limits(self, plant: Plant, ports: LoopPorts) -> Plant:
        """The telescope with limits of its devices, if configured."""
        if not self.config.nonlinear:
            return plant
        from titop_plant.simulation.device_limits import LimitedDevices

        devices = LimitedDevices(self.telescope.device_limits, self.telescope.pma, ports, plant.dt)
        return replace(plant, devices=devices)

    def _with_images(self, plant: Plant) -> Plant:
        """The telescope with the image camera, if the parameter file has one."""
        if self.star_camera is None:
            return plant
        camera = ImageCamera(self.star_camera, plant.frame_ticks, self.config.seed, self.config.noise)
        return replace(plant, camera=camera)

    @cached_property
    def star_camera(self) -> StarCamera | None:
        """Camera that takes images; None where it takes none."""
        if self.config.other_plant or not self.telescope.takes_images:
            return None
        table = self.telescope
        return star_camera(table.image_optics, table.camera, self.config.parameters or "reference.toml")

    @property
    def topics(self) -> tuple[TopicDefinition, ...]:
        """Topics of the run, those of the loop first."""
        camera = self.star_camera
        images = () if camera is None else (image_topic(camera.camera.window),)
        known = {topic.name for topic in TOPICS}
        every = (*sensor_topics(self.ports.sensors), *command_topics(self.ports.actuators))
        return (*TOPICS, *(topic for topic in every if topic.name not in known), *images)

    def disturbance(self) -> UserBlock:
        """Disturbance of the user; ValueError: it cannot be made, or breaks the contract."""
        from titop_plant.simulation.driven_plant import driven_ports

        return make_disturbance(self.config, driven_ports(self.telescope))

    def _driven(self, plant: Plant, source: str, family: PlantFamily) -> Plant:
        """The telescope under the disturbance of the user."""
        from titop_plant.simulation.driven_plant import DisturbanceInput, held_disturbance

        disturbance = self.disturbance()
        disturbance.reset()
        with one_thread():
            held = held_disturbance(family, self.physical, plant.dt)
            return replace(plant, inputs=(*plant.inputs, DisturbanceInput(held, disturbance, source)))

    def with_sources(self, plant: Plant, family: PlantFamily) -> Plant:
        """A telescope of a family under the sources of files, where there are any."""
        if not self.sources:
            return plant
        from titop_plant.disturbances.sources import Sources
        from titop_plant.simulation.driven_plant import DisturbanceInput
        from titop_plant.simulation.source_matrix import source_matrix

        drive, name = Sources(self.sources, plant.dt), f"sources {self.sources_digest[:12]}"
        with one_thread():
            held = source_matrix(family, self.physical, self.sources, plant.dt)
            return replace(plant, inputs=(*plant.inputs, DisturbanceInput(held, drive, name)))

    @cached_property
    def sources(self) -> tuple[PlacedSource, ...]:
        """Sources of disturbance of files; ValueError: one of them cannot be used."""
        if not (self._entries or self._mechanisms):
            return ()
        from los_testbed.parts.disturbance_files import make_sources
        from titop_plant.disturbances.mechanisms import mechanism_sources
        from titop_plant.disturbances.source_kinds import RunConditions

        profile = motion(self.settings, self.telescope)
        names = tuple(wheel.name for wheel in self.telescope.wheels)
        run = RunConditions(tuple(map(float, profile.speeds(0.0))), self.config.duration, self.config.seed, names)
        placed = make_sources(self._entries, self.telescope, run)
        if self._mechanisms:
            placed += mechanism_sources(self.telescope, profile, self.config.duration, self.config.seed)
        return placed

    @property
    def sources_digest(self) -> str:
        """SHA-256 of the tables and files of the sources; empty where there are none."""
        if not (self._entries or self._mechanisms):
            return ""
        from los_testbed.parts.disturbance_files import digest

        return digest(self._entries, self._mechanisms)

    @cached_property
    def _mechanisms(self) -> list[tuple[str, Mapping[str, Any]]]:
        """Tables of the telescope's wheels and drives that make disturbances; none without disturbance."""
        if not self.config.disturbance or self.config.plant or not self.config.parameters:
            return []

        return self.telescope.source_tables

    @cached_property
    def _entries(self) -> list[DisturbanceTable]:
        if not self.config.files_of_disturbance and not self.config.parameters:
            return []
        from los_testbed.parts.disturbance_files import sources_of

        return sources_of(self.config, self.telescope)

    def implemented_loop(self, values: Mapping[str, float] | None = None) -> ImplementedLoop:
        """Model of the loop of the stage, with the devices that the controllers use, some parameters at values.

        Raises
        ------
        ValueError
            User code, or a file that is missing or not a controller.
        """
        from los_loop.implemented_loop import ImplementedLoop
        from los_loop.open_loop import OpenLoop
        from titop_plant.telescope.control_plant import loop_plant

        laws, telescope = self.models, self.telescope
        ports = self.telescope_ports.used_by(*laws.values())
        with one_thread():
            plant = loop_plant(telescope, ports, isolated=self.family.isolated)
            # parameters with values have no channels of Delta, which would be closed at each frequency
            open_loop = OpenLoop(plant.substituted(self.family.known(values or {})), telescope, ports)
            return ImplementedLoop(open_loop, laws["k_fsm"], laws["k_pma"], self.config.loop)

    def tone_model(self, delays: Delays | None = None) -> ToneModel:
        """Model of the loop that runs, with its tones, for comparisons with a record; `delays` are those of a rig.

        Raises
        ------
        ValueError
            A telescope outside its family, a file that is missing or not a controller, user code.
        """
        from los_loop.sampled_loop import NONE
        from los_loop.tone_model import ToneModel

        loop, steady = self.config.loop, self.start.states is not None
        with one_thread():
            return ToneModel.of(
                self._loop_with(self.models),
                self.physical,
                self.models,
                loop=loop,
                authority=self.basis.authority,
                steady=steady,
                delays=delays or NONE,
            )


def _user_plant(config: RunConfig) -> SteppedPlant:
    plant: SteppedPlant = make(config)
    try:
        plant.reset()
    except RAISED as error:
        raise InputError(f"plant {config.plant}: reset must succeed, got {in_one_line(error)}") from error
    return plant


def build_plant(config: RunConfig) -> SteppedPlant:
    """Plant of a run, see :meth:`RunParts.plant`."""
    return RunParts(config).plant()


def build_estimator(config: RunConfig) -> LosEstimator | UserBlock:
    """Observer of a run, see :meth:`RunParts.estimator`."""
    return RunParts(config).estimator()


def build_controller(config: RunConfig) -> FsmPmaController:
    """Mirror and proof-mass laws of a run, see :meth:`RunParts.controller`."""
    return RunParts(config).controller()
