"""One tick of the sampled telescope, in coordinates in which its modes are apart.

Commands are held between ticks (zero-order hold). Disturbance tones are not held: with the phasors ``p_k`` their
response is the steady motion ``Im(X_k p_k)``, ``X_k = (i w_k - A)^-1 B_d a_k``, beside a free motion ``basis q``::

    x  = basis q + Im(X p),    p_k+ = e^(i w_k h) p_k
    q+ = e^(L h) q + B_h v,    L block-diagonal (lftkit.analysis.modal_form)
    y  = (C basis) q + D v + Im((C X + D_d a) p) + noise

Both are exact at the ticks, so tones above half the sampling rate do not alias into the structure. A tone that lies on
a pole has no steady motion; then all tones drive the modes, ``q+ = ... + Im(G p)`` with
``G_k = (i w_k - L)^-1 (e^(i w_k h) - e^(L h)) b_k``, which has no such limit.

**v is the command computed from the last tick's measurement, in force from this tick to the next.**

Order of operations, which gives the bits: the rows of ``C basis``, D and tones times ``(q, v, p)``, and those of the
block times its coordinates and inputs, are added up from left to right
(:mod:`lftkit.systems.sampled.ordered_product`). A coordinate of a pair is ``((own q_i + cross q_j) + B_i0 v_0) + B_i1
v_1 ...`` with its partner j; that of a real pole has 0.0 instead of the second product. A phasor is turned by
``re c - im s`` and ``re s + im c``. No product is fused with a sum.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from lftkit import System
from lftkit.analysis.modal_form import ModalForm
from lftkit.arrays import ComplexArray, FloatArray
from titop_plant.disturbances.wheel_and_drive_tones import Tones
from titop_plant.interface import DT
from titop_plant.simulation.modal_plant import ModalPlant

NEAREST = 1e-5
"""Distance of a tone from the poles [rad/s] below which the tones drive the modes."""


@dataclass(frozen=True)
class PlantStep:
    """Numbers of a tick of a plant of order n with K tones; k coordinates are pairs and real poles, d the block.

    Parameters
    ----------
    pairs : int
        Pairs m: coordinates i and m + i belong together.
    own, cross : ndarray, shape (k,)
        Factors of a coordinate and of its partner.
    driven : ndarray, shape (c or c + 2 K, k)
        What c commands, and phasors (real, imaginary in turn), add to the next coordinates: a row for each of them.
    block : ndarray, shape (d + c or d + c + 2 K, d)
        What the block's coordinates, commands (and phasors) give as its next coordinates.
    outputs : ndarray, shape (n + c + 2 K, m + 2)
        What coordinates, commands and phasors give as measurement (m) and truth (2).
    turn : ndarray, shape (2, K)
        Real and imaginary part of e^(i w h).
    steady : ndarray, shape (n, K), complex
        Coordinates of the steady motion; zero where the tones drive the modes.
    form : ModalForm
        The coordinates.
    """

    pairs: int
    own: FloatArray
    cross: FloatArray
    driven: FloatArray
    block: FloatArray
    outputs: FloatArray
    turn: FloatArray
    steady: ComplexArray
    form: ModalForm

    @property
    def order(self) -> int:
        """Number of states n."""
        return len(self.steady)


def plant_step(data: System, tones: Tones, dt: float = DT) -> PlantStep:
    """Exact sampling: commands held, tones integrated.

    Parameters
    ----------
    data : System
        Continuous; inputs: commands, then the disturbances of the tones; outputs: measurements, truth (2).
    tones : Tones
    dt : float
        Sampling period [s].

    Raises
    ------
    ArithmeticError
        The eigenvalues of the plant did not converge.
    """
    m = _commands(data.B, tones)
    plant = ModalPlant.of(data, m)
    form, observed = plant.form, plant.observed
    s = np.asarray(1j * tones.frequency, dtype=complex)
    held, tone = plant.excited[:, :m], np.asarray(plant.excited[:, m:] @ tones.amplitude, dtype=complex)
    through = np.asarray(data.D[:, m:] @ tones.amplitude, dtype=complex)
    if form.distances(s).min(initial=np.inf) < NEAREST:
        inputs, steady = np.hstack([held, in_turn(tone)]), np.zeros_like(tone)
        diagonal, cross, driven = _modal(form, held, _tone_integral(form, s, tone, dt), dt)
    else:
        inputs, steady = held, form.resolvent(s, tone)
        diagonal, cross, driven = _modal(form, held, np.zeros((form.order, 0), complex), dt)
        through = through + observed @ steady
    frequency = tones.frequency if inputs.shape[1] > m else np.zeros(0)
    block = _block(form.block, inputs[form.plain :], frequency, dt)
    outputs = np.hstack([observed, data.D[:, :m], in_turn(through)])
    turn = np.exp(s * dt)
    return PlantStep(
        len(form.pairs),
        diagonal,
        cross,
        np.ascontiguousarray(driven[: form.plain].T),
        np.ascontiguousarray(block.T),
        np.ascontiguousarray(outputs.T),
        np.stack([turn.real, turn.imag]),
        steady,
        form,
    )


def held_step(plant: ModalPlant, dt: float = DT) -> FloatArray:
    """Next coordinates, measurement and truth from coordinates and command: shape (n + m + 2, n + commands)."""
    form, m = plant.form, len(plant.form.pairs)
    held = plant.excited[:, : plant.commands]
    powers, cross, driven = _modal(form, held, np.zeros((form.order, 0), complex), dt)
    out = np.zeros((form.order + len(plant.observed), form.order + plant.commands))
    diagonal, first = np.arange(form.plain), np.arange(m)
    out[diagonal, diagonal] = powers
    out[first, m + first], out[m + first, first] = cross[:m], cross[m : 2 * m]
    out[: form.plain, form.order :] = driven[: form.plain]
    out[form.plain : form.order, form.plain :] = _block(form.block, held[form.plain :], np.zeros(0), dt)
    out[form.order :] = np.hstack([plant.observed, plant.D[:, : plant.commands]])
    return out


def tone_step(plant: ModalPlant, tones: Tones, dt: float = DT) -> tuple[ComplexArray, ComplexArray]:
    """Contribution of unit phasors to the next coordinates (n, K), and to measurement and truth (m + 2, K).

    Parameters
    ----------
    plant : ModalPlant
    tones, dt
        As in :func:`plant_step`.
    """
    form, m = plant.form, plant.commands
    s = np.asarray(1j * tones.frequency, dtype=complex)
    tone = np.asarray(plant.excited[:, m:] @ tones.amplitude, dtype=complex)
    moved = _tone_integral(form, s, tone, dt)
    block = _block(form.block, np.hstack([np.zeros((len(form.block), m)), in_turn(tone[form.plain :])]), s.imag, dt)
    if len(form.block):
        driven = block[:, len(form.block) + m :]
        moved[form.plain :] = driven[:, 1::2] + 1j * driven[:, 0::2]
    return moved, np.asarray(plant.D[:, m:] @ tones.amplitude, dtype=complex)


def whole_step(matrix: FloatArray, turn: ComplexArray, n: int) -> PlantStep:
    """The tick of :func:`step_matrix` of a plant of order n, with the states themselves as coordinates."""
    return PlantStep(
        0,
        np.zeros(0),
        np.zeros(0),
        np.zeros((matrix.shape[1] - n, 0)),
        np.ascontiguousarray(matrix[:n].T),
        np.ascontiguousarray(matrix[n:].T),
        np.stack([turn.real, turn.imag]),
        np.zeros((n, turn.size), complex),
        ModalForm.whole(np.zeros((n, n))),
    )


def step_matrix(data: System, tones: Tones, dt: float = DT) -> FloatArray:
    """Next state, measurement and truth from state, command and phasors: shape (n + m + 2, n + c + 2 K).

    The phasors stand as real and imaginary part in turn. Commands are held, tones integrated, all in one matrix
    exponential (Van Loan 1978).

    Parameters
    ----------
    data, tones, dt
        As in :func:`plant_step`.
    """
    m = _commands(data.B, tones)
    shapes = data.B[:, m:] @ tones.amplitude
    inputs = np.hstack([data.B[:, :m], in_turn(np.asarray(shapes, dtype=complex))])
    through = np.asarray(data.D[:, m:] @ tones.amplitude, dtype=complex)
    step = _block(data.A, inputs, tones.frequency, dt)
    return np.ascontiguousarray(np.vstack([step, np.hstack([data.C, data.D[:, :m], in_turn(through)])]))


def _commands(inputs: FloatArray, tones: Tones) -> int:
    """Number of commands: the inputs before the disturbances that the tones are on."""
    return inputs.shape[1] - len(tones.amplitude)


def in_turn(factors: ComplexArray) -> FloatArray:
    """Matrix (p, 2 K) that gives Im(factors @ p) from the real and imaginary parts of p in turn."""
    rows, tones = factors.shape
    result = np.empty((rows, 2 * tones))
    result[:, 0::2], result[:, 1::2] = factors.imag, factors.real
    return result


def _modal(
    form: ModalForm, held: FloatArray, tone: ComplexArray, dt: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Factors own and cross (k,), and what commands and phasors add to the next coordinates (n, c + 2 K)."""
    m, plain = len(form.pairs), form.plain
    over = np.exp(form.pairs * dt)
    diagonal = np.concatenate([over.real, over.real, np.exp(form.real * dt)])
    cross = np.concatenate([over.imag, -over.imag, np.zeros(form.real.size)])
    gathered = np.zeros_like(held)
    # q1 + i q2 of a pair has the pole with negative imaginary part
    pair = (_mean_exponential(form.pairs.conj() * dt) * dt)[:, None] * (held[:m] + 1j * held[m : 2 * m])
    gathered[:m], gathered[m : 2 * m] = pair.real, pair.imag
    real = _mean_exponential(np.asarray(form.real * dt, dtype=complex)).real * dt
    gathered[2 * m : plain] = real[:, None] * held[2 * m : plain]
    return diagonal, cross, np.hstack([gathered, in_turn(tone)])


def _tone_integral(form: ModalForm, s: ComplexArray, tone: ComplexArray, dt: float) -> ComplexArray:
    """``(s_k - L)^-1 (e^(s_k h) - e^(L h)) tone_k`` of pairs and real poles, also where s_k is a pole."""
    m, plain = len(form.pairs), form.plain

    def factor(poles: ComplexArray) -> ComplexArray:
        shifted = poles[:, None] * dt
        return np.asarray(np.exp(shifted) * _mean_exponential(s * dt - shifted) * dt)

    out = np.zeros_like(tone)
    upper = factor(form.pairs) * 0.5 * (tone[:m] - 1j * tone[m : 2 * m])
    lower = factor(form.pairs.conj()) * 0.5 * (tone[:m] + 1j * tone[m : 2 * m])
    out[:m], out[m : 2 * m] = upper + lower, 1j * (upper - lower)
    out[2 * m : plain] = factor(form.real.astype(complex)) * tone[2 * m : plain]
    return out


def _mean_exponential(z: ComplexArray) -> ComplexArray:
    """Mean of e^(z t) for t from 0 to 1: (e^z - 1) / z."""
    small = np.abs(z) < 1e-300
    return np.where(small, 1.0, np.expm1(z) / np.where(small, 1.0, z))


def _block(A: FloatArray, inputs: FloatArray, frequency: FloatArray, dt: float) -> FloatArray:
    """Next coordinates (d) from coordinates, commands held, and phasors in turn, integrated: (d, d + inputs)."""
    n, m = len(A), inputs.shape[1] - 2 * frequency.size
    size = n + inputs.shape[1]
    if not n:
        return np.zeros((0, size))
    whole = np.zeros((size, size))
    whole[:n, :n], whole[:n, n:] = A, inputs
    real = n + m + 2 * np.arange(frequency.size)
    whole[real, real + 1], whole[real + 1, real] = -frequency, frequency
    return np.asarray(linalg.expm(whole * dt)[:n])


__all__ = ["PlantStep", "held_step", "in_turn", "plant_step", "step_matrix", "tone_step", "whole_step"]
