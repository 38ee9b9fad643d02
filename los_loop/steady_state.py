"""The steady state in which a run of the implemented loop starts: tones and sensor bias, nothing left to decay.

Modes of the arrays ring for minutes and the washout answers the bias of the accelerometers for a minute: a run that is
evaluated from its first second on must start in the steady state **of the loop that runs**, with each sensor at its
rate and the commands one tick late. The loop is periodic (:class:`los_loop.sampled_loop.SampledLoop`); its steady state
under tones and a constant bias is one solve for each tone (:meth:`los_loop.tone_model.ToneModel.phasors`) and one for
the bias.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from los_loop.sampled_loop import SampledLoop
from los_loop.spec import state_parts
from los_loop.tone_model import ToneModel
from titop_plant.sensors import CAMERA_PORT


@dataclass(frozen=True)
class LoopStart:
    """States of the parts of the loop at tick 0, before its measurement.

    Parameters
    ----------
    plant : ndarray, shape (n,)
        State of the plant.
    command : ndarray, shape (u,)
        Command that tick 0 applies, within the limits of the actuators [rad, N].
    k_fsm, k_pma : ndarray
        States of the sampled controllers.
    camera : ndarray, shape (2,)
        Values of the camera that are held [rad].
    """

    plant: FloatArray
    command: FloatArray
    k_fsm: FloatArray
    k_pma: FloatArray
    camera: FloatArray

    def to_mapping(self) -> dict[str, list[float]]:
        """Plain values for JSON."""
        return {entry.name: getattr(self, entry.name).tolist() for entry in fields(self)}

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any]) -> LoopStart:
        """Read what :meth:`to_mapping` wrote.

        Raises
        ------
        ValueError
            A state is missing or no list of numbers.
        """
        try:
            return cls(**{entry.name: np.array(values[entry.name], float) for entry in fields(cls)})
        except (KeyError, TypeError) as error:
            raise InputError(f"a start must hold {', '.join(e.name for e in fields(cls))}, got {error}") from None


def steady_start(model: ToneModel, bias: FloatArray, orders: tuple[int, int]) -> LoopStart:
    """Steady state of the loop at tick 0.

    Parameters
    ----------
    model : ToneModel
        The loop with the tones of the run.
    bias : ndarray, shape (y,)
        Constant part of the measurement [m/s2, rad/s2, rad].
    orders : (int, int)
        Orders of K_FSM and K_PMA.

    Raises
    ------
    ValueError
        A loop that is not stable: it has no steady state.
    """
    radius = model.loop.growth
    if not radius < 1.0:
        raise InputError(
            f"the loop must be stable to have a steady state, got a growth factor of {radius:.6f} per tick"
        )
    n, commands = model.plant.order, model.loop.commands
    by_bias = bias_state(model.loop, bias)
    if not any(model.loop.at(k)[0][n : n + commands].any() for k in range(model.loop.frame_ticks)):
        by_bias[: n + commands] = 0.0  # nothing is commanded: exactly at rest, without what the solution rounds
    state = model.phasors().imag.sum(axis=1) + by_bias
    x, v, f, p, c = (state[part] for part in state_parts(n, *orders, model.loop.ports))
    return LoopStart(
        plant=model.plant.form.basis @ x,
        command=np.clip(v, -model.limits, model.limits),
        k_fsm=f,
        k_pma=p,
        camera=c[model.loop.ports.held_parts[CAMERA_PORT]],  # others have a sample at the first tick
    )


def bias_state(loop: SampledLoop, bias: FloatArray) -> FloatArray:
    """State at tick 0 in the periodic steady state that a constant `bias` of the measurement makes."""
    state: FloatArray = np.zeros(loop.hold.shape[0])
    for A, drive in map(loop.at, range(loop.frame_ticks)):
        state = A @ state + drive @ bias
    return loop.steady_state(np.zeros(1), state[:, None].astype(complex))[:, 0].real


__all__ = ["LoopStart", "bias_state", "steady_start"]
