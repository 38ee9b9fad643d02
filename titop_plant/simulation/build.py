"""From a configuration to the sampled simulation of the telescope."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from typing import Any

import numpy as np
from scipy import linalg

from lftkit import System
from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from lftkit.proofs.trusted.digests import digest
from lftkit.support.threads import one_thread
from titop_plant.disturbances.wheel_and_drive_tones import Tones, design_tones, loudest_speeds, no_tones
from titop_plant.interface import DT, TRUTH, frame_ticks
from titop_plant.simulation.constant_step import ConstantStep
from titop_plant.simulation.modal_plant import ModalPlant
from titop_plant.simulation.plant import Plant
from titop_plant.simulation.plant_config import PlantConfig, motion, parameter_values, steady, values_along
from titop_plant.simulation.plant_step import plant_step, step_matrix
from titop_plant.simulation.ramped_step import MovingTones, RampedStep, node_interval, node_matrices
from titop_plant.simulation.scenarios import FOLLOWING, TONES, Circumstances
from titop_plant.simulation.sensor_samples import SensorModel
from titop_plant.telescope.assembly import assembled_telescope
from titop_plant.telescope.control_plant import DISTURBANCES, control_loop_plant, disturbances_of, loop_plant
from titop_plant.telescope.layout import speed_names
from titop_plant.telescope.load import load_telescope
from titop_plant.telescope.loop_ports import LoopPorts
from titop_plant.telescope.placed.readings import SensorReadings
from titop_plant.telescope.telescope import Telescope

SPEED_ROUNDS = 4


@dataclass(frozen=True)
class PlantFamily:
    """The telescopes of one parameter file and one mounting: what all members share is made once.

    Parameters
    ----------
    telescope : Telescope
        Of the file.
    ports : LoopPorts
        Sensors and actuators of its loop, with commands in their units.
    control_loop : System
        Commands, disturbances (22 for the reference) to measurements, line of sight (2).
    path : str or None
        The file; None for the reference telescope.
    isolated : bool
    """

    telescope: Telescope
    ports: LoopPorts
    control_loop: System
    path: str | None
    isolated: bool
    _last: dict[tuple[tuple[str, float], ...], System] = field(default_factory=dict, repr=False, compare=False)
    _loops: dict[tuple[str, ...], tuple[System, dict[Any, System]]] = field(
        default_factory=dict, repr=False, compare=False
    )

    @classmethod
    def of(cls, config: PlantConfig) -> PlantFamily:
        """The family that a configuration belongs to, in a loop of the stored controllers."""
        telescope = load_telescope(config.parameters)
        ports = telescope.loop_ports.used_by()
        loop = loop_plant(telescope, ports, isolated=config.isolated)
        return cls(telescope, ports, loop, config.parameters, config.isolated)

    def with_ports(self, ports: LoopPorts) -> PlantFamily:
        """The same telescopes in a loop with other sensors and actuators of them; plants that were made are kept."""
        rows, self._loops[self._names(self.ports)] = ports.unscaled(), (self.control_loop, self._last)
        names = self._names(rows)
        if names not in self._loops:
            self._loops[names] = loop_plant(self.telescope, rows, isolated=self.isolated), {}
        loop, last = self._loops[names]
        return replace(self, ports=rows, control_loop=loop, _last=last)

    @staticmethod
    def _names(ports: LoopPorts) -> tuple[str, ...]:
        return tuple(port.name for port in (*ports.measured, *ports.commanded))

    def build(self, config: PlantConfig, start: FloatArray | None = None) -> Plant:
        """The member of a configuration, see :func:`build_plant`.

        Raises
        ------
        ValueError
            A configuration of another family; a value out of its range; a start of another size.
        """
        number, tones = self.plant_and_tones(config)
        state = _steady_state(number, tones) if start is None else start
        if state.shape != (number.A.shape[0],):
            raise InputError(f"start must hold {number.A.shape[0]} states, got {state.shape}")
        dynamics: ConstantStep | RampedStep
        if config.ramps:
            dynamics = RampedStep(*self.nodes(config, DT), state)
        else:
            dynamics = ConstantStep(plant_step(number, tones), state, np.unique(tones.frequency))
        sensors, readings = self._sensors(config), self._readings(config)
        return Plant(dynamics, sensors, self.ports.limits, self.name(config), readings=readings)

    def plant_and_tones(self, config: PlantConfig) -> tuple[System, Tones]:
        """The continuous plant at the start of a run, and the disturbance that acts on it.

        Returns
        -------
        plant : System
            Inputs: commands, disturbances; outputs: measurements, controlled line of sight (2).
        tones : Tones
            On the disturbance inputs.

        Raises
        ------
        ValueError
            A configuration of another family; a value out of its range.
        """
        if (config.parameters, config.isolated) != (self.path, self.isolated):
            raise InputError(
                f"config must have parameters {self.path} and isolated {self.isolated}, got {config.parameters} "
                f"and {config.isolated}"
            )
        first = parameter_values(config, self.telescope)
        return self._at(first), _tones(config, self.telescope, first)

    def _at(self, values: Mapping[str, float]) -> System:
        """The member at parameter values; the last one is kept, since a run needs it for start and simulation."""
        key = tuple(values.items())
        if key not in self._last:
            self._last.clear()
            self._last[key] = self.control_loop.at(self.known(values))
        return self._last[key]

    def known(self, values: Mapping[str, float]) -> dict[str, float]:
        """Those of some parameter values that the plant has: on a hard mounting none of the isolator."""
        names = {parameter.name for parameter in self.control_loop.parameters}
        return {name: value for name, value in values.items() if name in names}

    def tones(self, config: PlantConfig) -> Tones:
        """The disturbance of a configuration at the start of a run."""
        return _tones(config, self.telescope, parameter_values(config, self.telescope))

    def bias(self, config: PlantConfig) -> FloatArray:
        """Constant part of the measurement of a run [m/s2, rad/s2, rad]; zero without noise."""
        bias = self.ports.bias
        return np.asarray(bias if config.noise else np.zeros_like(bias))

    def _sensors(self, config: PlantConfig) -> SensorModel:
        """Noise and bias of the sensors without a mount, which are the first of the measurement."""
        rows = [row for row in self.ports.sensors if row.mount is None]
        sigma = float(config.noise) * np.concatenate([row.noise for row in rows])
        frame = frame_ticks(config.camera_rate or self.telescope.camera_rate)
        return SensorModel(sigma, self.bias(config)[: sigma.size], frame, config.camera_dropout, config.seed)

    def _readings(self, config: PlantConfig) -> SensorReadings | None:
        rows = [row for row in self.ports.sensors if row.mount is not None]
        return SensorReadings(rows, config.seed, config.noise) if rows else None

    def name(self, config: PlantConfig) -> str:
        """`Plant.parameters_hash` of a configuration, without building the plant."""
        settings = config.to_mapping()
        del settings["tau"]
        settings["theta"] = config.array_angle
        settings["camera_rate"] = config.camera_rate or self.telescope.camera_rate
        settings["wheel_acceleration"] = config.wheel_acceleration or steady(self.telescope)
        content: list[Any] = [self.telescope.parameters_hash, settings]
        if config.motion_from_file:
            content.append(motion(config, self.telescope).table())
        return digest(content)[:12]

    def nodes(self, config: PlantConfig, dt: float, finer: float = 1.0) -> tuple[list[FloatArray], int, MovingTones]:
        """Step matrices along the profile of a run, ticks between them, and the tones.

        Parameters
        ----------
        config : PlantConfig
        dt : float
            Tick [s].
        finer : float
            So many times as many nodes as usual.
        """
        profile = motion(config, self.telescope)
        unit = _unit_tones(config, self.telescope)
        if unit is None:
            unit = _tones(config, self.telescope, parameter_values(config, self.telescope))
        tones = MovingTones(profile, unit)
        interval = node_interval(profile, dt, finer)

        def matrices(time: float) -> FloatArray:
            data = self.control_loop.at(self.known(values_along(config, profile, time, self.telescope)))
            return step_matrix(data, tones.at(profile.speeds(time)), dt)

        return node_matrices(profile, interval, dt, matrices), interval, tones


def build_plant(config: PlantConfig, start: FloatArray | None = None) -> Plant:
    """The telescope of a configuration, sampled at 1 kHz.

    Parameters
    ----------
    config : PlantConfig
    start : ndarray, optional
        State at the start. Default: the steady motion that the disturbance makes without fine control, so that modes of
        hundreds of seconds need no settling.

    Raises
    ------
    ValueError
        A value out of its range; the message names the parameter. A start of another size.
    """
    return PlantFamily.of(config).build(config, start)


def resonant_speeds(path: str | None = None) -> tuple[float, ...]:
    """Speeds of the wheels [rad/s] at which their imbalance is strongest in the line of sight.

    The relative error of the fundamental of each wheel on the isolated telescope without fine control, its amplitude
    growing with the square of the speed, is largest there: the speeds are those of structural modes. Neighbouring
    wheels turn in opposite senses, as the default speeds do.

    Parameters
    ----------
    path : str, optional
        Parameter file; default: the reference telescope.
    """
    telescope = load_telescope(path)
    speeds = np.asarray(telescope.default_speeds, dtype=float)
    senses = np.sign(speeds)
    whole = assembled_telescope(telescope, True).system
    assembled = whole["los_controlled", disturbances_of(whole)]
    for _ in range(SPEED_ROUNDS):  # the speeds move the modes a little
        values = dict(zip(speed_names(len(speeds)), speeds))
        data = assembled.at({name: speed for name, speed in values.items() if name in telescope.uncertain})
        speeds = senses * loudest_speeds(telescope, data, senses)
    return tuple(float(round(s, 3)) for s in speeds)


def plant_and_tones(config: PlantConfig) -> tuple[System, Tones]:
    """Plant and disturbance of a run, see :meth:`PlantFamily.plant_and_tones`."""
    return PlantFamily.of(config).plant_and_tones(config)


def _tones(config: PlantConfig, telescope: Telescope, values: Mapping[str, float]) -> Tones:
    if not config.disturbance:
        return no_tones(telescope.channels)
    if config.ramps and (unit := _unit_tones(config, telescope)) is not None:
        return MovingTones(motion(config, telescope), unit).start()
    speeds = np.array(motion(config, telescope).speeds(0.0), dtype=float)
    return TONES[str(config.scenario)](_circumstances(config, telescope, values, speeds))


def _circumstances(
    config: PlantConfig, telescope: Telescope, values: Mapping[str, float], speeds: FloatArray
) -> Circumstances:
    kept = partial(_design_tones, telescope, tuple(values.items()), config.seed)
    return Circumstances(telescope, speeds, _phases(config.seed), config.tones, kept)


@lru_cache(maxsize=2)
def _isolated_loop(telescope: Telescope) -> System:
    with one_thread():
        return control_loop_plant(telescope)


@lru_cache(maxsize=2)
def _design_tones(telescope: Telescope, values: tuple[tuple[str, float], ...], seed: int) -> Tones:
    """Tones of the scenario design, kept for the other model of the same run: its start, or its plant."""
    with one_thread():
        data = _isolated_loop(telescope).at(dict(values))  # that of the run, unless the run has no isolator
        plant = ModalPlant.of(data, telescope.loop_ports.used_by().commands)
        los = plant.response.part(slice(-TRUTH, None), slice(None))
        tones = design_tones(telescope, los, _phases(seed))
    for array in (tones.frequency, tones.amplitude, tones.harmonic, tones.wheel):
        array.flags.writeable = False
    return tones


def _phases(seed: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(99,)))


def _unit_tones(config: PlantConfig, telescope: Telescope) -> Tones | None:
    """Tones of the wheels at 1 rad/s and of the drives; None where no tone follows a wheel."""
    if not config.disturbance or config.scenario not in FOLLOWING:
        return None
    return TONES[str(config.scenario)](_circumstances(config, telescope, {}, np.ones(len(telescope.wheels))))


def _steady_state(data: System, tones: Tones) -> FloatArray:
    drive = data.B[:, -len(tones.amplitude) :] @ tones.amplitude
    eye = np.eye(data.A.shape[0])
    state = np.zeros(data.A.shape[0])
    for k, w in enumerate(tones.frequency):
        state += linalg.solve(1j * w * eye - data.A, drive[:, k]).imag
    return state


__all__ = [
    "DISTURBANCES",
    "PlantConfig",
    "PlantFamily",
    "build_plant",
    "control_loop_plant",
    "parameter_values",
    "plant_and_tones",
    "resonant_speeds",
]
