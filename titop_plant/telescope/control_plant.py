"""The telescope as the fine line-of-sight control sees it: sensors with their filters and noise.

=======================  ====  ===================================================================
input                    size  meaning
=======================  ====  ===================================================================
``wheel_imbalance``      20    [N], [Nm]; ``sadm_torque`` 2 [Nm]
``accelerometer_noise``  18    white, density 1 (two-sided): scaled by sigma sqrt(dt) inside
``optical_noise``        4     camera 2, strain gauges 2, the same
``fsm_command``          2     [rad]; ``pma_force`` 6 [N]
=======================  ====  ===================================================================

=======================  ====  ===================================================================
output                   size  meaning
=======================  ====  ===================================================================
``los_controlled``       2     [rad]
``accel_Ip`` and so on   18    behind the washout F_w, with noise
``camera_los``           2     behind F_LOS, with noise [rad]
``fsm_angle``            2     with noise [rad]
=======================  ====  ===================================================================

Noise is given in the parameter file as the standard deviation of samples at 1 kHz: its two-sided density is
sigma^2 dt. Source: the paper, "Fine LOS control".
"""

from __future__ import annotations

import numpy as np

from lftkit import Connection, Port, UncertainSystem, connect, state_space, static_gain
from lftkit.systems.delay import delayed_port
from lftkit.systems.filters import high_pass
from titop_plant.interface import ACCELERATIONS, ACCELEROMETERS, COMMANDED, DT, MEASURED, MEASUREMENTS
from titop_plant.telescope.parameters import Parameters
from titop_plant.telescope.sensors import noise_of_samples, sensors

DISTURBANCES = ("wheel_imbalance", "sadm_torque")
ACCELEROMETER_NOISE = Port("accelerometer_noise", ACCELERATIONS.stop)
OPTICAL_NOISE = Port("optical_noise", MEASUREMENTS - ACCELERATIONS.stop)
"""Noise of the measurements: of the accelerometers; of camera and strain gauges."""

PADE_ORDER = 2
"""Of the delays in the plant: right to 2e-4 rad where they turn the phase by less than 0.7 rad."""


def with_camera(system: UncertainSystem, parameters: Parameters) -> UncertainSystem:
    """Add the camera's low-pass F_LOS: output ``camera_los`` from ``los_controlled``; four states."""
    c0, c1, c2 = parameters["sensors"]["camera_filter"]
    A = np.kron(np.eye(2), [[0.0, 1.0], [-c2, -c1]])
    B = np.kron(np.eye(2), [[0.0], [1.0]])
    C = np.kron(np.eye(2), [[c0, 0.0]])
    los, camera = system.output_port("los_controlled"), Port("camera_los", 2, "rad")
    low_pass = state_space(A, B, C, np.zeros((2, 2)), [los], [camera])
    return connect(
        {"telescope": system, "camera": low_pass},
        [
            *((p.name, f"telescope.{p.name}") for p in system.inputs),
            ("telescope.los_controlled", "camera.los_controlled"),
        ],
        inputs=system.inputs,
        outputs={**{p.name: f"telescope.{p.name}" for p in system.outputs}, camera.name: "camera.camera_los"},
    )


def camera_hold(period: float) -> UncertainSystem:
    """Mean age of a camera value that is held for a period [s], both axes.

    The value is used at the ticks, from the one with the frame to the last before the next frame: half of the period
    less one tick.
    """
    if not period >= 0.0:
        raise ValueError(f"camera period must not be negative, got {period} s")
    return delayed_port(Port("camera_los", 2, "rad"), max(0.0, 0.5 * (period - DT)), PADE_ORDER)


def held_commands(plant: UncertainSystem, hold: float) -> UncertainSystem:
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
        direct = plant[ACCELEROMETERS, (command.name,)].data_at({}).D
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


def control_plant(
    telescope: UncertainSystem, parameters: Parameters, *, camera_period: float = 0.0, command_hold: float = 0.0
) -> UncertainSystem:
    """Generalised plant of the fine control (ports: see the module); 204 + 4 + 18 states.

    Parameters
    ----------
    telescope : UncertainSystem
        From :func:`titop_plant.telescope.assembly.build_telescope`.
    parameters : mapping
        Table ``sensors``.
    camera_period : float
        Time between camera frames, whose value is held [s]: adds its mean age, see :func:`camera_hold`, as a
        Pade form of order 2 for each axis (4 states). 0: a continuous camera, as in the paper.
    command_hold : float
        Mean delay of commands that are held for a tick [s], see :func:`held_commands` (16 states).
    """
    seen = with_camera(telescope, parameters).select(
        inputs=(*DISTURBANCES, *COMMANDED), outputs=("los_controlled", *MEASURED)
    )
    seen = held_commands(seen, command_hold)
    sigma, root = noise_of_samples(parameters), np.sqrt(DT)
    corners = {sensor.port.name: sensor.washout for sensor in sensors(parameters)}
    noise, optical = ACCELEROMETER_NOISE, OPTICAL_NOISE
    ports = [seen.output_port(name) for name in ACCELEROMETERS]
    systems = {
        "plant": seen,
        "noise": static_gain(np.diag(sigma[ACCELERATIONS]) * root, [noise], ports),
        "optical": static_gain(
            np.diag(sigma[ACCELERATIONS.stop :]) * root,
            [optical],
            [seen.output_port("camera_los"), seen.output_port("fsm_angle")],
        ),
    }
    wires: list[Connection] = [
        *((p.name, f"plant.{p.name}") for p in seen.inputs),
        (noise.name, "noise.accelerometer_noise"),
        (optical.name, "optical.optical_noise"),
    ]
    outputs: dict[str, str | tuple[str, ...]] = {"los_controlled": "plant.los_controlled"}
    for port in ports:
        systems[f"washout_{port.name}"] = high_pass(port, corners[port.name])
        wires.append(((f"plant.{port.name}", f"noise.{port.name}"), f"washout_{port.name}.{port.name}"))
        outputs[port.name] = f"washout_{port.name}.{port.name}"
    systems["hold"] = camera_hold(camera_period)
    wires.append((("plant.camera_los", "optical.camera_los"), "hold.camera_los"))
    outputs["camera_los"] = "hold.camera_los"
    outputs["fsm_angle"] = ("plant.fsm_angle", "optical.fsm_angle")
    external = [seen.input_port(name) for name in DISTURBANCES] + [noise, optical]
    external += [seen.input_port(name) for name in COMMANDED]
    return connect(systems, wires, inputs=external, outputs=outputs)
