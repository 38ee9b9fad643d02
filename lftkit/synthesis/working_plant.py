"""A generalised plant in units in which the equations of its controllers lose few digits.

The equations compare weights of commands with gains of errors, and tolerances with solutions. In units of a user, with
commands of 1e-7 beside errors of 1e6, they find no solution where there is one. The units here follow those of the
plant: whatever units it is given in, the scaled plant is the same up to factors of two.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from lftkit.analysis.eigenvectors import EPS
from lftkit.analysis.hinf.peak_search import response_at
from lftkit.arrays import ComplexArray, FloatArray
from lftkit.support.state_units import in_balanced_units
from lftkit.synthesis.extended_plant import ExtendedPlant
from lftkit.synthesis.riccati_controllers import FullOrderEstimator, central, lowest_level, lqg
from lftkit.synthesis.settings import SETTINGS, SynthesisSettings
from lftkit.synthesis.standard_plant import has_rank
from lftkit.systems.zeros_poles import zeros_of

FREQUENCIES = 0.0, *np.logspace(-6.0, 6.0, 121).tolist(), np.inf
"""Over the norm of A."""
Responses = tuple[ComplexArray, ComplexArray, ComplexArray]
"""From disturbances to errors, from commands to errors, and from disturbances to measurements."""


@dataclass(frozen=True)
class WorkingPlant:
    """A scaled plant and its units, which are powers of two: nothing is rounded.

    Attributes
    ----------
    plant : ExtendedPlant
        In continuous time.
    rate, level : float
        Units of rates [rad/s] and of the gain from disturbances to errors.
    states, commands, measurements : ndarray, shapes (n,), (nu,), (ny,)
        States and commands over, and measurements times these are those of the scaled plant.
    settings : SynthesisSettings
    """

    plant: ExtendedPlant
    rate: float
    level: float
    states: FloatArray
    commands: FloatArray
    measurements: FloatArray
    settings: SynthesisSettings

    @classmethod
    def of(cls, plant: ExtendedPlant, settings: SynthesisSettings = SETTINGS) -> WorkingPlant:
        """The scaled plant of one in other units."""
        (n, nu), ny = plant.B2.shape, len(plant.C2)
        working = cls(plant, 1.0, 1.0, np.ones(n), np.ones(nu), np.ones(ny), settings)
        for _ in range(settings.rounds):
            working = working._with_units_of_states()._with_units_of_signals()
        return working

    @property
    def full_rank(self) -> tuple[bool, bool]:
        """Whether every command has a weight (D12), and every measurement noise (D21)."""
        D12, D21, rank = self.plant.D12, self.plant.D21, self.settings.rank
        return has_rank(D12, D12.shape[1], rank), has_rank(D21, len(D21), rank)

    def weighted(self, weight: float, states: float) -> WorkingPlant:
        """With a small weight of each command and state, and a small noise of each measurement and state.

        Where only commands lack a weight, or only measurements a noise, the other side stays as it is.
        """
        plant = self.plant
        (n, nu), ny = plant.B2.shape, len(plant.C2)
        of_states = states * np.eye(n if states else 0, n)
        more = len(of_states)
        effort, noise = (
            0.0 if full and not other else weight for full, other in (self.full_rank, self.full_rank[::-1])
        )
        changed = replace(
            plant,
            B1=np.hstack([plant.B1, np.zeros((n, ny)), of_states.T]),
            C1=np.vstack([plant.C1, np.zeros((nu, n)), of_states]),
            D11=linalg.block_diag(plant.D11, np.zeros((nu + more, ny + more))),
            D12=np.vstack([plant.D12, effort * np.eye(nu), np.zeros((more, nu))]),
            D21=np.hstack([plant.D21, noise * np.eye(ny), np.zeros((ny, more))]),
        )
        return replace(self, plant=changed)

    def lowest_level(self) -> tuple[float, float] | None:
        """Levels of the H-infinity norm without and with a controller, in the units of the user."""
        levels = lowest_level(self.plant, self.settings)
        return None if levels is None else (self.level * levels[0], self.level * levels[1])

    def gain_out_of_reach(self) -> float:
        """Lower bound of the H-infinity norm for all controllers, in the units of the user."""
        return self.level * gain_out_of_reach(self.plant, self.settings)

    def central(self, level: float) -> FullOrderEstimator | None:
        """Central controller at a level, both in the units of the user."""
        return self._restored(central(self.plant, level / self.level, self.settings))

    def lqg(self) -> FullOrderEstimator | None:
        """Controller with the least H2 norm, in the units of the user."""
        return self._restored(lqg(self.plant))

    def _restored(self, full: FullOrderEstimator | None) -> FullOrderEstimator | None:
        if full is None:
            return None
        x, u, y = self.states[:, None], self.commands[:, None], self.measurements
        rates = self.rate * x
        A, B, L = rates * full.A / x.T, rates * full.B / u.T, rates * full.L * y
        return FullOrderEstimator(A, B, L, u * full.F / x.T, u * full.D * y)

    def _with_units_of_states(self) -> WorkingPlant:
        """Rows and columns of states alike, those of B and C among them; the largest rate near to 1."""
        P = self.plant
        n = len(P.A)
        if not n:
            return self
        whole = np.zeros((n + 1, n + 1))
        whole[:n, :n], whole[:n, n] = P.A, _sizes(np.hstack([P.B1, P.B2]))
        whole[n, :n] = _sizes(np.vstack([P.C1, P.C2]).T)
        scale = in_balanced_units(whole)[1]
        s = scale[:n] / scale[n]
        A = P.A * s / s[:, None]
        rate = _power_of_two(float(linalg.norm(A)))
        states = rate * s[:, None]
        return replace(
            self,
            plant=replace(P, A=A / rate, B1=P.B1 / states, B2=P.B2 / states, C1=P.C1 * s, C2=P.C2 * s),
            rate=self.rate * rate,
            states=self.states * s,
        )

    def _units(self, direct: FloatArray, through_states: FloatArray) -> FloatArray:
        """Units in which direct paths are near to 1, or paths through states where there are none beyond rounding."""
        sizes = np.where(direct > self.settings.rank * through_states, direct, through_states)
        return np.array([1.0 / _power_of_two(float(size)) for size in sizes])

    def _with_units_of_signals(self) -> WorkingPlant:
        """Weights of commands and noises of measurements near to 1, and the gain that the controller can leave, too."""
        P = self.plant
        B1, C1 = (float(linalg.norm(M)) for M in (P.B1, P.C1))
        u = self._units(_sizes(P.D12.T), C1 * _sizes(P.B2.T))
        y = self._units(_sizes(P.D21), B1 * _sizes(P.C2))
        B2, C2 = (float(linalg.norm(M)) for M in (P.B2 * u, P.C2 * y[:, None]))
        level = _power_of_two(float(np.sqrt(B1 * C1 / (B2 * C2)))) if B2 * C2 else 1.0
        u = level * u
        return replace(
            self,
            plant=ExtendedPlant(
                P.A, P.B1, P.B2 * u, P.C1 / level, P.C2 * y[:, None],
                P.D11 / level, P.D12 * u / level, P.D21 * y[:, None], P.D22 * u * y[:, None],
            ),
            level=self.level * level,
            commands=self.commands * u,
            measurements=self.measurements * y,
        )  # fmt: skip


def _sizes(M: FloatArray) -> FloatArray:
    """Norms of the rows."""
    return np.asarray(linalg.norm(M, axis=1))


def _power_of_two(size: float) -> float:
    """The power of two near to a size; 1 for none."""
    return float(np.exp2(np.round(np.log2(size)))) if 0.0 < size < np.inf else 1.0


def gain_out_of_reach(plant: ExtendedPlant, settings: SynthesisSettings = SETTINGS) -> float:
    """Largest one over the imaginary axis and the zeros to the right of it, of a plant in continuous time.

    At a point s of the imaginary axis a loop has the gain ``P11 + P12 R P21`` with any R. What is left of P11 between
    the errors that P12 does not reach and the disturbances, and between the errors and the disturbances that P21 does
    not see, is there for every R. A stable loop has no larger gain to the right of the axis than on it, so that zeros
    there count, too: ``W S`` is W at a zero of the plant.
    """
    P = plant
    rate = float(linalg.norm(P.A)) if P.A.any() else 1.0
    poles = linalg.eigvals(P.A) if len(P.A) else np.zeros(0)

    def apart(point: complex) -> bool:
        """Not at a pole, where responses are rounding; a mode that is not reached or seen is a zero, too."""
        return bool(np.abs(poles - point).min(initial=np.inf) > settings.pole * rate)

    axis = [_out_of_reach(P, point, settings) for point in (1j * rate * omega for omega in FREQUENCIES) if apart(point)]
    zeros = [*zeros_of(P.A, P.B2, P.C1, P.D12), *zeros_of(P.A, P.B1, P.C2, P.D21)]
    unstable = [zero for zero in zeros if zero.real > settings.zero * abs(zero) and apart(zero)]
    right = [_out_of_reach(P, zero, settings, abs(zero)) for zero in unstable]
    return max([0.0, *axis, *right])


def _out_of_reach(
    plant: ExtendedPlant, point: complex, settings: SynthesisSettings, beside: float | None = None
) -> float:
    """At a point; at a zero there are directions with next to no gain beside that at the frequency `beside`."""
    try:
        P11, P12, P21 = _responses(plant, point)
        _, near12, near21 = (P11, P12, P21) if beside is None else _responses(plant, 1j * beside)
    except linalg.LinAlgError:  # a pole
        return 0.0
    zero = settings.zero
    left = _null(P12.conj().T, near12, zero) @ P11, (_null(P21, near21, zero) @ P11.conj().T).conj().T
    rounding = settings.rounding * float(linalg.norm(P11))
    return max([0.0, *(float(linalg.norm(part, 2)) - rounding for part in left if part.size)])


def _responses(plant: ExtendedPlant, point: complex) -> Responses:
    P, nw, nz = plant, plant.B1.shape[1], len(plant.C1)
    D = np.block([[P.D11, P.D12], [P.D21, P.D22]])
    M = np.asarray(D, complex)
    if np.isfinite(point) and len(P.A):
        M = response_at((P.A, np.hstack([P.B1, P.B2]), np.vstack([P.C1, P.C2]), D), point)
    return M[:nz, :nw], M[:nz, nw:], M[nz:, :nw]


def _null(M: ComplexArray, near: ComplexArray, zero: float) -> ComplexArray:
    """Orthonormal rows v with ``M v* = 0``, as far as rounding and the gains `near` tell."""
    _, sizes, V = linalg.svd(M)
    least = float(linalg.svdvals(near).min(initial=np.inf))
    rank = np.count_nonzero((sizes > EPS * max(M.shape) * sizes.max(initial=0.0)) & (sizes > zero * least))
    return np.asarray(V[rank:], complex)
