"""Controllers of the least H-infinity and H2 norm, and of mixed sensitivity.

Names and arguments are those of MATLAB's Robust Control Toolbox as far as named ports allow it. **Sign: u = + K y**; a
negative feedback has its sign in the plant or in the controller. Sampled plants go through the bilinear map, which
keeps the H-infinity norm. Every value that is returned is the norm of the closed loop, computed from it and not from
the synthesis.

Sources: Doyle, Glover, Khargonekar and Francis, IEEE TAC 34 (1989); Safonov, Limebeer and Chiang, Int. J. Control 50
(1989), direct paths.
"""

from __future__ import annotations

import functools
import itertools
from dataclasses import dataclass, field, replace

import numpy as np

from lftkit.analysis.norms import h2_norm, hinf_norm, is_stable
from lftkit.errors import InputError
from lftkit.proofs.lower_bound import LowerBoundProof
from lftkit.support.scalars import as_positive
from lftkit.synthesis.lower_bound import ProvenLowerBound, confirmed_optimum, lower_bound_proof
from lftkit.synthesis.riccati_controllers import FullOrderEstimator, sampled_lqg
from lftkit.synthesis.settings import SETTINGS, SynthesisSettings
from lftkit.synthesis.standard_plant import (
    Names,
    StandardPlant,
    only_port,
    standard_plant,
    weight_of,
)
from lftkit.synthesis.working_plant import WorkingPlant
from lftkit.systems.arguments import checked
from lftkit.systems.connection.interconnection import connect
from lftkit.systems.exchange import as_system
from lftkit.systems.ports import Port
from lftkit.systems.sampled.bilinear import to_discrete
from lftkit.systems.sampled.image import continuous
from lftkit.systems.system import System

NEEDED = (
    "every command must have a weight (D12 of full column rank)",
    "every measurement must have noise (D21 of full row rank)",
)
"""What D12 and D21 must have for the equations."""


@dataclass(frozen=True)
class FullOrderDesign:
    """A controller and what its loop reaches.

    Attributes
    ----------
    controller : System
        From the measured to the commanded ports, of the order of the plant.
    closed : System
        From the other inputs to the other outputs of the plant.
    value : float
        Norm of `closed`; where rounding leaves that of an H-infinity design open, a bound of it.
    lower : float
        What no controller of any order can do better, numerically: the optimum of the Riccati equations or of linear
        matrix inequalities, where that is near to `value`, or the largest gain at a single frequency or zero that no
        controller changes; minus infinity where there is none. With ``certify=True`` it is at least the proven
        level.
    regularised : float
        Weight of commands and noise of measurements that was added, in units in which those of the plant, or its gains
        where it has none, are near to 1; 0 for none; of states, too, where that is better.
    proof : LowerBoundProof or None
        For :func:`~lftkit.proofs.check_proof`; no controller has a norm below its ``level``.
    reason : str
        Why there is no proof that was asked for; otherwise empty.
    """

    controller: System
    closed: System
    value: float
    lower: float
    regularised: float = 0.0
    proof: LowerBoundProof | None = field(default=None, repr=False)
    reason: str = ""

    @property
    def gap(self) -> float:
        """Part of the value by which another controller could be better at most."""
        return (self.value - self.lower) / self.value if self.value > 0.0 and self.lower > -np.inf else np.inf


@checked
def hinfsyn(
    plant: System,
    measured: Names,
    commanded: Names,
    level: float | None = None,
    *,
    certify: bool = False,
    settings: SynthesisSettings = SETTINGS,
) -> FullOrderDesign:
    """Controller with the least H-infinity norm from the other inputs to the other outputs of a plant.

    Parameters
    ----------
    plant : System
        Certain, continuous or sampled.
    measured, commanded : str or sequence of str
        Its outputs that the controller sees, and its inputs that it drives.
    level : float, optional
        A larger norm is enough: the central controller at this level, with slower poles than that of the least one.
    certify : bool
        A lower bound is proven, too (:func:`lower_bound_proof`), with its proof, or the reason why there is none.
    settings : SynthesisSettings
        Numbers of the synthesis.

    Returns
    -------
    FullOrderDesign

    Raises
    ------
    ValueError
        No stabilising controller exists, and why; a level that no controller reaches.

    Examples
    --------
    An integrator with noise and disturbance:

    >>> from lftkit import System
    >>> ports = [("w", 2), ("u", 1)], [("z", 2), ("y", 1)]
    >>> P = System([[0.0]], [[1.0, 0.0, 1.0]], [[1.0], [0.0], [1.0]], [[0, 0, 0], [0, 0, 1], [0, 1, 0]], *ports)
    >>> found = hinfsyn(P, "y", "u")
    >>> round(found.value, 4), round(found.lower, 4)
    (1.4142, 1.4142)
    """
    standard = standard_plant(plant, measured, commanded, settings)
    generalised = _generalised(standard, settings)
    if level is not None:
        as_positive(level, "level")
    proven = lower_bound_proof(plant, measured, commanded) if certify else None
    if level is not None:
        changed = (generalised.weighted(w, states) for w in settings.regularised for states in (0.0, w))
        plants = itertools.chain([generalised] if all(generalised.full_rank) else [], changed)
        designs = (_design(standard, working, level) for working in plants)
        most = (1.0 + settings.reached) * level
        reached = (design for design in designs if design is not None and design.value <= most)
        design = next(reached, None)
        if design is None:
            raise InputError(f"{standard.system.name}: level must be one that a controller reaches, got {level:g}")
    else:
        design = _least(standard, generalised, proven)
    if proven is None:
        return design
    return replace(design, lower=max(design.lower, proven.level), proof=proven.proof, reason=proven.reason)


def _least(standard: StandardPlant, generalised: WorkingPlant, proven: ProvenLowerBound | None) -> FullOrderDesign:
    """The controller with the least norm and its bound, with weights where the equations have no solution without.

    Where the equations give no bound, and the gain out of reach is none that is near, there may be one with a proof.
    """
    unreachable, settings = generalised.gain_out_of_reach(), generalised.settings
    measured, commanded = ([port.name for port in ports] for ports in (standard.measured, standard.commanded))

    @functools.cache
    def level() -> float:
        return (proven or lower_bound_proof(standard.system, measured, commanded)).level

    def bounded(design: FullOrderDesign) -> FullOrderDesign:
        near = (1.0 - settings.near) * design.value
        # A loop refutes a larger one
        above = unreachable if unreachable <= (1.0 + settings.reached) * design.value else -np.inf
        lower = max(design.lower, min(above, design.value))
        if design.lower == -np.inf and lower < near:
            lower = max(lower, level())
            if lower < near:
                lower = max(lower, confirmed_optimum(standard.system, measured, commanded, design.value))
        return replace(design, lower=lower if lower >= settings.least * design.value else -np.inf)

    best = bounded(_controller_of_least_norm(standard, generalised))
    if not best.lower >= (1.0 - settings.near) * best.value:
        better = _with_weights(standard, generalised, of_states=True)
        best = bounded(better) if better is not None and better.value < best.value else best
    return best


def _controller_of_least_norm(standard: StandardPlant, generalised: WorkingPlant) -> FullOrderDesign:
    """Without a bound where small weights of commands and measurements are needed.

    No controller is better than none where the plant has no gain; where the equations have no solution it is the best.
    """
    # The controller without gain and states; None where its loop is not stable
    shape = sum(port.size for port in standard.commanded), sum(port.size for port in standard.measured)
    nothing = np.zeros((0, 0)), np.zeros((0, shape[1])), np.zeros((shape[0], 0)), np.zeros(shape)
    controller = System(*nothing, standard.measured, standard.commanded, "K", dt=standard.system.dt)
    closed = standard.closed(controller)
    value = norm_of_loop(closed, generalised.settings)
    idle = FullOrderDesign(controller, closed, value, -np.inf) if np.isfinite(value) else None
    if idle is not None and idle.value == 0.0:
        return replace(idle, lower=0.0)
    best = _best(standard, generalised) if all(generalised.full_rank) else None
    best = best or _with_weights(standard, generalised) or _with_weights(standard, generalised, of_states=True)
    best = best or idle
    if best is None:
        raise InputError(
            f"{standard.system.name}: the Riccati equations have no solution at any level, with a weight of up to "
            f"{generalised.settings.regularised[-1]:g} on commands, measurements and states too"
        )
    return best


def _with_weights(
    standard: StandardPlant, generalised: WorkingPlant, *, of_states: bool = False
) -> FullOrderDesign | None:
    weights = generalised.settings.regularised
    designs = [_best(standard, generalised.weighted(w, w if of_states else 0.0), w) for w in weights]
    return min((one for one in designs if one is not None), key=lambda one: one.value, default=None)


def controller_of_least_norm(
    plant: System, measured: Names, commanded: Names, settings: SynthesisSettings = SETTINGS
) -> System:
    """The controller of :func:`hinfsyn`, without looking for a bound where that is a problem of its own."""
    standard = standard_plant(plant, measured, commanded, settings)
    return _controller_of_least_norm(standard, _generalised(standard, settings)).controller


@checked
def h2syn(
    plant: System, measured: Names, commanded: Names, *, settings: SynthesisSettings = SETTINGS
) -> FullOrderDesign:
    """Controller with the least H2 norm from the other inputs to the other outputs.

    That of a sampled plant uses the measurement of the same sample, and white noise has the variance 1 per sample.
    Numbers of the synthesis are in `settings`.

    Raises
    ------
    ValueError
        No stabilising controller; in continuous time also a direct path from the other inputs to the other outputs, a
        command without weight, a measurement without noise.

    Examples
    --------
    >>> from lftkit import System
    >>> ports = [("w", 2), ("u", 1)], [("z", 2), ("y", 1)]
    >>> P = System([[0.0]], [[1.0, 0.0, 1.0]], [[1.0], [0.0], [1.0]], [[0, 0, 0], [0, 0, 1], [0, 1, 0]], *ports)
    >>> round(h2syn(P, "y", "u").value, 6)
    1.414214
    """
    standard = standard_plant(plant, measured, commanded, settings)
    if standard.system.dt:
        # Its bound is the variance by both equations, and counts if the loop has the same
        try:
            matrices, least = sampled_lqg(standard.extended)
            controller = System(*matrices, standard.measured, standard.commanded, "K", standard.system.dt)
            closed = standard.closed(controller)
            value = float(h2_norm(closed))
        except (ValueError, ArithmeticError):
            value = np.inf
        if not np.isfinite(value):
            raise InputError(
                f"{standard.system.name}: must have no zeros on the unit circle in its weights, and no command or "
                "measurement that follows from others, got some"
            )
        same = abs(value - least) <= settings.reached * value
        return FullOrderDesign(controller, closed, value, min(value, least) if same else -np.inf)
    generalised = _generalised(standard, settings)
    if generalised.plant.D11.any():
        raise InputError(f"{standard.system.name}: D11 must be zero for a finite H2 norm, got a direct path")
    for missing, full_rank in zip(NEEDED, generalised.full_rank):
        if not full_rank:
            raise InputError(f"{standard.system.name}: {missing}, got a matrix of lower rank")
    full = generalised.lqg()
    if full is None:
        raise InputError(f"{standard.system.name}: must have no zeros on the imaginary axis in its weights, got some")
    controller = _controller(standard, full)
    closed = standard.closed(controller)
    value = float(h2_norm(closed))
    return FullOrderDesign(controller, closed, value, value)


@checked
def augw(
    plant: System,
    error: System | float | None = None,
    effort: System | float | None = None,
    output: System | float | None = None,
) -> System:
    """Generalised plant of mixed sensitivity: reference ``w`` and command ``u`` to weighted ``z1, z2, z3`` and ``y``.

    ``y = w - G u`` is what the controller sees, z1 the weighted y, z2 the weighted u, z3 the weighted output of the
    plant. A weight of one channel is that of each channel.

    Parameters
    ----------
    plant : System
        G, with one input and one output port.
    error, effort, output : System or float, optional
        W1, W2, W3; those that are left out have no output.
    """
    G = as_system(plant)
    (u,), (y,) = (only_port(ports, kind, G) for ports, kind in ((G.inputs, "input"), (G.outputs, "output")))
    signals = (("z1", error, "e", y.size), ("z2", effort, "u", u.size), ("z3", output, "y", y.size))
    weights = {name: weight_of(name, w, size, G.dt) for name, w, _, size in signals if w is not None}
    if not weights:
        raise InputError("augw must have one of the weights error, effort and output, got none")
    eye = np.eye(y.size)
    split = System(  # e = w - y, to the weight and to the controller
        np.zeros((0, 0)), np.zeros((0, 2 * y.size)), np.zeros((y.size, 0)), np.hstack([eye, -eye]),
        (Port("r", y.size), Port("seen", y.size)), (Port("e", y.size),), "error", G.dt,
    )  # fmt: skip
    sources = {"e": "error.e", "u": "u", "y": f"plant.{y.name}"}
    return connect(
        {"plant": G, "error": split, **weights},
        [
            ("u", f"plant.{u.name}"),
            ("w", "error.r"),
            (f"plant.{y.name}", "error.seen"),
            *((sources[signal], f"{name}.in") for name, w, signal, _ in signals if w is not None),
        ],
        inputs=[Port("w", y.size), Port("u", u.size, u.unit)],
        outputs={**{name: f"{name}.out" for name in weights}, "y": "error.e"},
    )


@checked
def mixsyn(
    plant: System,
    error: System | float | None = None,
    effort: System | float | None = None,
    output: System | float | None = None,
    *,
    certify: bool = False,
    settings: SynthesisSettings = SETTINGS,
) -> FullOrderDesign:
    """Controller of the least H-infinity norm of the weighted S, K S and T: :func:`hinfsyn` of :func:`augw`.

    The loop is that of negative feedback, ``u = K (w - y)``. With ``certify=True`` its lower bound is proven.

    Examples
    --------
    Skogestad and Postlethwaite, Multivariable Feedback Control, section 2.8.2, first weight, where 1.37 is printed:

    >>> from lftkit import s
    >>> G = (200 / ((10 * s + 1) * (0.05 * s + 1) ** 2)).system("u", "y")
    >>> W1 = ((s / 1.5 + 10) / (s + 1e-3)).system("e", "z")
    >>> round(mixsyn(G, W1, 1.0).value, 2)
    1.37
    """
    return hinfsyn(augw(plant, error, effort, output), "y", "u", certify=certify, settings=settings)


def _best(standard: StandardPlant, plant: WorkingPlant, weight: float = 0.0) -> FullOrderDesign | None:
    """The controller with the least norm of those at levels a little above the lowest one, which is its bound.

    It has no bound where a `weight` was added, or where its norm is far above the level.
    """
    settings, (low, high) = plant.settings, plant.lowest_level() or (0.0, 0.0)
    best: FullOrderDesign | None = None
    for level in (above * high for above in settings.above if high):
        design = _design(standard, plant, level)
        best = min((one for one in (best, design) if one is not None), key=lambda one: one.value, default=None)
        if (
            best is not None and best.value <= (1.0 + settings.reached) * level
        ):  # no other one is better by more than its level
            break
    if best is None:
        return None
    bounded = not weight and low <= (1.0 + settings.reached) * best.value and best.value <= settings.above[-2] * high
    return replace(best, lower=low if bounded else -np.inf, regularised=weight)


def _design(standard: StandardPlant, plant: WorkingPlant, level: float) -> FullOrderDesign | None:
    full = plant.central(level)
    if full is None:
        return None
    try:
        controller = _controller(standard, full)
        closed = standard.closed(controller)
    except ValueError:  # a loop that is not well posed
        return None
    value = norm_of_loop(closed, plant.settings)
    return FullOrderDesign(controller, closed, value, -np.inf) if np.isfinite(value) else None


def norm_of_loop(closed: System, settings: SynthesisSettings = SETTINGS) -> float:
    """H-infinity norm of a loop, infinite where it is not stable; its upper side where rounding leaves it open."""
    if not is_stable(closed.A, closed.dt):
        return np.inf
    norm = hinf_norm(closed)
    return norm.value if norm.upper <= (1.0 + settings.reached) * norm.value else norm.upper


def _generalised(standard: StandardPlant, settings: SynthesisSettings) -> WorkingPlant:
    return WorkingPlant.of(replace(standard, system=continuous(standard.system)).extended, settings)


def _controller(standard: StandardPlant, full: FullOrderEstimator) -> System:
    A, B, C, D = full.A + full.B @ full.F, full.B @ full.D - full.L, full.F, full.D
    dt = standard.system.dt
    matrices = (A, B, C, D) if not dt else to_discrete(A, B, C, D, dt)
    return System(*matrices, standard.measured, standard.commanded, "K", dt)
