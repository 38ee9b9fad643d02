"""Controllers for robust performance: D-K iteration, at its end with a bound over all frequencies.

K: the full-order H-infinity controller of the scaled plant. D: at each frequency the scalings of the upper bound of the
structured singular value; stable minimum-phase systems are fitted to them. Source: Balas, Doyle, Glover, Packard and
Smith, mu-Analysis and Synthesis Toolbox (1993); Skogestad and Postlethwaite, Multivariable Feedback Control (2005),
section 8.12. **Sign: u = + K y.**
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg

from lftkit.analysis.batched_linalg import largest_gains
from lftkit.analysis.frequency_grid import frequency_grid, pole_range
from lftkit.analysis.magnitude_fit import fit_magnitude
from lftkit.analysis.norms import hinf_norm
from lftkit.arrays import ComplexArray, FloatArray
from lftkit.errors import InputError
from lftkit.proofs.blocks.structure import full_block
from lftkit.proofs.options import BoundOptions
from lftkit.proofs.robustness import robust_stability
from lftkit.proofs.state_space.bounds import ProvenBounds
from lftkit.proofs.structured.bounds import MuBounds, mu
from lftkit.proofs.trusted.structured import UncertaintyBlock
from lftkit.support.scalars import as_integer
from lftkit.support.settings import AlgorithmSettings
from lftkit.synthesis.full_order import controller_of_least_norm
from lftkit.synthesis.standard_plant import Names, StandardPlant, standard_plant
from lftkit.systems.arguments import checked
from lftkit.systems.connection.interconnection import close
from lftkit.systems.exchange import as_system
from lftkit.systems.matrices import frequencies
from lftkit.systems.ports import Port, total_size
from lftkit.systems.sampled.bilinear import to_discrete
from lftkit.systems.sampled.image import continuous
from lftkit.systems.system import System
from lftkit.uncertainty.elements import DynamicElement, Element, width


@dataclass(frozen=True)
class MuSettings(AlgorithmSettings):
    """Numbers of D-K iteration.

    Attributes
    ----------
    tolerance : relative change of the least peak at which the iteration ends
    points : frequencies at which the scalings are computed, beside those of resonances of the plant, where none are
        asked for
    beyond : factor by which they go beyond its slowest and its fastest pole
    worse : ratio of the peak with fitted scalings to that with the best ones from which on the order is raised
    sharpness : power of the ratio to the peak with which a frequency counts for the fit
    largest_scale : largest scale of an element over that of the performance, and one over the least
    final_orders : further orders of the scalings of the bound
    final_worse : as `worse`, for each of them
    peaks : frequencies at which the lower bound is looked for
    """

    tolerance: float = 0.002
    points: int = 60
    beyond: float = 10.0
    worse: float = 1.02
    sharpness: int = 4
    largest_scale: float = 1e6
    final_orders: tuple[int, ...] = (0, 4)
    final_worse: tuple[float, ...] = (1.02, 1.001)
    peaks: int = 5


SETTINGS = MuSettings()


@dataclass(frozen=True)
class MuDesign:
    """A controller for robust performance, and bounds of its loop.

    Attributes
    ----------
    controller : System
        From the measured to the commanded ports.
    closed : System
        Uncertain, from the other inputs to the other outputs of the plant.
    value, bound : float
        ``value <= peak of the structured singular value <= bound``: for all uncertainty divided by `bound` the loop is
        stable with a gain below `bound`. The bound is the upper end of the H-infinity norm, over the whole axis, of
        the loop between `scalings` and their inverses; the value is that of a perturbation at one frequency, with
        real elements taken as complex ones.
    peaks : tuple of float
        Largest upper bound over the grid of frequencies after each controller, the first one without scalings.
    status : str
        ``converged``: the last iteration changed the least peak by less than the tolerance. ``iteration_limit``: it
        did not. ``no_controller``: the scaled plant had none. The controller is the one of the least peak in each case.
    scalings : tuple of System
        Stable minimum-phase systems, one for each element in the order of `closed.elements`, in continuous time.
    proof : ProvenBounds or None
        With `options`: of the factor of all uncertainty, and of the gain with it, that is proven,
        ``check_proof(design.proof.proof)``.
    """

    controller: System
    closed: System
    value: float
    bound: float
    peaks: tuple[float, ...]
    status: str
    scalings: tuple[System, ...]
    proof: ProvenBounds | None


@checked
def musyn(
    plant: System,
    measured: Names,
    commanded: Names,
    *,
    iterations: int = 10,
    scaling_order: int = 4,
    omega: ArrayLike | None = None,
    options: BoundOptions | None = None,
    settings: MuSettings = SETTINGS,
) -> MuDesign:
    """Controller with a small structured singular value from all uncertainty and disturbances, by D-K iteration.

    Parameters
    ----------
    plant : System
        Uncertain, continuous or sampled. Each element occurs once; a real one is covered by a complex one for the
        synthesis, and counts as real in the proof.
    measured, commanded : str or sequence of str
        Its outputs that the controller sees, and its inputs that it drives. The gain from the other inputs to the
        other outputs is the performance, to be below 1.
    iterations : int
        Most controllers.
    scaling_order : int
        Largest order of the scaling of one channel.
    omega : array_like, optional
        Frequencies of the scalings [rad/s]; of a sampled plant below pi / dt.
    options : BoundOptions, optional
        Prove the robust performance by :func:`lftkit.proofs.robust_stability`, too, with a block of the performance:
        it has a proof that separate code checks, with real elements as such, and takes far longer.
    settings : MuSettings
        Numbers of the iteration.

    Returns
    -------
    MuDesign

    Raises
    ------
    ValueError
        An element that occurs more than once, by its name; a plant without elements; no stabilising controller.

    Examples
    --------
    A lag whose gain is uncertain by 20 %, with an error that is to be small below 0.1 rad/s:

    >>> from lftkit import System, connect, dynamic, s
    >>> G = ((1 + 0.2 * dynamic("delta")) / (s + 1)).system("u", "y")
    >>> W = (0.5 * (s + 0.2) / (s + 0.002)).system("e", "z")
    >>> error = System.static([[1.0, -1.0]], [("r", 1), ("y", 1)], [("e", 1)])
    >>> P = connect(
    ...     {"G": G, "W": W, "error": error},
    ...     [("u", "G.u"), ("w", "error.r"), ("G.y", "error.y"), ("error.e", "W.e")],
    ...     inputs=[("w", 1), ("u", 1)],
    ...     outputs={"z": "W.z", "e": "error.e"},
    ... )
    >>> found = musyn(P, "e", "u", iterations=2)
    >>> found.value <= found.bound < 1.0
    True
    """
    for value, what, least in ((iterations, "iterations", 1), (scaling_order, "scaling_order", 0)):
        if as_integer(value, what) < least:
            raise InputError(f"{what} must be at least {least}, got {value}")
    problem = _Problem.of(as_system(plant), measured, commanded, settings)
    grid = problem.grid(omega)
    best = problem.candidate(problem.standard.system, grid)
    peaks, last, status = [best.peak], best, "iteration_limit"
    for _ in range(iterations - 1):
        try:
            last = problem.candidate(
                _between(problem.standard.system, last.fitted(scaling_order, settings.worse), problem.structure), grid
            )
        except ValueError:
            status = "no_controller"
            break
        before = best.peak
        peaks.append(last.peak)
        best = last if last.peak < before else best
        if abs(before - last.peak) <= settings.tolerance * last.peak:
            status = "converged"
            break
    return problem.design(best, tuple(peaks), status, scaling_order, options)


@dataclass(frozen=True)
class _Candidate:
    """A controller, its certain loop with the signals of the elements first, and the bounds of mu on a grid."""

    controller: System
    closed: System
    structure: tuple[UncertaintyBlock, ...]
    omega: FloatArray
    settings: MuSettings

    @cached_property
    def responses(self) -> ComplexArray:
        """Frequency response of the loop, (N, z, w)."""
        return self.closed.response(self.omega)

    @cached_property
    def _bounds(self) -> list[MuBounds]:
        return [mu(M, self.structure, rtol=1e-3, starts=1) for M in self.responses]

    @cached_property
    def upper(self) -> FloatArray:
        """Upper bounds (N,)."""
        return np.array([bounds.upper for bounds in self._bounds])

    @property
    def peak(self) -> float:
        """Largest upper bound."""
        return float(self.upper.max())

    @property
    def lower(self) -> float:
        """Largest lower bound, at the frequencies with the largest upper ones."""
        worst = np.argsort(self.upper)[-self.settings.peaks :]
        return max(mu(self.responses[k], self.structure, rtol=1e-3).lower for k in worst)

    @cached_property
    def scales(self) -> FloatArray:
        """Scales of the blocks over that of the last one (N, blocks)."""
        largest, scales = self.settings.largest_scale, np.ones((len(self.omega), len(self.structure)))
        for row, bounds in zip(scales, self._bounds):
            if bounds.certificate is not None:
                D = np.array([d[0, 0].real for d in bounds.certificate.D])
                row[:] = np.sqrt(D / D[-1])
        return np.clip(scales, 1.0 / largest, largest)

    def fitted(self, largest: int, worse: float) -> tuple[System, ...]:
        """A system for the scale of each element, of the least order with which the peak is hardly worse."""
        weight = (self.upper / self.peak) ** self.settings.sharpness
        fits = []
        for k in range(len(self.structure) - 1):
            tried = []
            for order in range(largest + 1):
                system = fit_magnitude(self.omega, self.scales[:, k], order, weight=weight)
                scales = self.scales.copy()
                scales[:, k] = np.abs(system.response(self.omega)[:, 0, 0])
                # Largest norm of the scaled responses; phases of the scalings do not change it
                rows = np.repeat(scales, [b.columns for b in self.structure], axis=1)
                columns = np.repeat(scales, [b.rows for b in self.structure], axis=1)
                tried.append(
                    (float(largest_gains(rows[:, :, None] * self.responses / columns[:, None, :]).max()), system)
                )
                if tried[-1][0] <= worse * self.peak:
                    break
            fits.append(min(tried, key=lambda one: one[0])[1])
        return tuple(fits)


@dataclass(frozen=True)
class _Problem:
    """A plant with uncertain elements, and what D-K iteration needs of it: everything in continuous time."""

    plant: System
    measured: Names
    commanded: Names
    settings: MuSettings

    @classmethod
    def of(cls, plant: System, measured: Names, commanded: Names, settings: MuSettings) -> _Problem:
        """Refuse elements that occur several times.

        Raises
        ------
        ValueError
            No element, or one that occurs more than once.
        """
        sorted_plant = plant.sorted_channels()
        if not sorted_plant.elements:
            raise InputError(f"{plant.name}: must have uncertain elements for musyn (hinfsyn otherwise), got none")
        for name, count in sorted_plant.occurrences().items():
            if count > 1:
                raise InputError(f"element {name!r} must occur once for musyn, got {count} occurrences")
        return cls(sorted_plant, measured, commanded, settings)

    @cached_property
    def image(self) -> System:
        """The plant in continuous time, its elements of size 1."""
        return continuous(self.plant).normalised()

    @cached_property
    def standard(self) -> StandardPlant:
        """The certain plant whose first ports are those of the elements."""
        P = self.image
        rows: list[int] = []
        columns: list[int] = []
        start = 0
        for e in P.elements:
            z, w = _sizes(e)
            rows += range(start, start + z)
            columns += range(start, start + w)
            start += width(e)
        q = len(P.channels)
        name = _free("Delta", {p.name for p in P.inputs + P.outputs})
        ins, outs = [*columns, *range(q, P.D.shape[1])], [*rows, *range(q, P.D.shape[0])]
        ports = (Port(name, len(columns)), *P.inputs), (Port(name, len(rows)), *P.outputs)
        return standard_plant(
            System(P.A, P.B[:, ins], P.C[outs], P.D[np.ix_(outs, ins)], *ports, P.name), self.measured, self.commanded
        )

    @cached_property
    def structure(self) -> tuple[UncertaintyBlock, ...]:
        """A block for each element, and one for the performance."""
        standard = self.standard
        sizes = [_sizes(e) for e in self.image.elements]
        sizes.append((total_size(standard.errors[1:]), total_size(standard.disturbances[1:])))
        return tuple(full_block(w, z) for z, w in sizes)

    def grid(self, omega: ArrayLike | None) -> FloatArray:
        """Frequencies of the scalings in continuous time [rad/s]."""
        if omega is not None:
            grid, dt = frequencies(omega), self.plant.dt
            end = np.pi / dt if dt else np.inf
            if not (len(grid) and grid[0] > 0.0 and np.all(np.diff(grid) > 0.0) and grid[-1] < end):
                raise InputError(f"omega must be positive and rising, below {end:g} rad/s, got other frequencies")
            return np.asarray(2.0 / dt * np.tan(0.5 * dt * grid)) if dt else grid
        poles, beyond = self.image.poles(), self.settings.beyond
        low, high = pole_range(poles)
        return frequency_grid(poles, low / beyond, high * beyond, points=self.settings.points)

    def candidate(self, scaled: System, omega: FloatArray) -> _Candidate:
        """The controller of a scaled plant."""
        controller = controller_of_least_norm(scaled, self.measured, self.commanded)
        return _Candidate(controller, self.standard.closed(controller), self.structure, omega, self.settings)

    def design(
        self,
        best: _Candidate,
        peaks: tuple[float, ...],
        status: str,
        scaling_order: int,
        options: BoundOptions | None,
    ) -> MuDesign:
        """The best controller with its bounds."""
        dt, standard = self.plant.dt, self.standard
        law = best.controller
        law = law if not dt else law.with_lft(to_discrete(*law.matrices, dt), dt=dt)
        whole = close(self.plant, law, {p.name: p.name for p in (*standard.measured, *standard.commanded)})
        inputs, outputs = ([p.name for p in side[1:]] for side in (standard.disturbances, standard.errors))
        closed = whole.select(inputs=inputs, outputs=outputs)
        final = zip(self.settings.final_orders, self.settings.final_worse)
        tried = [best.fitted(scaling_order + further, worse) for further, worse in final]
        norms = [hinf_norm(_between(best.closed, fits, self.structure)).upper for fits in tried]
        k = int(np.argmin(norms))
        proof = None
        if options is not None:
            # With dynamics of bound 1 from the outputs to the inputs, the block of the performance
            loop = continuous(closed)
            (p, m), q = loop.D.shape, len(loop.channels)
            size = max(p, m) - q
            name = _free("performance", {e.name for e in loop.elements})
            loop = System(
                loop.A,
                np.pad(loop.B, ((0, 0), (0, size + q - m))),
                np.pad(loop.C, ((0, size + q - p), (0, 0))),
                np.pad(loop.D, ((0, size + q - p), (0, size + q - m))),
                (),
                (),
                loop.name,
                channels=(*loop.channels, *[name] * size),
                elements=(*loop.elements, DynamicElement(name, m - q, p - q)),
            )
            proof = robust_stability(loop, largest=1.0 / norms[k], options=options)
        return MuDesign(law, closed, best.lower, norms[k], peaks, status, tried[k], proof)


def _between(system: System, fits: tuple[System, ...], structure: tuple[UncertaintyBlock, ...]) -> System:
    """A system whose first signals are those of the elements between their scalings and the inverses of them."""
    blocks = list(zip(fits, structure))
    left = [one for one, b in blocks for _ in range(b.columns)]
    right = [one.inverse() for one, b in blocks for _ in range(b.rows)]
    return _diagonal(left, system.outputs) @ system @ _diagonal(right, system.inputs)


def _sizes(element: Element) -> tuple[int, int]:
    """Numbers of signals into and out of an element."""
    return (element.inputs, element.outputs) if isinstance(element, DynamicElement) else (1, 1)


def _free(name: str, taken: set[str]) -> str:
    while name in taken:
        name += "_"
    return name


def _diagonal(first: list[System], ports: tuple[Port, ...]) -> System:
    """Systems of one channel side by side, and a gain of 1 on every signal that is left."""
    parts = [one.matrices for one in first]
    rest = total_size(ports) - len(first)
    A, B, C, D = (linalg.block_diag(*(part[k] for part in parts)) for k in range(4))
    return System(
        A,
        np.hstack([B, np.zeros((len(A), rest))]),
        np.vstack([C, np.zeros((rest, len(A)))]),
        linalg.block_diag(D, np.eye(rest)),
        ports,
        ports,
        "scaling",
    )
