"""Product of a matrix and a vector with one order of summation: the same bits on every computer (numpy only).

A library of linear algebra adds up in the order that its processor likes, with or without fused multiply-add, so that
its last bits differ between computers and between shapes. Here each row is added up from left to right, and every
product and every sum is rounded::

    y_i = (((0 + M_i0 z_0) + M_i1 z_1) + M_i2 z_2) + ...

Compiled code that does the same (in C: two statements, or ``-ffp-contract=off``) has the same bits.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from lftkit.arrays import FloatArray


def add_up(columns: FloatArray, values: FloatArray, products: FloatArray, sums: FloatArray) -> None:
    """Write the columns (m, p) of a matrix times `values` (m,) into `sums` (p,), two rows or more, from left to right.

    `products` (m, p) is overwritten.
    """
    # numpy adds up along the first axis one row after the other, unless there is a single column
    np.multiply(columns, values[:, None], out=products)
    np.add.reduce(products, axis=0, out=sums)


class OrderedProduct:
    """A matrix times ``values``, added up from left to right; it allocates nothing.

    Parameters
    ----------
    matrix : array_like, shape (p, m)

    Attributes
    ----------
    columns : ndarray, shape (m, max(p, 2))
        The columns of the matrix, one after the other in memory.
    values : ndarray, shape (m,)
        The vector, for the caller to write.

    Examples
    --------
    One after the other, what is small is lost beside what is large:

    >>> product = OrderedProduct([[1e16, 1.0, 1.0, -1e16]])
    >>> product.values[:] = 1.0
    >>> float(product()[0])
    0.0
    """

    def __init__(self, matrix: ArrayLike) -> None:
        array = np.asarray(matrix, dtype=float)
        p, m = array.shape
        self.columns = np.zeros((m, max(p, 2)))
        self.columns[:, :p] = array.T
        self.values = np.zeros(m)
        self._products = np.zeros_like(self.columns)
        self._sums = np.zeros(max(p, 2))
        self._size = p

    def __call__(self) -> FloatArray:
        """Multiply; returns the sums (p,), which the next call overwrites."""
        np.multiply(self.columns, self.values[:, None], out=self._products)  # add_up, without its call
        np.add.reduce(self._products, axis=0, out=self._sums)
        return self._sums[: self._size]

    def recur(self, inputs: FloatArray, together: int = 256) -> FloatArray:
        """Results (k, p) for the rows of `inputs` (k, i), the last values; the first ones are the last results'.

        Bit for bit those of k calls, in a third of the time; the products of so many rows are kept `together`.
        """
        first = len(self.values) - inputs.shape[1]
        of_states, of_inputs = self.columns[:first], self.columns[first:]
        results: FloatArray = np.zeros((len(inputs), self._size))
        products = np.zeros((min(len(inputs), together), *self.columns.shape))
        sums = np.zeros((len(products) + 1, len(self._sums)))
        sums[0, :first] = self.values[:first]
        for begin in range(0, len(inputs), together):
            rows = inputs[begin : begin + together]
            np.multiply(of_inputs, rows[:, :, None], out=products[: len(rows), first:])
            for product, before, after in zip(products[: len(rows)], sums[:, :first, None], sums[1:]):
                np.multiply(of_states, before, out=product[:first])
                np.add.reduce(product, axis=0, out=after)
            results[begin : begin + together] = sums[1 : len(rows) + 1, : self._size]
            sums[0] = sums[len(rows)]
        self.values[:first] = sums[0, :first]
        return results
