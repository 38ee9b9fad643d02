"""Stable minimum-phase systems whose gain fits given values, or stays above them, as the weight of a cover does.

The gain is a product of sections of first and second order with poles and zeros in the left half-plane, so that the fit
is a smooth problem without constraints on phase: least squares of the logarithm, then the least largest distance.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg, optimize

from lftkit.arrays import FloatArray, Matrices
from lftkit.errors import InputError
from lftkit.support.scalars import as_integer, as_number, as_positive
from lftkit.support.settings import AlgorithmSettings
from lftkit.systems import lft
from lftkit.systems.arguments import checked
from lftkit.systems.exchange import as_system
from lftkit.systems.matrices import frequencies, real_array
from lftkit.systems.ports import Port
from lftkit.systems.sampled.bilinear import to_discrete, warped_frequency
from lftkit.systems.system import System
from lftkit.uncertainty.elements import DynamicElement

sl_optimize: Any = optimize


@dataclass(frozen=True)
class FitSettings(AlgorithmSettings):
    """Numbers of the fit of a gain.

    Attributes
    ----------
    beyond : logarithm of the ratio by which a pole or zero may be outside the band of the frequencies
    damping : least and largest damping ratio of a section of second order
    over : part by which a gain that must stay above is above at least: more than rounding
    least : relative error of a cover, over the largest one, in the place of a smaller one: a weight has no zeros on the
        axis
    steps : steps of the search of the least largest ratio
    converged : change of that ratio at which the search ends
    """

    beyond: float = 5.0
    damping: tuple[float, float] = (1e-3, 1e2)
    over: float = 1e-9
    least: float = 1e-6
    steps: int = 200
    converged: float = 1e-9


SETTINGS = FitSettings()


@checked
def fit_magnitude(
    omega: ArrayLike,
    magnitude: ArrayLike,
    order: int,
    *,
    weight: ArrayLike | None = None,
    above: bool = False,
    dt: float = 0.0,
    settings: FitSettings = SETTINGS,
) -> System:
    """Stable minimum-phase system of one input and one output with a given gain (fitmagfrd in MATLAB).

    Parameters
    ----------
    omega : array_like, shape (N,)
        Frequencies [rad/s], positive, rising; below pi / dt for a sampled system.
    magnitude : array_like, shape (N,)
        Gains, positive.
    order : int
        Of the system, as many zeros as poles.
    weight : array_like, shape (N,), optional
        How much the relative error counts at each frequency; 1 by default.
    above : bool
        Stay at or above `magnitude` at every frequency that is given, with the least largest ratio found.
    dt : float
        Sampling period [s]; 0: continuous time.
    settings : FitSettings
        Numbers of the fit.

    Raises
    ------
    ValueError
        Frequencies or gains that are not positive and finite, weights that are negative, or not as many; an order
        that is no whole number from 0 on.

    Examples
    --------
    The gain of an unstable non-minimum-phase lag is that of a stable one:

    >>> omega = np.geomspace(0.01, 100.0, 40)
    >>> found = fit_magnitude(omega, np.abs((1j * omega - 2.0) / (1j * omega - 0.5)), 1)
    >>> found.poles().real.round(4).tolist(), round(abs(found(0.0)), 3)
    ([-0.5], 4.0)
    """
    w, gains = frequencies(omega), np.atleast_1d(real_array("magnitude", magnitude))
    if w.shape != gains.shape or not len(w):
        raise InputError(f"omega and magnitude must be as many numbers, got shapes {w.shape} and {gains.shape}")
    if not (np.all(np.isfinite(w)) and np.all(w > 0.0) and np.all(np.diff(w) > 0.0)):
        raise InputError("omega must be positive, finite and rising, got other frequencies")
    if not (np.all(np.isfinite(gains)) and np.all(gains > 0.0)):
        raise InputError(f"magnitude must be positive and finite, got {gains.min()} to {gains.max()}")
    number = as_integer(order, "order")
    if number < 0:
        raise InputError(f"order must be at least 0, got {order}")
    if as_number(dt, "dt"):
        as_positive(dt, "dt")
    counts = np.ones(len(w)) if weight is None else real_array("weight", weight)
    if counts.shape != w.shape or not (np.all(np.isfinite(counts)) and np.all(counts >= 0.0) and counts.any()):
        raise InputError(f"weight must be {len(w)} finite numbers, zero or positive, not all zero, got others")
    if dt and not w[-1] < math.pi / dt:
        raise InputError(f"omega must be below pi / dt = {math.pi / dt:g} rad/s, got {w[-1]:g}")
    warped = np.array([warped_frequency(x, dt) for x in w]) if dt else w
    sections = _Sections(np.log(warped), np.log(gains), counts, number, settings)
    x = sections.least_squares()
    if above:
        x = sections.raised(sections.closest_above(x))
    system = sections.system(x)
    return system if not dt else system.with_lft(to_discrete(*system.matrices, dt), dt=dt)


class _Sections:
    """Logarithm of the gain by the logarithms of a factor, of frequencies and of damping ratios.

    Parameters are the factor, then for each section of second order frequency and damping of its zeros and of its
    poles, then those of one of first order.
    """

    def __init__(
        self, log_omega: FloatArray, target: FloatArray, weight: FloatArray, order: int, settings: FitSettings
    ) -> None:
        self.settings = settings
        self.log_omega, self.target, self.weight = log_omega, target, weight
        self.pairs, self.single = divmod(order, 2)

    def log_gain(self, x: FloatArray) -> FloatArray:
        """Logarithm of the gain at the frequencies, shape (N,)."""
        log_gain = np.full(len(self.log_omega), x[0])
        for wz, dz, wp, dp in x[1 : 1 + 4 * self.pairs].reshape(-1, 4):
            log_gain += _second(self.log_omega, wz, dz) - _second(self.log_omega, wp, dp)
        if self.single:
            log_gain += 0.5 * (np.logaddexp(2.0 * self.log_omega, 2.0 * x[-2]))
            log_gain -= 0.5 * np.logaddexp(2.0 * self.log_omega, 2.0 * x[-1])
        return np.asarray(log_gain)

    def least_squares(self) -> FloatArray:
        """The best parameters of some starts."""
        best, cost = self._start(0.0), math.inf
        for shift in (0.0, 0.7, -0.7) if self.pairs or self.single else (0.0,):
            start = self._start(shift)
            fit = sl_optimize.least_squares(
                lambda x: self.weight * (self.log_gain(x) - self.target), start, bounds=self._bounds(len(start))
            )
            if fit.cost < cost:
                best, cost = fit.x, float(fit.cost)
        return best

    def _start(self, shift: float) -> FloatArray:
        low, high = self.log_omega[0], self.log_omega[-1]
        places = np.linspace(low, high, self.pairs + self.single + 2)[1:-1]
        pairs = [[at + shift, 0.0, at - shift, 0.0] for at in places[: self.pairs]]
        single = [places[-1] + shift, places[-1] - shift] if self.single else []
        start = np.array([float(self.target.mean()), *np.ravel(pairs), *single])
        return np.clip(start, *self._bounds(len(start)))

    def _bounds(self, count: int) -> tuple[FloatArray, FloatArray]:
        low, high = self.log_omega[0] - self.settings.beyond, self.log_omega[-1] + self.settings.beyond
        lower, upper = np.full(count, low), np.full(count, high)
        lower[0], upper[0] = -np.inf, np.inf
        lower[2 : 1 + 4 * self.pairs : 2], upper[2 : 1 + 4 * self.pairs : 2] = np.log(self.settings.damping)
        return lower, upper

    def closest_above(self, start: FloatArray) -> FloatArray:
        """Parameters with the least largest weighted ratio over the values, found from `start`."""
        start = self.raised(start)
        first = np.append(start, self._excess(start))
        lower, upper = self._bounds(len(start))

        def room(x: FloatArray) -> FloatArray:
            over = self.log_gain(x[:-1]) - self.target
            return np.concatenate([over, x[-1] - self.weight * over])

        fit = sl_optimize.minimize(
            lambda x: x[-1],
            first,
            jac=lambda x: np.append(np.zeros(len(x) - 1), 1.0),
            method="SLSQP",
            bounds=[*zip(lower, upper), (0.0, None)],
            constraints=[{"type": "ineq", "fun": room}],
            options={"maxiter": self.settings.steps, "ftol": self.settings.converged},
        )
        x = self.raised(np.clip(fit.x[:-1], lower, upper)) if np.all(np.isfinite(fit.x)) else start
        return x if self._excess(x) < self._excess(start) else start

    def raised(self, x: FloatArray) -> FloatArray:
        """The same shape with the least factor that leaves no value below."""
        y = x.copy()
        y[0] += float((self.target - self.log_gain(x)).max()) + self.settings.over
        return y

    def _excess(self, x: FloatArray) -> float:
        return float((self.weight * (self.log_gain(x) - self.target)).max())

    def system(self, x: FloatArray) -> System:
        """The system with these parameters, its states in units of its frequencies."""
        one, parts = np.eye(1), []
        for wz, dz, wp, dp in np.exp(x[1 : 1 + 4 * self.pairs].reshape(-1, 4)):
            b = np.array([[0.0], [1.0]])
            a = np.array([[0.0, wp], [-wp, -2.0 * dp * wp]])
            parts.append((a, b, np.array([[(wz * wz - wp * wp) / wp, 2.0 * (dz * wz - dp * wp)]]), one))
        if self.single:
            zero, pole = np.exp(x[-2:])
            parts.append((np.array([[-pole]]), one, np.array([[zero - pole]]), one))
        gain: Matrices = np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.array([[math.exp(x[0])]])
        return System(*functools.reduce(lft.series, parts, gain), (Port("in", 1),), (Port("out", 1),), "fit")


def _second(log_omega: FloatArray, log_corner: float, log_damping: float) -> FloatArray:
    """Logarithm of ``|s^2 + 2 zeta w s + w^2|``, without overflow."""
    ratio = np.exp(-2.0 * np.abs(log_omega - log_corner))
    inner = (1.0 - ratio) ** 2 + 4.0 * math.exp(2.0 * log_damping) * ratio
    return np.asarray(2.0 * np.maximum(log_omega, log_corner) + 0.5 * np.log(np.maximum(inner, 1e-300)))


@dataclass(frozen=True, eq=False)
class Cover:
    """Uncertain system of :func:`ucover`, its weight and the envelope of the members.

    Attributes
    ----------
    system : System
        ``G0 (1 + W delta)`` with the ports of the nominal system.
    weight : System
        W: stable and minimum phase.
    omega : ndarray, shape (N,)
        Frequencies [rad/s].
    envelope : ndarray, shape (N,)
        Largest relative error of the members, ``|Gk / G0 - 1|``, which ``|W|`` is nowhere below at these frequencies.
    """

    system: System
    weight: System
    omega: FloatArray
    envelope: FloatArray


@checked
def ucover(
    members: Sequence[Any] | ArrayLike,
    nominal: Any,
    order: int,
    omega: ArrayLike,
    *,
    name: str = "delta",
    settings: FitSettings = SETTINGS,
) -> Cover:
    """Uncertain system that contains given members on a grid (ucover in MATLAB, multiplicative).

    Parameters
    ----------
    members : sequence of System, or array_like of complex, shape (K, N)
        Systems of one input and one output, or their responses at `omega`: for instance measured ones.
    nominal : System, or what :func:`lftkit.as_system` takes
        G0: certain, one input and one output, continuous or sampled.
    order : int
        Of the weight W.
    omega : array_like, shape (N,)
        Frequencies [rad/s], positive, rising; below pi / dt for sampled systems. **Between them nothing is promised**:
        resonances of members need points of their own.
    name : str
        Of the element.
    settings : FitSettings
        Numbers of the fit.

    Raises
    ------
    ValueError
        Shapes that do not fit, responses that are not finite, a nominal response of zero, members that are all the
        nominal one; as for :func:`lftkit.fit_magnitude`.

    Examples
    --------
    A gain from 1.5 to 2.5 around 2, which is 25 % at every frequency:

    >>> from lftkit import s
    >>> lags = [(k / (s + 1)).system("u", "y") for k in (1.5, 1.8, 2.5)]
    >>> found = ucover(lags, (2 / (s + 1)).system("u", "y"), 0, np.geomspace(0.01, 100.0, 20))
    >>> round(found.weight.D.item(), 6), found.system.occurrences()
    (0.25, {'delta': 1})
    """
    G0 = as_system(nominal)
    G0.require_siso()
    w = frequencies(omega)
    if (
        isinstance(members, Sequence)
        and len(members)
        and not isinstance(members[0], Sequence | np.ndarray | complex | float | np.number)
    ):
        systems = [as_system(one) for one in members]
        for one in systems:
            one.require_siso()
        responses = np.array([one.response(w)[:, 0, 0] for one in systems])
    else:
        try:
            responses = np.atleast_2d(np.asarray(members, dtype=complex))
        except (TypeError, ValueError):
            raise InputError(f"members must be systems or their responses, got {type(members).__name__}") from None
    if responses.ndim != 2 or responses.shape[1] != len(w) or not responses.size:
        raise InputError(f"members must be responses of shape (K, {len(w)}), got {responses.shape}")
    if not np.all(np.isfinite(responses)):
        raise InputError("members must have finite responses, got one that is not")
    centre = G0.response(w)[:, 0, 0]
    if np.any(centre == 0.0):
        raise InputError(f"{G0.name}: the response must not be zero, got zero at {w[centre == 0.0][0]:g} rad/s")
    envelope = (np.abs(responses - centre) / np.abs(centre)).max(axis=0)
    if not envelope.max() > 0.0:
        raise InputError("members must differ from the nominal system, got equal responses")
    target = np.maximum(envelope, settings.least * envelope.max())
    weight = fit_magnitude(w, target, order, above=True, dt=G0.dt, settings=settings)
    # G0 (1 + W delta): w = delta z, z = W u, y = G0 (u + w)
    (A, B, C, D), (a, b, c, d) = G0.matrices, weight.matrices
    none, zero = np.zeros((len(a), 1)), np.zeros((1, len(a)))
    return Cover(
        System(
            linalg.block_diag(a, A),
            np.block([[none, b], [B, B]]),
            np.block([[c, np.zeros((1, len(A)))], [zero, C]]),
            np.block([[np.zeros((1, 1)), d], [D, D]]),
            G0.inputs,
            G0.outputs,
            G0.name,
            G0.dt,
            (name,),
            (DynamicElement(name),),
        ),
        weight,
        w,
        envelope,
    )
