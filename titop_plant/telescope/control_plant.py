"""The telescope as the fine line-of-sight control sees it: sensors with their filters and noise.

=======================  ====  ===================================================================
input                    size  meaning
=======================  ====  ===================================================================
``wheel_imbalance``      20    [N], [Nm], 5 for each wheel; ``sadm_torque`` 2 [Nm], 1 for each array drive
``accelerometer_noise``  18    white, density 1 (two-sided): scaled by sigma sqrt(dt) inside
``optical_noise``        4     of the other sensors in the order of the measurement, the same
``fsm_command``          2     [rad]; ``pma_force`` 6 [N]
=======================  ====  ===================================================================

=======================  ====  ===================================================================
output                   size  meaning
=======================  ====  ===================================================================
``los_controlled``       2     [rad]
accelerations            18    behind the washout F_w, with noise
other measured ports     4     behind their low-pass (F_LOS of the camera), with noise
=======================  ====  ===================================================================

The sensors are those of :mod:`titop_plant.sensors`. Noise is given in the parameter file as the standard deviation
of samples at 1 kHz: its two-sided density is sigma^2 dt. Source: the paper, "Fine LOS control".
"""

from __future__ import annotations

import numpy as np

from lftkit import Connection, Port, System, connect, state_space, static_gain, transform
from lftkit.errors import InputError
from lftkit.systems.connection.filters import high_pass
from lftkit.systems.delay import delayed_port
from lftkit.systems.ports import total_size
from titop_plant.blocks.uncertain_gain import uncertain_gain
from titop_plant.interface import (
    ACCELERATIONS,
    ACCELEROMETERS,
    COMMANDED,
    DT,
    MEASURED,
    MEASURED_PORTS,
)
from titop_plant.telescope.assembly import assembled_telescope, build_telescope
from titop_plant.telescope.layout import SADM_TORQUE, WHEEL_IMBALANCE, present
from titop_plant.telescope.loop_ports import LINE_OF_SIGHT, LoopPorts
from titop_plant.telescope.tables.uncertain import GAIN
from titop_plant.telescope.telescope import Telescope

DISTURBANCES = (WHEEL_IMBALANCE, SADM_TORQUE)
"""Micro-vibrations; a telescope without array drives has the first port alone, see :func:`disturbances_of`."""
ACCELEROMETER_NOISE = Port("accelerometer_noise", ACCELERATIONS.stop)
OPTICAL_NOISE = Port("optical_noise", total_size(MEASURED_PORTS) - ACCELERATIONS.stop)
"""Noise of the measurements: of the accelerometers; of the other sensors."""

NOISE_PORTS = {name: (ACCELEROMETER_NOISE if name in ACCELEROMETERS else OPTICAL_NOISE).name for name in MEASURED}
"""Input of the noise of each measured port."""

PADE_ORDER = 2
"""Of the delays in the plant: right to 2e-4 rad where they turn the phase by less than 0.7 rad."""


def disturbances_of(system: System) -> tuple[str, ...]:
    """Those of `DISTURBANCES` that a telescope has."""
    return present(DISTURBANCES, system.inputs)


def with_sensors(system: System, telescope: Telescope) -> System:
    """Add the measured ports that the structure does not have, behind their low-pass (two states for each value).

    Gains of sensors that are uncertain are behind it.

    Raises
    ------
    ValueError
        A plant of a file without an output that a sensor measures.
    """
    systems, wires = {"telescope": system}, list[Connection]((p.name, f"telescope.{p.name}") for p in system.inputs)
    outputs: dict[str, str | tuple[str, ...]] = {p.name: f"telescope.{p.name}" for p in system.outputs}
    known = telescope.factors
    for sensor in telescope.loop_ports.sensors:
        port, source = sensor.port, system.output_port(sensor.source)
        outputs[port.name] = f"telescope.{source.name}"
        if sensor.mount is not None and not sensor.mount.accelerates:
            systems[port.name] = static_gain(sensor.mount.rows, [source], [port])
        elif sensor.low_pass:
            # c0 / (s^2 + c1 s + c2) from each value of source to that of port
            c0, c1, c2 = sensor.low_pass
            each = np.eye(port.size)
            A = np.kron(each, [[0.0, 1.0], [-c2, -c1]])
            B = np.kron(each, [[0.0], [1.0]])
            C = np.kron(each, [[c0, 0.0]])
            systems[port.name] = state_space(A, B, C, np.zeros((port.size, port.size)), [source], [port])
        if port.name in systems:
            wires.append((f"telescope.{source.name}", f"{port.name}.{source.name}"))
            outputs[port.name] = f"{port.name}.{port.name}"
        factor = known.get(f"{port.name}.{GAIN}")
        if factor is not None:
            block = f"{GAIN}_{port.name}"
            systems[block] = uncertain_gain(port, factor)
            wires.append((outputs[port.name], f"{block}.{port.name}"))
            outputs[port.name] = f"{block}.{port.name}"
    seen = connect(systems, wires, inputs=system.inputs, outputs=outputs)
    return seen.sorted_channels(list(telescope.uncertain)) if known else seen


def sample_hold(port: Port, period: float) -> System:
    """Mean age of a value that is held for a period [s].

    The value is used at the ticks, from the one with the sample to the last before the next: half of the period less
    one tick.
    """
    if not period >= 0.0:
        raise InputError(f"period of {port.name} must not be negative, got {period} s")
    return delayed_port(port, max(0.0, 0.5 * (period - DT)), PADE_ORDER)


def held_commands(plant: System, hold: float) -> System:
    """Delay the motion by the mean delay `hold` [s] of commands that are held for a tick.

    The motion lags by half a tick. An accelerometer responds to a command at the instant it is switched: its direct
    path has no such lag. The difference matters, since below the structure's modes the direct path and the motion
    cancel. The direct path is that of the nominal parameters.
    """
    if hold == 0.0:
        return plant
    felt_by = [plant.output_port(name) for name in ACCELEROMETERS]
    systems = {"plant": plant}
    wires: list[Connection] = [(p.name, f"plant.{p.name}") for p in plant.inputs if p.name not in COMMANDED]
    felt: dict[str, list[str]] = {port.name: [f"plant.{port.name}"] for port in felt_by}
    for command in (plant.input_port(name) for name in COMMANDED):
        direct = plant[ACCELEROMETERS, (command.name,)].at({}).D
        late, now, past = (f"{what}_{command.name}" for what in ("late", "now", "past"))
        systems[late] = delayed_port(command, hold, PADE_ORDER)
        systems[now] = systems[past] = static_gain(direct, [command], felt_by)
        lagging = f"{late}.{command.name}"
        wires += [
            (command.name, f"{late}.{command.name}"),
            (lagging, f"plant.{command.name}"),
            (command.name, f"{now}.{command.name}"),
            (lagging, f"{past}.{command.name}"),
        ]
        for port in felt_by:
            felt[port.name] += [f"{now}.{port.name}", f"-{past}.{port.name}"]
    outputs: dict[str, str | tuple[str, ...]] = {p.name: f"plant.{p.name}" for p in plant.outputs}
    outputs |= {name: tuple(parts) for name, parts in felt.items()}
    return connect(systems, wires, inputs=plant.inputs, outputs=outputs)


def control_plant(telescope: Telescope, *, sampled: bool = False, command_hold: float = 0.0) -> System:
    """Generalised plant of the fine control (ports: see the module); 204 + 4 + 18 states.

    Parameters
    ----------
    telescope : Telescope
    sampled : bool
        Whether sensors that are slower than the tick have samples, which are held: adds the mean age of their values,
        see :func:`sample_hold`, as a Pade form of order 2 for each (4 states for the camera). Otherwise all sensors are
        continuous, as in the paper.
    command_hold : float
        Mean delay of commands that are held for a tick [s], see :func:`held_commands` (16 states).
    """
    assembled = assembled_telescope(telescope).system
    seen = with_sensors(assembled, telescope).select(
        inputs=(*disturbances_of(assembled), *COMMANDED), outputs=("los_controlled", *MEASURED)
    )
    seen = held_commands(seen, command_hold)
    sigma, root = telescope.loop_ports.used_by().noise, np.sqrt(DT)
    noise, optical = ACCELEROMETER_NOISE, OPTICAL_NOISE
    ports = {name: seen.output_port(name) for name in MEASURED}
    others = [port for name, port in ports.items() if name not in ACCELEROMETERS]
    systems = {
        "plant": seen,
        "noise": static_gain(np.diag(sigma[ACCELERATIONS]) * root, [noise], [ports[name] for name in ACCELEROMETERS]),
        "optical": static_gain(np.diag(sigma[ACCELERATIONS.stop :]) * root, [optical], others),
    }
    wires: list[Connection] = [
        *((p.name, f"plant.{p.name}") for p in seen.inputs),
        (noise.name, "noise.accelerometer_noise"),
        (optical.name, "optical.optical_noise"),
    ]
    outputs: dict[str, str | tuple[str, ...]] = {"los_controlled": "plant.los_controlled"}
    for sensor in telescope.sensors:
        name, port = sensor.port.name, ports[sensor.port.name]
        noisy = f"plant.{name}", f"{'noise' if name in ACCELEROMETERS else 'optical'}.{name}"
        behind = f"behind_{name}"
        if sensor.washout:
            systems[behind] = high_pass(port, sensor.washout)
        elif sensor.framed:
            systems[behind] = sample_hold(port, sensor.ticks * DT if sampled else 0.0)
        outputs[name] = noisy
        if behind in systems:
            wires.append((noisy, f"{behind}.{name}"))
            outputs[name] = f"{behind}.{name}"
    external = [seen.input_port(name) for name in disturbances_of(seen)] + [noise, optical]
    external += [seen.input_port(name) for name in COMMANDED]
    return connect(systems, wires, inputs=external, outputs=outputs)


def control_loop_plant(telescope: Telescope, *, isolated: bool = True) -> System:
    """The plant of a loop with the stored controllers, see :func:`loop_plant`."""
    return loop_plant(telescope, telescope.loop_ports.used_by(), isolated=isolated)


def loop_plant(telescope: Telescope, ports: LoopPorts, *, isolated: bool = True) -> System:
    """The plant of a loop: its commands, then the disturbances, to its measurements, then the line of sight (2).

    Continuous; the camera's low-pass is in it, noise and the controllers' washout are not.

    Parameters
    ----------
    telescope : Telescope
    ports : LoopPorts
        Rows of the telescope that the loop has. Commands are in units of their scale.
    isolated : bool
        Whether the payload is on its isolator.
    """
    placed = any(row.mount is not None for row in ports.actuators)
    assembled = (
        build_telescope(telescope, isolated=isolated, motors=True)
        if placed
        else assembled_telescope(telescope, isolated)
    )
    whole = with_sensors(assembled.system, telescope)
    selected = whole.select(
        inputs=(*(port.name for port in ports.commanded), *disturbances_of(whole)),
        outputs=(*(port.name for port in ports.measured), LINE_OF_SIGHT),
    )
    scaled = {row.name: (row.scale * np.eye(row.port.size), row.port) for row in ports.actuators if row.scale != 1.0}
    return transform(selected, inputs=scaled) if scaled else selected
