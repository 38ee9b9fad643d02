"""A spacecraft that is a file: an uncertain system with named ports in place of the assembly from blocks.

The table ``[plant]`` of a parameter file names it, a .mat file as :func:`lftkit.read_mat` reads it (of a ``uss`` of
MATLAB's Robust Control Toolbox) or a JSON file of :func:`lftkit.write_system`. **It includes the isolator, the mirror,
the proof-mass actuators and the attitude control**; sensors, their filters and noise, the controllers and the sampling
are the testbed's. Ports have the names, units and axes of :mod:`titop_plant.telescope.assembly`:

======================  ====================================================================================
input                   signals
======================  ====================================================================================
``wheel_imbalance``     5 for each wheel: forces and lateral torques in the wheel's frame [N, Nm]
``sadm_torque``         1 for each array drive [Nm], where there are drives
``fsm_command``         2, commanded angles of the mirror [rad]
``pma_force``           6 [N], where the telescope has proof-mass actuators
further ones            ``external_wrench``, ``wheel_torque`` and ``load_NODE`` where sources of a user act
======================  ====================================================================================

Outputs: ``accel_Ip``, ``accel_M1``, ``accel_M2`` (6 each), ``fsm_angle`` (2) and ``los_controlled`` (2), or ``los``
(2), the line of sight without the mirror. Blocks ``wheel_1.speed`` and ``solar_array.tau`` follow the motion of a run
(``--wheel-speed``, ``--theta``); any block has a value in a run by ``--set NAME=VALUE``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lftkit.errors import InputError
from lftkit.support.input_files import read_bytes
from lftkit.systems.ports import Port
from lftkit.uncertainty.elements import RealParameter
from titop_plant.interface import COMMAND_PORTS, TRUTH_PORTS
from titop_plant.sensors import GAUGE_PORT, MEASURED_SENSORS, port_alone
from titop_plant.telescope.uncertain_parameters import SPEED

if TYPE_CHECKING:
    from lftkit import System
    from titop_plant.telescope.tables.parameter_check import ParameterFile

PLANT = "plant"
"""Table ``[plant]`` of a user's file."""
FILE = "file"
"""Its key for the name of the file."""
LOS = Port("los", 2, "rad")


def take_plant(content: dict[str, Any], file: ParameterFile, folder: Path) -> dict[str, dict[str, str]]:
    """Take the table out of a user's file: ``{"plant": {"file": path}}``, or nothing where there is none.

    Raises
    ------
    ValueError
        Another key, no name, or a telescope with what such a plant cannot have.
    """
    table = content.pop(PLANT, None)
    if table is None:
        return {}
    if not isinstance(table, dict) or set(table) != {FILE} or not isinstance(table[FILE], str) or not table[FILE]:
        raise file.error(PLANT, f"must be a table with the name of a file, {FILE} = 'NAME', got {table!r}")
    for name in ("sensor", "actuator", "appendage", "uncertain"):
        if name in content:
            raise file.error(name, f"must be absent with [{PLANT}], whose file has all that is on board")
    return {PLANT: {FILE: str(folder / table[FILE])}}


def plant_system(
    path: str, disturbances: Sequence[Port], speeds: Sequence[str], forces: bool, los_sensitivity: float
) -> System:
    """The system of a file with the ports of an assembled telescope.

    Parameters
    ----------
    path : str
    disturbances : sequence of Port
        Imbalance of the wheels and torques of the drives that the other tables of the parameter file have.
    speeds : sequence of str
        Names of the blocks of the wheels' speeds, of which the file has all or none.
    forces : bool
        Whether the telescope has proof-mass actuators; without them ``pma_force`` is an input without effect.
    los_sensitivity : float
        Line of sight by the mirror's angle.

    Raises
    ------
    ValueError
        A file that is no continuous system of real parameters, or one that lacks a port or has it in another size or
        unit.
    """
    try:
        content = read_bytes(path)
    except OSError as error:
        raise InputError(f"cannot read the plant {path}: {error.strerror or error}") from None
    return _completed(path, content, tuple(disturbances), tuple(speeds), forces, los_sensitivity)


@lru_cache(maxsize=4)
def _completed(
    path: str, content: bytes, disturbances: tuple[Port, ...], speeds: tuple[str, ...], forces: bool, sensitivity: float
) -> System:
    from lftkit import append, connect, read_mat, read_system, static_gain

    system = read_system(path) if Path(path).suffix.lower() == ".json" else read_mat(path)
    system.require_real()
    if system.dt:
        raise InputError(f"{path}: the plant must be continuous, got the period {system.dt:g} s")
    mirror, force = COMMAND_PORTS
    known = {port.name: port for port in system.outputs}
    (truth,) = TRUTH_PORTS
    line = truth if truth.name in known else LOS
    measured = (Port(row.source, row.port.size, row.port.unit) for row in map(port_alone, MEASURED_SENSORS))
    outputs = dict.fromkeys([*(port for port in measured if port.name != truth.name), line])
    needed = {"input": (*disturbances, mirror, *((force,) if forces else ())), "output": tuple(outputs)}
    named = {
        kind: _with_units(path, kind, ports, system.inputs if kind == "input" else system.outputs)
        for kind, ports in needed.items()
    }
    system = replace(system, inputs=named["input"], outputs=named["output"])
    if force.name not in {port.name for port in system.inputs}:
        idle = static_gain(np.zeros((0, force.size)), [force], [])
        system = append(system, idle)
    if line is LOS:
        gauge = system.output_port(GAUGE_PORT)
        steering = static_gain(sensitivity * np.eye(LOS.size), [gauge], [LOS])
        every: dict[str, str | tuple[str, ...]] = {name: f"plant.{name}" for name in known}
        system = connect(
            {"plant": system, "steering": steering},
            [*((p.name, f"plant.{p.name}") for p in system.inputs), (f"plant.{gauge.name}", f"steering.{gauge.name}")],
            inputs=system.inputs,
            outputs={**every, truth.name: (f"plant.{LOS.name}", f"steering.{LOS.name}")},
        )
    turning = {e.name for e in system.elements if SPEED.fullmatch(e.name)}
    if turning and turning != set(speeds):  # those of some of the wheels, or other ones
        raise InputError(f"{path}: blocks must have {', '.join(speeds)} or none, got {', '.join(turning)}")
    return system.sorted_channels([e.name for e in system.elements])


def _with_units(path: str, kind: str, ports: Sequence[Port], stated: Sequence[Port]) -> tuple[Port, ...]:
    """The ports of a side, those that are needed with their units.

    Raises
    ------
    ValueError
        One of them is not there, or has another size or unit.
    """
    known = {port.name: port for port in stated}
    for port in ports:
        match = known.get(port.name)
        if match is None:
            raise InputError(f"{path}: the plant must have the {kind} {port.name}, got {', '.join(known)}")
        if match.size != port.size:
            raise InputError(f"{path}: {kind} {port.name} must have {port.size} signals, got {match.size}")
        if not port.takes(match):
            raise InputError(f"{path}: {kind} {port.name} must be in {port.unit}, got {match.unit}")
        known[port.name] = port
    return tuple(known.values())


def plant_parameters(system: System) -> Mapping[str, RealParameter]:
    """Uncertain parameters of the system by name, in the order of Delta."""
    return {e.name: e for e in system.parameters}
