"""Flexible body with one parent point P and any number of child points C.

=================  ====  ===========================================================================
input              size  meaning
=================  ====  ===========================================================================
``accel_P``        6     acceleration twist imposed by the parent at P [m/s2, rad/s2]
``wrench_C``       6     wrench applied *on* the body at each child point C [N, Nm]
``angle_P``        3     rotation of P [rad], with ``motion=True`` only
``rate_P``         3     angular rate of P [rad/s], with ``motion=True`` only
=================  ====  ===========================================================================

=================  ====  ===========================================================================
output             size  meaning
=================  ====  ===========================================================================
``wrench_P``       6     wrench applied *by* the body on its parent at P
``accel_C``        6     acceleration twist of each child point
``angle_C``        3     rotation of each child point, with ``motion=True`` only
``rate_C``         3     angular rate of each child point, with ``motion=True`` only
``deflection_C``   6     elastic deflection of the children named in `deflections` [m, rad]
=================  ====  ===========================================================================

Rotation and rate are passed on beside the acceleration so that they are integrated once, at the root of
the spacecraft; a second integrator elsewhere would add uncontrollable states at zero.

Assumptions: small motion, mass-normalised modes clamped at P, modal damping, no gyroscopic terms.
Source: the paper, "The TITOP framework"; Alazard, Perez, Cumer, Loquen (2015).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np

from lftkit import RealParameter, System
from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from titop_plant import ports
from titop_plant.structures.modal_data import ModalData


def flexible_body(
    data: ModalData,
    *,
    motion: bool = False,
    deflections: Collection[str] = (),
    frequencies: Mapping[int, RealParameter] | None = None,
    dampings: Mapping[int, RealParameter] | None = None,
    relative: Collection[str] = (),
) -> System:
    """TITOP block of a flexible body (ports and assumptions: see the module).

    Parameters
    ----------
    data : ModalData
        Body with n modes.
    motion : bool
        Add the ports that pass rotation and rate of the parent on to the children.
    deflections : collection of str
        Children whose elastic deflection is an output.
    frequencies, dampings : mapping
        Mode index to the parameter that replaces the frequency [rad/s] (2 occurrences) or the damping
        ratio (1 occurrence) of this mode.
    relative : collection of str
        Names of the parameters that are factors of the values of `data`; several modes may share one.

    Returns
    -------
    System
        2n states ``[eta; eta']``. **wrench_P is by the body on its parent, wrench_C on the body.**

    Raises
    ------
    ValueError
        Unknown mode index or child name.

    Examples
    --------
    The low-frequency mass is the rigid mass, whatever the modes:

    >>> import numpy as np
    >>> from titop_plant.structures.modal_data import ModalData, from_inertia
    >>> M = from_inertia(5.0, np.eye(3), [0.0, 0.0, 0.0])
    >>> body = ModalData("slider", "P", np.zeros(3), M, [2.0], [0.01], np.sqrt(2.0) * np.eye(1, 6))
    >>> slow = flexible_body(body).nominal()(0)
    >>> round(float(-slow[0, 0].real), 9)
    5.0
    """
    n = data.n_modes
    omega, zeta = dict(frequencies or {}), dict(dampings or {})
    for mode in (*omega, *zeta):
        if not 0 <= mode < n:
            raise InputError(f"{data.name}: mode index must be in 0..{n - 1}, got {mode}")
    for name in deflections:
        data.child(name)
    w, z = data.frequencies.copy(), data.damping.copy()
    units = (np.ones(n), np.ones(n))
    for values, unit, known in zip((w, z), units, (omega, zeta)):
        for mode, parameter in known.items():
            unit[mode] = values[mode] if parameter.name in relative else 1.0
            values[mode] = unit[mode] * parameter.nominal
    channels, Bd, Cd = _modal_parameters(n, w, z, omega, zeta, units)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-np.diag(w**2), -np.diag(2 * z * w)]])
    # Modal forces per input; per output the factor of eta'' and the rigid part
    taus = [data.child_tau(child.name) for child in data.children]
    forcing = np.hstack([-data.participation, *(c.shapes.T for c in data.children)])
    acc = np.vstack([-data.participation.T, *(c.shapes for c in data.children)])
    size = 6 * (1 + len(taus))
    direct = np.zeros((size, size))
    direct[:6, :6] = -data.mass_matrix
    for i, tau in enumerate(taus, start=1):
        direct[:6, 6 * i : 6 * i + 6] = tau.T
        direct[6 * i : 6 * i + 6, :6] = tau
    # eta'' = lower half of A x + Bd w + forcing u ; every output is acc @ eta'' + direct @ u (+ states)
    q, m = len(channels), forcing.shape[1]
    lower = np.hstack([Bd[n:], forcing])
    C = acc @ A[n:]
    D = acc @ lower
    D[:, q:] += direct
    inputs = [ports.accel(data.parent), *(ports.wrench(c.name) for c in data.children)]
    outputs = [ports.wrench(data.parent), *(ports.accel(c.name) for c in data.children)]
    B = np.vstack([np.zeros((n, q + m)), lower])
    if motion:
        B = np.hstack([B, np.zeros((2 * n, 6))])
        D = np.hstack([D, np.zeros((D.shape[0], 6))])
        inputs += [ports.angle(data.parent), ports.rate(data.parent)]
        for child in data.children:
            C, D = _append_motion(C, D, child.shapes[3:], n)
            outputs += [ports.angle(child.name), ports.rate(child.name)]
    for name in deflections:
        C = np.vstack([C, np.hstack([data.child(name).shapes, np.zeros((6, n))])])
        D = np.vstack([D, np.zeros((6, D.shape[1]))])
        outputs.append(ports.deflection(name))
    parameters = tuple({p.name: p for p in (*omega.values(), *zeta.values())}.values())
    C, D = np.vstack([Cd[0], C]), np.vstack([np.hstack([Cd[1], np.zeros((q, D.shape[1] - q))]), D])
    return System(A, B, C, D, tuple(inputs), tuple(outputs), channels=channels, elements=parameters)


def _modal_parameters(
    n: int,
    w: FloatArray,
    z: FloatArray,
    omega: Mapping[int, RealParameter],
    zeta: Mapping[int, RealParameter],
    units: tuple[FloatArray, FloatArray],
) -> tuple[tuple[str, ...], FloatArray, tuple[FloatArray, FloatArray]]:
    """Delta channels of ``eta'' = -omega (omega eta + 2 zeta eta') + f``, parameters in `units` of both.

    The inner product omega eta is the first occurrence of omega, the outer product the second; zeta is between them.
    """
    channels: list[str] = []
    columns: list[FloatArray] = []
    rows: list[FloatArray] = []
    feed: dict[tuple[int, int], float] = {}
    for mode in sorted({*omega, *zeta}):
        eta, rate = np.eye(1, 2 * n, mode)[0], np.eye(1, 2 * n, n + mode)[0]
        inner: list[int] = []  # channels that add to omega eta + 2 zeta eta'
        if mode in omega:
            inner.append(len(channels))
            channels.append(omega[mode].name)
            columns.append(-w[mode] * rate)
            rows.append(units[0][mode] * eta)
        if mode in zeta:
            inner.append(len(channels))
            channels.append(zeta[mode].name)
            columns.append(-w[mode] * rate)
            rows.append(2.0 * units[1][mode] * rate)
        if mode in omega:
            for i in inner:
                feed[(len(channels), i)] = units[0][mode]
            channels.append(omega[mode].name)
            columns.append(-rate)
            rows.append(units[0][mode] * (w[mode] * eta + 2.0 * z[mode] * rate))
    q = len(channels)
    Ddd = np.zeros((q, q))
    for (row, column), value in feed.items():
        Ddd[row, column] = value
    Bd = np.array(columns).T.reshape(2 * n, q)
    return tuple(channels), Bd, (np.array(rows).reshape(q, 2 * n), Ddd)


def _append_motion(C: FloatArray, D: FloatArray, rotation_shapes: FloatArray, n: int) -> tuple[FloatArray, FloatArray]:
    """Rows ``angle_C = angle_P + Phi_rot eta`` and ``rate_C = rate_P + Phi_rot eta'``."""
    zero = np.zeros((3, n))
    rows = np.block([[rotation_shapes, zero], [zero, rotation_shapes]])
    through = np.hstack([np.zeros((6, D.shape[1] - 6)), np.eye(6)])
    return np.vstack([C, rows]), np.vstack([D, through])


def rigid_body(
    name: str,
    parent: str,
    mass_matrix: FloatArray,
    children: Mapping[str, FloatArray] | None = None,
    *,
    motion: bool = False,
) -> System:
    """Rigid body: a flexible body without modes.

    Parameters
    ----------
    name, parent : str
        Body and parent point.
    mass_matrix : ndarray, shape (6, 6)
        At the parent point, see :func:`titop_plant.structures.modal_data.from_inertia`.
    children : mapping
        Child point to its position (3,) relative to the parent point [m].
    motion : bool
        As for :func:`flexible_body`.

    Examples
    --------
    A push at a child point 1 m out turns the body about its parent by F times the lever arm:

    >>> import numpy as np
    >>> body = rigid_body("rod", "P", np.eye(6), {"C": np.array([1.0, 0.0, 0.0])})
    >>> D = body["wrench_P", "wrench_C"].nominal().D
    >>> float(D[5, 1])
    1.0
    """
    from titop_plant.structures.modal_data import ChildPort

    kids = tuple(ChildPort(c, position, np.zeros((6, 0))) for c, position in (children or {}).items())
    none = np.zeros(0)
    data = ModalData(name, parent, np.zeros(3), mass_matrix, none, none, np.zeros((0, 6)), kids)
    return flexible_body(data, motion=motion)
