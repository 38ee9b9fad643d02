"""From changes of the controllers' responses to their parameters: gradients and Gauss-Newton sums."""

from __future__ import annotations

import numpy as np

from lftkit.arrays import ComplexArray, FloatArray, IntArray
from lftkit.tuning.responses.blocks import ControllerResponse, active_commands


def chained(
    response: ControllerResponse, active: tuple[int, ...], at_frequency: IntArray, a: ComplexArray, b: ComplexArray
) -> FloatArray:
    """Gradients of ``Re(a' K b)``, shape (n, parameters).

    Parameters
    ----------
    response : ControllerResponse
    active : tuple of int
        Blocks of the loop.
    at_frequency : ndarray of int, shape (n,)
        Frequencies of the response.
    a, b : ndarray, complex, shapes (n, commands of the active blocks) and (n, measurements)
    """
    out, rows_of = [], active_commands(response.blocks, active).of_block
    for k, (block, part) in enumerate(zip(response.blocks, response.parts)):
        rows, columns = block.shape
        if k not in active:
            out.append(np.zeros((len(at_frequency), rows * columns)))
            continue
        p = np.einsum("nij,ni->nj", part.left[at_frequency].conj(), a[:, rows_of[k]])
        q = np.einsum("nij,nj->ni", part.right[at_frequency], b[:, block.measurements])
        out.append(np.real(p.conj()[:, :, None] * q[:, None, :]).reshape(len(at_frequency), rows * columns))
    return np.concatenate(out, axis=1)


def gram_sum(
    response: ControllerResponse,
    active: tuple[int, ...],
    at_frequency: IntArray,
    weight: FloatArray,
    L: ComplexArray,
    R: ComplexArray,
) -> FloatArray:
    """Sum of ``weight ||L dK R||_F^2`` as a quadratic form of the parameters, shape (parameters, parameters).

    It is a sum of Kronecker products of left and right Gram matrices.
    """
    sizes = [block.shape[0] * block.shape[1] for block in response.blocks]
    offsets = np.concatenate([[0], np.cumsum(sizes)])
    H = np.zeros((int(offsets[-1]), int(offsets[-1])))
    left, right, rows_of = {}, {}, active_commands(response.blocks, active).of_block
    for k in active:
        block, part = response.blocks[k], response.parts[k]
        left[k] = L[:, :, rows_of[k]] @ part.left[at_frequency]
        right[k] = part.right[at_frequency] @ R[:, block.measurements]
    for i in active:
        for j in active:
            if j < i:
                continue
            GL = (left[i].conj().swapaxes(1, 2) @ left[j]) * weight[:, None, None]
            GR = right[j] @ right[i].conj().swapaxes(1, 2)
            (n, a, b), (_, d, c) = GL.shape, GR.shape
            product = np.real(GL.reshape(n, -1).T @ GR.reshape(n, -1)).reshape(a, b, d, c)
            of_pair = product.transpose(0, 3, 1, 2).reshape(a * c, b * d)
            H[offsets[i] : offsets[i + 1], offsets[j] : offsets[j + 1]] = of_pair
            if j > i:
                H[offsets[j] : offsets[j + 1], offsets[i] : offsets[i + 1]] = of_pair.T
    return H
