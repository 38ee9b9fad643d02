"""Loop shaping: the largest margin for perturbed normalised coprime factors.

Source: McFarlane and Glover, IEEE TAC 37 (1992).
"""

from __future__ import annotations

import numpy as np
from scipy import linalg

from lftkit.analysis.riccati import riccati
from lftkit.errors import InputError
from lftkit.support.scalars import as_number
from lftkit.synthesis.full_order import FullOrderDesign, norm_of_loop
from lftkit.synthesis.settings import SETTINGS, SynthesisSettings
from lftkit.synthesis.standard_plant import chain, only_port, weight_of
from lftkit.systems.arguments import checked
from lftkit.systems.connection.feedback import close_loop
from lftkit.systems.exchange import as_system
from lftkit.systems.ports import Port
from lftkit.systems.sampled.bilinear import to_discrete
from lftkit.systems.sampled.image import continuous
from lftkit.systems.system import System


@checked
def ncfsyn(
    plant: System,
    before: System | float | None = None,
    after: System | float | None = None,
    level: float | None = None,
    *,
    settings: SynthesisSettings = SETTINGS,
) -> FullOrderDesign:
    """Loop shaping: the controller with the largest margin for perturbed coprime factors of the shaped plant.

    Parameters
    ----------
    plant : System
        G, with one input and one output port, continuous or sampled.
    before, after : System or float, optional
        W1 at the input of the plant and W2 at its output; the shaped plant is W2 G W1.
    level : float, optional
        A larger value is enough: the controller at this level, ``1.1 * ncfsyn(...).lower`` as a rule, with slower poles
        than that of the least one.
    settings : SynthesisSettings
        Numbers of the synthesis, of which `above` and `reached` count.

    Returns
    -------
    FullOrderDesign
        Of the plant itself: ``controller`` is W1 K W2, with positive feedback. ``1 / value`` is the margin of the
        shaped plant with K, ``1 / lower`` the largest one; ``closed`` goes from disturbances at input and output of
        the shaped plant to its input and output.

    Examples
    --------
    A double integrator has the margin sin(pi / 8):

    >>> from lftkit import s
    >>> found = ncfsyn((1 / s**2).system("u", "y"))
    >>> round(1 / found.lower, 5), round(float(np.sin(np.pi / 8)), 5)
    (0.38268, 0.38268)
    """
    G = as_system(plant)
    (u,), (y,) = (only_port(ports, kind, G) for ports, kind in ((G.inputs, "input"), (G.outputs, "output")))
    W1, W2 = (
        weight_of(name, 1.0 if w is None else w, n, G.dt)
        for name, w, n in (("W1", before, u.size), ("W2", after, y.size))
    )
    shaped = chain(W1, G, W2)
    A, B, C, D = continuous(shaped).matrices
    S, R = np.eye(B.shape[1]) + D.T @ D, np.eye(len(C)) + D @ D.T
    inner = A - B @ linalg.solve(S, D.T @ C)
    X = riccati(inner, B, C.T @ linalg.solve(R, C), S)
    Z = riccati(inner.T, C.T, B @ linalg.solve(S, B.T), R)
    if X is None or Z is None:
        raise InputError(f"{G.name}: the shaped plant must be stabilisable and detectable, got one that is not")
    least = float(np.sqrt(1.0 + np.abs(linalg.eigvals(X @ Z)).max(initial=0.0)))
    if level is not None and not least < as_number(level, "level") < np.inf:
        raise InputError(f"level must be above the least one, {least:.6g}, got {level:g}")
    best: tuple[float, System, System] | None = None
    for at in [above * least for above in settings.above] if level is None else [level]:
        # central controller of the normalised coprime factors at this level, positive feedback
        F = -linalg.solve(S, D.T @ C + B.T @ X)
        L = (1.0 - at**2) * np.eye(len(A)) + X @ Z
        into = at**2 * linalg.solve(L.T, Z @ C.T)
        K = A + B @ F + into @ (C + D @ F), into, B.T @ X, -D.T
        sampled = K if not shaped.dt else to_discrete(*K, shaped.dt)
        law = System(*sampled, (Port("y", y.size),), (Port("u", u.size),), "K", shaped.dt)
        closed = _four_blocks(shaped, law)
        value = norm_of_loop(closed, settings)
        if np.isfinite(value) and (best is None or value < best[0]):
            best = value, law, closed
    if best is None:
        where = f"near the least one, {least:.4g}," if level is None else f"of {level:g}"
        raise InputError(f"{G.name}: must be stabilised at a level {where} to working precision, got an unstable loop")
    value, law, closed = best
    return FullOrderDesign(chain(W2, law, W1, names=(y, u)), closed, value, least)


def _four_blocks(shaped: System, law: System) -> System:
    """From disturbances at input and output of a plant to its input and output, positive feedback."""
    A, B, C, D = shaped.matrices
    nu, ny = B.shape[1], len(C)
    plant = System(
        A,
        np.hstack([B, np.zeros((len(A), ny)), B]),
        np.vstack([np.zeros((nu, len(A))), C, C]),
        np.block(
            [
                [np.eye(nu), np.zeros((nu, ny)), np.eye(nu)],
                [D, np.zeros((ny, ny)), D],
                [D, np.eye(ny), D],
            ]
        ),
        (Port("du", nu), Port("dy", ny), Port("u", nu)),
        (Port("input", nu), Port("output", ny), Port("y", ny)),
        shaped.name,
        shaped.dt,
    )
    return close_loop(plant, law, ["du", "dy"], ["input", "output"])
