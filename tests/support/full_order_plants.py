"""Plants for synthesis and its bounds."""

from __future__ import annotations

import numpy as np

from lftkit import Port, System
from lftkit.synthesis import augw
from lftkit.systems.symbolic.expressions import Expression


def random_plant(seed: int, n: int, through: bool = False) -> System:
    """Weights on all commands, noise on all measurements; half of the modes unstable."""
    rng, (nw, nu, nz, ny) = np.random.default_rng([seed, n]), (3, 2, 3, 2)
    A, B, C = (rng.standard_normal(shape) for shape in ((n, n), (n, nw + nu), (nz + ny, n)))
    D = np.zeros((nz + ny, nw + nu))
    D[:nz, nw:], D[nz:, :nw] = rng.standard_normal((nz, nu)), rng.standard_normal((ny, nw))
    if through:
        D[:nz, :nw] = rng.standard_normal((nz, nw))
    return System(A, B, C, D, (Port("w", nw), Port("u", nu)), (Port("z", nz), Port("y", ny)), "P")


def mixed_sensitivity(plant: Expression, weight: Expression, effort: float) -> System:
    return augw(plant.system("u", "y"), weight.system("e", "z"), effort)
