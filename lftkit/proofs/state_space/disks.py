"""Complex and dynamic elements of a system: their channels, sizes and radii, as tests of cells and proofs have them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from lftkit.arrays import ComplexArray, IntArray, Matrices
from lftkit.errors import InputError
from lftkit.proofs.blocks.structure import complex_block, full_block, real_block
from lftkit.proofs.trusted.structured import UncertaintyBlock
from lftkit.systems.ports import Port
from lftkit.systems.sampled.bilinear import warped_frequency
from lftkit.systems.system import System
from lftkit.uncertainty.elements import ComplexParameter, DynamicElement, RealParameter, width


@dataclass(frozen=True)
class DiskChannels:
    """An element whose value at a frequency is any complex matrix with a norm of at most `radius`.

    Parameters
    ----------
    name : str
    radius : float
    outputs, inputs : int
        Sizes of an occurrence, which takes as many channels as the larger one.
    channels : tuple of int
        Of all occurrences.
    """

    name: str
    radius: float
    outputs: int
    inputs: int
    channels: tuple[int, ...]

    @property
    def full(self) -> bool:
        """Whether it is a matrix; otherwise a number, which may occur several times."""
        return max(self.outputs, self.inputs) > 1


def disks_of(system: System, radii: Mapping[str, float] | None = None) -> list[DiskChannels]:
    """Complex and dynamic elements, with `radii` in the place of their own radii and bounds.

    Raises
    ------
    ValueError
        A matrix of dynamics that occurs more than once.
    """
    disks = []
    for e in system.elements:
        if isinstance(e, RealParameter):
            continue
        radius = e.radius if isinstance(e, ComplexParameter) else e.bound
        outputs, inputs = (e.outputs, e.inputs) if isinstance(e, DynamicElement) else (1, 1)
        channels = tuple(i for i, name in enumerate(system.channels) if name == e.name)
        if width(e) > 1 and len(channels) > width(e):
            raise InputError(
                f"{system.name}: a matrix of dynamics must occur once in a bound, got element {e.name!r} "
                f"{len(channels) // width(e)} times"
            )
        disks.append(DiskChannels(e.name, (radii or {}).get(e.name, radius), outputs, inputs, channels))
    return disks


def structure_of(system: System) -> tuple[IntArray, IntArray, list[UncertaintyBlock]]:
    """Rows z and columns w of the elements in the response of all channels, real elements first, and their blocks."""
    rows: list[int] = []
    columns: list[int] = []
    structure = []
    for p in system.parameters:
        group = [i for i, name in enumerate(system.channels) if name == p.name]
        rows, columns = rows + group, columns + group
        structure.append(real_block(len(group)))
    for disk in disks_of(system):
        rows += disk.channels[: disk.inputs if disk.full else None]
        columns += disk.channels[: disk.outputs if disk.full else None]
        structure.append(full_block(disk.outputs, disk.inputs) if disk.full else complex_block(len(disk.channels)))
    return np.array(rows, dtype=int), np.array(columns, dtype=int), structure


def real_first(system: System) -> System:
    """The system with the channels of each element adjacent, those of real elements first."""
    names = [p.name for p in system.parameters]
    others = [e.name for e in system.elements if not isinstance(e, RealParameter)]
    return system.sorted_channels([*names, *others])


def without_disks(system: System) -> System:
    """The system with its complex and dynamic elements at their nominal values."""
    real = [p.name for p in system.parameters]
    kept = [i for i, channel in enumerate(system.channels) if channel in real]
    q = len(system.channels)
    columns, rows = [*kept, *range(q, system.D.shape[1])], [*kept, *range(q, system.D.shape[0])]
    return replace(
        system,
        B=system.B[:, columns],
        C=system.C[rows],
        D=system.D[np.ix_(rows, columns)],
        channels=tuple(system.channels[i] for i in kept),
        elements=system.parameters,
    )


def scaled_radii(system: System, factor: float) -> dict[str, float]:
    """Radii of complex and dynamic elements times a factor, by name."""
    return {disk.name: factor * disk.radius for disk in disks_of(system)}


def dynamics_with(
    matrix: ComplexArray,
    omega: float,
    dt: float = 0.0,
    *,
    real: float = 1e-9,
    clear: float = 1e-12,
    at_ends: float = 1e-6,
    nearest: float = 1e-9,
) -> System:
    """Stable dynamics of the same largest gain at all frequencies whose value at one of them is a matrix of rank one.

    ``u v*`` becomes ``a(s) b(s)'``, the entries of a and b all-pass systems ``g (s - c) / (s + c)``. At the ends of the
    axis, where dynamics are real, a value that is not real is that nearby.

    Parameters
    ----------
    matrix : ndarray, complex, shape (outputs, inputs)
        Of a higher rank the part of rank one is taken.
    omega : float
        Frequency [rad/s].
    dt : float
        Period of dynamics in discrete time.
    real : float
        Phase [rad] that counts as zero.
    clear : float
        Distance of poles of sampled dynamics from z = 1 and -1; phases that would need a smaller one count as zero.
    at_ends : float
        Frequency [rad/s] in the place of zero, and one over that of infinity, where dynamics are real; of samples that
        times half the period.
    nearest : float
        Least frequency of samples, times half the period, at which dynamics have a value; and one over the largest.

    Examples
    --------
    >>> member = dynamics_with(np.array([[0.3j]]), 2.0)
    >>> bool(abs(member(2.0j) - 0.3j) < 1e-12), member.order
    (True, 1)
    """
    where = warped_frequency(omega, dt) if dt else omega
    half = 0.5 * dt or 1.0
    at, clear = half * abs(where), clear if dt else 0.0
    if not 0.0 < at < math.inf:
        at = at_ends if at == 0.0 else 1.0 / at_ends
    elif dt:
        at = min(max(at, nearest), 1.0 / nearest)
    least = max(real, 2.0 * clear * max(at, 1.0 / at))
    value = np.atleast_2d(np.asarray(matrix, complex))
    left, sizes, right = linalg.svd(value)
    (A, B, C, D), (E, F, G, H) = (_all_passes(side, at / half, least, dt) for side in (left[:, 0], right[0]))
    # b(s)' with an input for each entry, then a(s) with one
    first = E, G.T, F.T, H[None, :]
    dynamics = np.block([[first[0], np.zeros((len(E), len(A)))], [B @ first[2], A]])
    into, out = np.vstack([first[1], B @ first[3]]), np.hstack([D[:, None] @ first[2], C])
    whole = dynamics, into, sizes[0] * out, sizes[0] * D[:, None] @ first[3]
    return System(*whole, (Port("u", value.shape[1]),), (Port("y", value.shape[0]),), "dynamics", dt=dt)


def _all_passes(values: ComplexArray, omega: float, least: float, dt: float) -> Matrices:
    """All-pass systems (k,) of one input with values of these phases at a frequency, times their magnitudes.

    Phases below `least` [rad] count as zero. With a period they are images of the bilinear map, at whose axis `omega`
    is, formed from their poles: next to 1 the gain is that of the poles as they are rounded.
    """
    size, phase = np.abs(values), np.angle(values)
    real = np.minimum(np.abs(phase), np.pi - np.abs(phase)) < least
    sign = np.where(real, np.where(np.abs(phase) < 1.0, 1.0, -1.0), np.where(phase > 0.0, 1.0, -1.0))
    # the phase of (s - c) / (s + c) is pi - 2 atan(omega / c)
    turned = np.where(phase > 0.0, phase, phase + np.pi)[~real]
    corner = omega / np.tan(0.5 * (np.pi - turned))
    oscillating, gain = np.flatnonzero(~real), sign * size
    # in discrete time it is (a z - 1) / (z - a)
    pole = (1.0 - 0.5 * dt * corner) / (1.0 + 0.5 * dt * corner) if dt else -corner
    out, through = np.zeros((len(values), len(oscillating))), gain.copy()
    out[oscillating, np.arange(len(oscillating))] = gain[oscillating] * (
        -(1.0 - pole) * (1.0 + pole) if dt else -2.0 * corner
    )
    through[oscillating] *= pole if dt else 1.0
    return np.diag(pole), np.ones((len(oscillating), 1)), out, through
