"""Members of a system with complex or dynamic elements that are unstable, or have a large gain, by search.

At a frequency the value of such an element is any complex matrix of bounded norm. The frequencies are those of a grid
and, about the worst of them, of a search along the axis.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from scipy import linalg, optimize

from lftkit.analysis.frequency_grid import frequency_grid, pole_range
from lftkit.arrays import ComplexArray, FloatArray
from lftkit.proofs.blocks.lower import PerturbationSettings, lower_bound
from lftkit.proofs.blocks.structure import balanced_matrix
from lftkit.proofs.settings import SEARCH, SearchSettings
from lftkit.proofs.state_space.disks import DiskChannels, disks_of, structure_of
from lftkit.proofs.state_space.search import Member, member_gain, worst_member
from lftkit.proofs.trusted.structured import UncertaintyBlock, parts
from lftkit.systems.lft import response, solve_loop
from lftkit.systems.system import System
from lftkit.uncertainty.elements import DynamicElement, RealParameter

sl_optimize: Any = optimize
Interval = tuple[float, float]


@dataclass(frozen=True)
class DiskMember(Member):
    """A member with the deviations of complex and dynamic elements at its frequency, by name (outputs, inputs)."""

    disks: Mapping[str, ComplexArray] = field(default_factory=dict)


@dataclass(frozen=True)
class DiskSearch:
    """Search at frequencies of a continuous system with real elements first.

    Parameters
    ----------
    system : System
    box : sequence of (low, high)
        Of its real elements.
    band : (low, high)
        Frequencies [rad/s].
    seed : int
    settings : SearchSettings
    """

    system: System
    box: Sequence[Interval]
    band: Interval
    seed: int
    settings: SearchSettings = SEARCH

    @cached_property
    def disks(self) -> list[DiskChannels]:
        """Complex and dynamic elements."""
        return disks_of(self.system)

    @cached_property
    def nominal(self) -> FloatArray:
        """Nominal values of the real elements (p,)."""
        return np.array([p.nominal for p in self.system.parameters])

    @cached_property
    def deviations(self) -> FloatArray:
        """Ends of the real elements' deviations (p, 2)."""
        return np.asarray(np.array(self.box, dtype=float).reshape(-1, 2) - self.nominal[:, None])

    @cached_property
    def groups(self) -> list[list[int]]:
        """Channels of each real element."""
        names = [p.name for p in self.system.parameters]
        return [[i for i, channel in enumerate(self.system.channels) if channel == name] for name in names]

    def response(self, omega: float) -> ComplexArray:
        """Response (q + p, q + m) of all channels at a frequency, which may be infinite."""
        if math.isinf(omega) or not self.system.order:
            return np.asarray(self.system.D, complex)
        return np.asarray(response(self.system.lft, 1j * omega), complex)

    def frequencies(self) -> FloatArray:
        """Grid of the band, its ends included."""
        poles = self.system.poles()
        (least, most), (low, high), margin = pole_range(poles, zero=0.0), self.band, self.settings.near
        grid = frequency_grid(poles, 0.1 * least, 10.0 * most, points=self.settings.grid, offsets=(0.0,))
        near = ([margin * min(least, high)] if low == 0.0 else []) + (
            [max(most, low) / margin] if high == np.inf else []
        )
        grid = np.unique([low, *near, *grid[(grid >= low) & (grid <= high)], high])
        return np.asarray(grid)

    def worst(
        self,
        at: Callable[[float], tuple[float, Any]],
        closely: Callable[[float, Any], tuple[float, Any]] | None = None,
        ceiling: Callable[[float], float] = lambda _: np.inf,
        floor: float = -np.inf,
    ) -> tuple[float, float, Any]:
        """Largest value over the band of a function of frequency, its frequency, and what comes with it.

        `closely` is the function about the best frequencies of the grid, the same by default; it has what came with the
        best value. A frequency of the grid is left out where an upper bound of the function, `ceiling`, is below what
        was found, or well below `floor`, the least value that is looked for.
        """
        omega = self.frequencies()
        ceilings = np.array([ceiling(float(w)) for w in omega])
        values, best = np.full(len(omega), -np.inf), (-np.inf, float(omega[0]), None)
        for k in np.argsort(-ceilings, kind="stable"):
            if ceilings[k] <= max(best[0], self.settings.close * floor):
                break
            values[k], what = at(float(omega[k]))
            if values[k] > best[0]:
                best = float(values[k]), float(omega[k]), what

        def objective(where: float) -> float:
            nonlocal best
            w = math.exp(where)
            value, what = closely(w, best[2]) if closely else at(w)
            if value > best[0]:
                best = value, w, what
            return -value

        for k in [k for k in np.argsort(-values, kind="stable") if values[k] > -np.inf][: self.settings.refined]:
            low, high = omega[max(k - 1, 0)], omega[min(k + 1, len(omega) - 1)]
            high = high if np.isfinite(high) else 10.0 * max(low, 1e-300)
            low = low if low > 0.0 else 1e-3 * high
            if low < high:
                options = {"maxiter": self.settings.evaluations, "xatol": 1e-7}
                sl_optimize.minimize_scalar(
                    objective, bounds=(math.log(low), math.log(high)), method="bounded", options=options
                )
        return best

    # stability

    def unstable(self, largest: float) -> tuple[float, DiskMember] | None:
        """Smallest factor of box and radii, up to `largest`, with a member that has a pole on the axis.

        Sides are measured from the nominal values, which the box contains.
        """
        first, later = zip(self.settings.singular_starts, self.settings.singular_steps)
        over_axis = partial(self._singular_at, starts=first[0], iterations=first[1])
        value, omega, member = self.worst(over_axis, ceiling=self._ceiling, floor=1.0 / largest)
        if member is not None:
            closely = self._singular_at(omega, *later)
            value, member = closely if closely[0] > value else (value, member)
        if not value * largest > 1.0:
            return None
        point, values = member
        return 1.0 / value, DiskMember(np.inf, point, omega, values)

    def _singular_at(self, omega: float, starts: int, iterations: int) -> tuple[float, Any]:
        """One over the smallest factor found at a frequency, and the member there."""
        widest = self._widest
        sides = np.abs(self.deviations) / np.where(widest > 0.0, widest, 1.0)[:, None]
        scaled = self._scaled(self.response(omega))
        settings = PerturbationSettings(local_steps=iterations)
        value, perturbation = lower_bound(*scaled, starts=starts, seed=self.seed, sides=sides, settings=settings)
        if perturbation is None:
            return 0.0, None
        # Deviations of the real elements and values of the others in a perturbation of the scaled response
        reals, values, row, column = np.zeros(len(self.groups)), {}, 0, 0
        for k, group in enumerate(self.groups):
            reals[k] = perturbation[row, column].real
            row, column = row + len(group), column + len(group)
        for disk in self.disks:
            rows = disk.outputs if disk.full else len(disk.channels)
            columns = disk.inputs if disk.full else len(disk.channels)
            size = (rows, columns) if disk.full else (1, 1)
            values[disk.name] = disk.radius * perturbation[row : row + size[0], column : column + size[1]]
            row, column = row + rows, column + columns
        real = reals * self._widest
        dynamics = [values[e.name] for e in self.system.elements if isinstance(e, DynamicElement)]
        if at_end(omega) and any(linalg.norm(v.imag) > self.settings.real_at_ends * linalg.norm(v) for v in dynamics):
            return 0.0, None
        return value, (self.nominal + real, values)

    @property
    def _widest(self) -> FloatArray:
        """Width of the wider side of each real element (p,)."""
        return np.asarray(np.abs(self.deviations).max(axis=1))

    def _ceiling(self, omega: float) -> float:
        """Upper bound of what :meth:`_singular_at` finds."""
        matrix, _ = self._scaled(self.response(omega))
        return float(linalg.norm(matrix, 2)) if matrix.size else 0.0

    def _scaled(self, M: ComplexArray) -> tuple[ComplexArray, list[UncertaintyBlock]]:
        """Balanced response of the elements' channels, scaled by the wider sides and radii, and their structure."""
        rows, columns, structure = structure_of(self.system)
        sizes = [*self._widest, *(disk.radius for disk in self.disks)]
        scale = [size for size, (_, _, w) in zip(sizes, parts(structure)) for _ in range(w.stop - w.start)]
        return balanced_matrix(M[np.ix_(rows, columns)] * np.array(scale), structure)[0], structure

    # gain

    def largest_gain(self) -> DiskMember:
        """Member of the box with the largest gain found."""

        def first(omega: float) -> tuple[float, Any]:
            return self.gain_of(self.response(omega), self.settings.gain_starts[0], at_end(omega))

        value, omega, point = self.worst(first, lambda w, member: self._climbed_to(w, *member))
        closely = self.gain_of(self.response(omega), self.settings.gain_starts[1], at_end(omega))
        value, point = max((value, point), closely, key=lambda pair: pair[0])
        return DiskMember(value, point[0], omega, point[1])

    def worst_member(self) -> Member:
        """The member with the largest gain found: infinite where one is unstable."""
        middle = np.array([0.5 * (low + high) for low, high in self.box])
        real = member_gain(self.system, middle, self.band)
        if np.isinf(real.gain):
            return real
        around = all(low < 0.0 < high or low == high == 0.0 for low, high in self.deviations)
        search = self if around else replace(self, system=about(self.system, middle))
        unstable = search.unstable(1.0) if self.band == (0.0, np.inf) else None
        return search.largest_gain() if unstable is None else unstable[1]

    def climbed(self, member: DiskMember) -> DiskMember:
        """That of an ascent from a member at its frequency."""
        value, reached = self._climbed_to(member.frequency, member.point, member.disks)
        return DiskMember(value, reached[0], member.frequency, reached[1])

    def _climbed_to(self, omega: float, point: FloatArray, disks: Mapping[str, ComplexArray]) -> tuple[float, Any]:
        """Gain at a frequency at the end of an ascent from a member, and the member there."""
        return self._ascent(self.response(omega), point - self.nominal, dict(disks))

    def gain(self, M: ComplexArray, real: FloatArray, values: dict[str, ComplexArray]) -> float:
        """Gain of the member with deviations `real` (p,) and `values`, by the response `M` of all channels."""
        return self._gain(M, real, values)[0]

    def gain_near(self, point: FloatArray, omega: float) -> DiskMember:
        """That of an ascent from a member's real elements at one frequency."""
        value, reached = self._climbed_to(omega, np.asarray(point), self._random_disks(at_end(omega)))
        return DiskMember(value, reached[0], omega, reached[1])

    def gain_of(self, M: ComplexArray, starts: int, real: bool = False) -> tuple[float, Any]:
        """Largest gain found from the response `M` of all channels, and the member: parameters (p,) and disks.

        `real`: M is that at an end of the axis, and so real; only members with real values are looked for.
        """
        rng = np.random.default_rng(self.seed)
        points = [self.deviations.mean(axis=1)]
        points += [np.where(rng.random(len(self.box)) < 0.5, *self.deviations.T) for _ in range(starts - 1)]
        ascents = [self._ascent(M, point, self._random_disks(real, rng)) for point in points]
        return max(ascents, key=lambda pair: pair[0])

    def _random_disks(self, real: bool, rng: np.random.Generator | None = None) -> dict[str, ComplexArray]:
        """Values of rank one on the surface; real ones at an end of the axis, and ascents from them stay real."""
        rng = rng or np.random.default_rng(self.seed)
        values = {}
        for disk in self.disks:
            u, v = (rng.normal(size=n) + 1j * (not real) * rng.normal(size=n) for n in (disk.outputs, disk.inputs))
            values[disk.name] = np.asarray(disk.radius * np.outer(u, v) / (linalg.norm(u) * linalg.norm(v)), complex)
        return values

    def _ascent(
        self, M: ComplexArray, real: FloatArray, values: dict[str, ComplexArray]
    ) -> tuple[float, tuple[FloatArray, dict[str, ComplexArray]]]:
        """Gain at the end of steps towards the members that the slopes name, and the member."""
        gain, towards = self._gain(M, real, values)
        for _ in range(self.settings.ascents):
            length, before = 1.0, gain
            aim_real, aim_values = towards(real, values)
            while length >= self.settings.short:
                tried = []
                for part in (length, 0.5 * length):
                    new_real = real + part * (aim_real - real)
                    new_values = {d.name: _between(values[d.name], aim_values[d.name], part, d) for d in self.disks}
                    tried.append((*self._gain(M, new_real, new_values), new_real, new_values))
                best = max(tried, key=lambda member: member[0])
                if best[0] > gain:
                    gain, towards, real, values = best
                    break
                length *= 0.25
            if not gain > before * (1.0 + self.settings.climbed):
                break
        return gain, (self.nominal + real, values)

    def _gain(
        self, M: ComplexArray, real: FloatArray, values: dict[str, ComplexArray]
    ) -> tuple[float, Callable[[FloatArray, dict[str, ComplexArray]], tuple[FloatArray, dict[str, ComplexArray]]]]:
        """Gain of a member, and a function that names the member with the largest linearised gain."""
        q = len(self.system.channels)
        delta = np.zeros((len(self.system.channels),) * 2, complex)
        for group, value in zip(self.groups, real):
            delta[group, group] = value
        for disk in self.disks:
            of_disk = list(disk.channels)
            if disk.full:
                delta[np.ix_(of_disk[: disk.outputs], of_disk[: disk.inputs])] = values[disk.name]
            else:
                delta[of_disk, of_disk] = values[disk.name][0, 0]
        *_, inner, singular = linalg.lapack.zgesv(np.eye(q) - M[:q, :q] @ delta, M[:q]) if q else (M[:0], 0)
        if singular:
            return np.inf, lambda a, b: (a, b)
        seen = inner[:, q:]
        through = M[q:, :q] @ (np.eye(q) + delta @ inner[:, :q])
        whole = np.asarray(M[q:, q:] + M[q:, :q] @ delta @ seen, complex)
        left, gains, right = linalg.svd(whole, full_matrices=False)
        # the slope of the gain by delta is the real part of back* d(delta) z
        z, back = seen @ right[0].conj(), through.conj().T @ left[:, 0]

        def towards(at: FloatArray, _: dict[str, ComplexArray]) -> tuple[FloatArray, dict[str, ComplexArray]]:
            slopes = np.array([np.vdot(back[group], z[group]).real for group in self.groups])
            aim = np.where(slopes > 0.0, self.deviations[:, 1], self.deviations[:, 0]) if len(at) else at
            best = {}
            for disk in self.disks:
                if disk.full:
                    u, v = back[list(disk.channels[: disk.outputs])], z[list(disk.channels[: disk.inputs])]
                    matrix = np.outer(u, v.conj())
                else:
                    of_disk = list(disk.channels)
                    matrix = np.array([[np.conj(np.vdot(back[of_disk], z[of_disk]))]])
                size = max(float(linalg.norm(matrix, 2)), 1e-300)
                best[disk.name] = np.asarray(disk.radius * matrix / size, complex)
            return aim, best

        return float(gains[0]), towards


def at_end(omega: float, dt: float = 0.0) -> bool:
    """Whether a frequency [rad/s] is an end of the axis, where the response and dynamics are real."""
    return omega == 0.0 or math.isinf(omega) or bool(dt and omega == math.pi / dt)


def searched_member(
    system: System, box: Sequence[tuple[float, float]], band: tuple[float, float], seed: int, settings: SearchSettings
) -> Member:
    """The member with the largest gain that a search finds, values of complex and dynamic elements included."""
    if disks_of(system):
        return DiskSearch(system, box, band, seed, settings).worst_member()
    return worst_member(system, box, band, seed=seed, settings=settings)


def about(system: System, point: FloatArray) -> System:
    """The same uncertain system with `point` (p,) as nominal values of its real elements, whose ranges contain it.

    Raises
    ------
    ValueError
        The member at `point` is not well posed.
    """
    q, n, moved = len(system.channels), system.order, {p.name: float(v) for p, v in zip(system.parameters, point)}
    offset = {p.name: moved[p.name] - p.nominal for p in system.parameters}
    delta = np.array([offset.get(channel, 0.0) for channel in system.channels])
    # w = delta z + w' with z = (I - D11 delta)^-1 (C1 x + D11 w' + D12 u)
    whole = np.block([[system.A, system.B], [system.C, system.D]])
    seen = solve_loop(np.eye(q) - system.D[:q, :q] * delta, whole[n : n + q], f"the LFT must be well posed at {moved}")
    shifted = whole + whole[:, n : n + q] @ (delta[:, None] * seen)
    elements = tuple(_moved(e, moved[e.name]) if isinstance(e, RealParameter) else e for e in system.elements)
    matrices = shifted[:n, :n], shifted[:n, n:], shifted[n:, :n], shifted[n:, n:]
    return replace(system.with_lft(matrices), elements=elements)


def _moved(parameter: RealParameter, nominal: float) -> RealParameter:
    """With another nominal value, which is in the range up to rounding."""
    ends = min(parameter.lower, nominal), max(parameter.upper, nominal)
    return replace(parameter, nominal=nominal, lower=ends[0], upper=ends[1])


def _between(value: ComplexArray, aim: ComplexArray, part: float, disk: DiskChannels) -> ComplexArray:
    """Value of rank one and full norm between two values: the gain has no maximum inside."""
    left, _, right = linalg.svd(value + part * (aim - value), full_matrices=False)
    return np.asarray(disk.radius * left[:, :1] @ right[:1], complex)
