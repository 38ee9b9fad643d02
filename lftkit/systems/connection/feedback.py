"""Series and feedback of models at given parameter values."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import linalg

from lftkit.errors import InputError
from lftkit.systems import lft
from lftkit.systems.arguments import checked
from lftkit.systems.arithmetic import common_period
from lftkit.systems.system import System


@checked
def cascade(first: System, second: System, name: str = "") -> System:
    """`second` after `first`: y = second(first(u)); sizes must match, the ports of both ends are kept."""
    if first.D.shape[0] != second.D.shape[1]:
        raise InputError(
            f"cascade: {first.name} has {first.D.shape[0]} outputs, {second.name} takes {second.D.shape[1]} inputs"
        )
    matrices, dt = lft.series(first.matrices, second.matrices), common_period([first, second])
    return System(*matrices, first.inputs, second.outputs, name or first.name, dt)


@checked
def close_loop(plant: System, controller: System, inputs: Sequence[str], outputs: Sequence[str]) -> System:
    """Closed loop from `inputs` to `outputs` with the controller between the plant's ports of the same names.

    **Sign: u = + K y.** The controller's inputs are plant outputs, its outputs plant inputs, by name.

    Raises
    ------
    ValueError
        A port that the plant does not have, sizes that differ, a loop that is not well posed.
    """
    y, u = [p.name for p in controller.inputs], [p.name for p in controller.outputs]
    cu, ry = plant.input_indices(u), plant.output_indices(y)
    cw, rz = plant.input_indices(inputs), plant.output_indices(outputs)
    if (len(cu), len(ry)) != controller.D.shape:
        raise InputError(
            f"{controller.name} is {controller.D.shape[0]} x {controller.D.shape[1]}, the plant's ports "
            f"{u} and {y} need {len(cu)} x {len(ry)}"
        )
    A, B, C, D = plant.matrices
    Ak, Bk, Ck, Dk = controller.matrices
    B2, C2, D12, D21, D22 = B[:, cu], C[ry], D[np.ix_(rz, cu)], D[np.ix_(ry, cw)], D[np.ix_(ry, cu)]
    loop = np.eye(len(cu)) - Dk @ D22
    if np.abs(linalg.det(loop)) < 1e-12:
        raise InputError(f"the loop of {plant.name} and {controller.name} is not well posed (I - D_K D_22 singular)")
    E = linalg.inv(loop)
    X, U, W = E @ Dk @ C2, E @ Ck, E @ Dk @ D21  # u = X x + U x_K + W w
    Acl = np.block([[A + B2 @ X, B2 @ U], [Bk @ (C2 + D22 @ X), Ak + Bk @ D22 @ U]])
    Bcl = np.vstack([B[:, cw] + B2 @ W, Bk @ (D21 + D22 @ W)])
    Ccl = np.hstack([C[rz] + D12 @ X, D12 @ U])
    ports_in = {p.name: p for p in plant.inputs}
    ports_out = {p.name: p for p in plant.outputs}
    return System(
        Acl,
        Bcl,
        Ccl,
        D[np.ix_(rz, cw)] + D12 @ W,
        tuple(ports_in[n] for n in inputs),
        tuple(ports_out[n] for n in outputs),
        f"{plant.name} with {controller.name}",
        common_period([plant, controller]),
    )
