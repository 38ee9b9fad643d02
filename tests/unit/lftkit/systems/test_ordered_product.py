"""Sums from left to right: the bits of plain Python, whatever the shape."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest

from lftkit import Port, SampledSystem
from lftkit.systems.sampled.ordered_product import OrderedProduct


@pytest.mark.parametrize(
    "shape", [(1, 1), (1, 300), (2, 300), (3, 17), (24, 322), (232, 226), (7, 0), (0, 5), (129, 9)]
)
def test_every_row_is_added_up_from_left_to_right(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(shape[1])
    matrix = rng.standard_normal(shape) * 10.0 ** rng.uniform(-8, 8, shape)
    product = OrderedProduct(matrix)
    product.values[:] = rng.standard_normal(shape[1])
    expected = []
    for row in matrix.tolist():
        total = 0.0
        for k, (factor, value) in enumerate(zip(row, product.values.tolist())):
            total = factor * value if k == 0 else total + factor * value
        expected.append(total)
    assert product().tobytes() == np.array(expected).tobytes()


def test_a_sampled_system_steps_in_this_order_also_as_a_copy() -> None:
    rng = np.random.default_rng(5)
    A, B, C, D = (rng.standard_normal(shape) for shape in ((3, 3), (3, 4), (2, 3), (2, 4)))
    k = SampledSystem(0.3 * A, B, C, D, (Port("u", 4),), (Port("y", 2),), 1e-3)
    inputs = rng.standard_normal((50, 4))

    def plain() -> list[list[float]]:
        x, found = [0.0] * 3, []
        rows = np.block([[k.A, k.B], [k.C, k.D]]).tolist()
        for u in inputs.tolist():
            sums = []
            for row in rows:
                total = row[0] * x[0]
                for factor, value in zip(row[1:], [*x[1:], *u]):
                    total += factor * value
                sums.append(total)
            x = sums[:3]
            found.append(sums[3:])
        return found

    for one in (k, copy.deepcopy(k), pickle.loads(pickle.dumps(k))):
        out, y = [], np.zeros(2)
        for u in inputs:
            one.step(u, y)
            out.append(y.tolist())
        assert out == plain()
