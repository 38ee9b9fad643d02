"""From systems to the form in which a loop is proven."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lftkit import SampledSystem, System
from lftkit.analysis.eigenvectors import modal
from lftkit.errors import InputError
from lftkit.proofs.sampled_loop.model import LoopModel
from lftkit.proofs.trusted.proof import Interval


def loop_model(
    system: System,
    dt: float,
    controller: SampledSystem | None = None,
    *,
    commands: Sequence[str] = (),
    measurements: Sequence[str] = (),
    limit: float = 1.0,
    frames: Sequence[int] | None = None,
    bound_commands: bool = False,
) -> LoopModel:
    """The loop of a plant and a sampled controller that acts a tick late.

    Parameters
    ----------
    system : System
        Continuous plant. Its outputs that are no measurements are the errors, its inputs that are no commands are the
        disturbances.
    dt : float
        Tick [s]; without a controller any one, the proof reaches to pi / dt [rad/s].
    controller : SampledSystem, optional
        From the measurements to the commands; **u = K y**, no sign is added.
    commands, measurements : sequence of str
        Ports of the plant, in the order of the controller's signals.
    limit : float
        Gain that counts as 1.
    frames : sequence of int, optional
        Ticks for which each measured signal is held; 1 by default.
    bound_commands : bool
        Bound the commands in place of the errors.

    Returns
    -------
    LoopModel
        Its box has deviations from the nominal values: :func:`box_of`.

    Raises
    ------
    ValueError
        Unknown ports, a controller of another size, a plant whose poles can't be separated.
    """
    system.require_real()
    system.require_continuous()
    q = len(system.channels)
    errors = [p.name for p in system.outputs if p.name not in measurements]
    disturbances = [p.name for p in system.inputs if p.name not in commands]
    chosen = system.select(outputs=[*measurements, *errors], inputs=[*disturbances, *commands])
    y = sum(system.output_port(name).size for name in measurements)
    u = sum(system.input_port(name).size for name in commands)
    if controller is not None and (controller.D.shape != (u, y) or controller.dt != dt):
        raise InputError(f"controller must be {u} by {y} with dt {dt} s, got {controller.D.shape}, {controller.dt} s")
    if (u or y) and controller is None:
        raise InputError("commands and measurements need a controller, got none")
    poles, B, C = modal(chosen.A, chosen.B, chosen.C)
    if not np.all(np.isfinite(B)) or not np.all(poles.real < 0.0):
        raise InputError("the nominal plant must be stable, with poles that can be separated, got another")
    none = np.zeros((0, 0)), np.zeros((0, y)), np.zeros((u, 0))
    K_poles, K_B, K_C = modal(*(none if controller is None else (controller.A, controller.B, controller.C)))
    K_D = np.zeros((u, y)) if controller is None else np.asarray(controller.D)
    width = chosen.B.shape[1] - q - u
    rows = u if bound_commands else chosen.C.shape[0] - q - y
    groups = tuple(tuple(i for i, name in enumerate(chosen.channels) if name == p.name) for p in chosen.parameters)
    return LoopModel(
        dt,
        poles,
        C,
        B,
        np.asarray(chosen.D),
        K_poles,
        K_C,
        K_B,
        K_D,
        np.ones(y, dtype=np.int64) if frames is None else np.asarray(frames, dtype=np.int64),
        groups,
        (False,) * len(groups),
        np.tile([1.0, 1.0, 1.0], (width, 1)),
        0.0,
        tuple(range(rows)),
        limit,
        bound_commands,
    )


def box_of(system: System) -> tuple[Interval, ...]:
    """Deviations of the parameters from their nominal values, as a box."""
    return tuple((p.lower - p.nominal, p.upper - p.nominal) for p in system.parameters)
