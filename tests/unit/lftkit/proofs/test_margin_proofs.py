"""Margins and noise of a sampled loop as proofs: known values, what is refused, loops with other gains and delays."""

from __future__ import annotations

import dataclasses
import itertools
import math
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import trapezoid
from support.sampled_modes import mode_and_law, tick_matrices

from lftkit.arrays import ComplexArray, FloatArray
from lftkit.proofs import ProofError
from lftkit.proofs.sampled_loop import LoopModel, LoopProof, check_loop_proof, loop_model, prove_level
from lftkit.proofs.sampled_loop.bounds import member_gains
from lftkit.proofs.sampled_loop.files import read_loop_proof, read_noise_proof, write_loop_proof
from lftkit.proofs.trusted.noise import NoisePart, NoiseProof, check_noise_proof, noise_bound, require_parts

DT = 0.01
NYQUIST = math.pi / DT
BOX = ((-0.2, 0.3),)
PLANT, LAW = mode_and_law(-6.0, DT)


def model() -> LoopModel:
    return loop_model(PLANT, DT, LAW, commands=["u"], measurements=["v"])


def margin(returned: int, limit: float = 1.0) -> LoopModel:
    """From a signal added to the command to the command."""
    own, q = model(), 1
    B, D = own.B.copy(), own.D.copy()
    B[:, q] = D[:, q] = 0.0
    return dataclasses.replace(own, B=B, D=D, rows=(0,), commands=True, added=(0,), returned=returned, scale=limit)


def noisy(sigma: float = 1.0) -> LoopModel:
    """From noise of the measurement to the error."""
    own, q = model(), 1
    B, D = own.B.copy(), own.D.copy()
    B[:, q] = D[:, q] = 0.0
    D[q, q] = 1.0
    return dataclasses.replace(own, B=B, D=D, weights=np.array([[sigma, 1.0, 1.0]]))


def exact_sensitivity(omega: FloatArray) -> ComplexArray:
    """Of the nominal loop: the state space from a signal added to the command to the command, at the ticks."""
    A, _ = tick_matrices(PLANT, LAW)
    z = np.exp(1j * omega * DT)
    entry, law = np.zeros(4), np.array([0.0, 0.0, 1.0, 0.0])
    entry[:2] = A[:2, 2]
    return np.array([1.0 + law @ np.linalg.solve(v * np.eye(4) - A, entry) for v in z])


def proven(model: LoopModel, level: float, band: tuple[float, float] = (0.0, NYQUIST)) -> LoopProof:
    found = prove_level(model, BOX, band, level)
    assert not found.uncovered
    return LoopProof(model, ("k",), BOX, band, level, tuple(found.strips))


@pytest.mark.parametrize("returned", [0, 1, 2])
def test_the_gain_of_a_margin_is_that_of_the_sampled_loop(returned: int) -> None:
    omega = np.array([0.3, 1.0, 7.0, 60.0, 200.0])
    S = exact_sensitivity(omega)
    change = np.abs(1.0 - np.exp(-1j * omega * DT))
    expected = np.abs(S) if returned == 0 else np.abs(S - 1.0) * (change if returned == 2 else 1.0)
    found = [float(member_gains(margin(returned), w, np.zeros((1, 1)))[0]) for w in omega]
    np.testing.assert_allclose(found, expected, rtol=1e-9)


@pytest.mark.parametrize("returned", [0, 1, 2])
def test_windows_enclose_the_gain_of_a_margin(returned: int) -> None:
    own = margin(returned)
    for middle, half in ((1.0, 0.01), (60.0, 0.3)):
        _, e = own.responses(middle, half, np.eye(2, dtype=complex))
        for t in (-1.0, -0.3, 0.6, 1.0):
            value = sum(c * t**k for k, c in enumerate(e.c))
            assert np.all(np.abs(value - own.at(middle + half * t)[1]) <= e.rad + 1e-13)


def test_a_disk_margin_is_proven_and_kept_in_a_file(tmp_path: Path) -> None:
    """The peak of the sensitivity over the box lies below the level; a lower level than the peak is refused."""
    own = margin(0)
    omega = np.geomspace(1.0, NYQUIST, 400)
    members = np.linspace(*BOX[0], 7)[:, None]
    peak = max(float(member_gains(own, w, members).max()) for w in omega)
    proof = proven(own, 1.05 * peak)
    write_loop_proof(proof, tmp_path / "margin.npz")
    stored = read_loop_proof(tmp_path / "margin.npz")
    assert (stored.model.added, stored.model.returned) == ((0,), 0)
    assert check_loop_proof(stored).stable
    for changed in (
        dataclasses.replace(proof, level=0.99 * peak),
        dataclasses.replace(proof, model=dataclasses.replace(own, added=(0, 0))),
        dataclasses.replace(proof, model=dataclasses.replace(own, added=(1,))),
        dataclasses.replace(proof, model=dataclasses.replace(own, returned=3)),
        dataclasses.replace(proof, model=dataclasses.replace(own, commands=False)),
    ):
        with pytest.raises(ProofError):
            check_loop_proof(changed)


def noise_proof(sigma: float = 1.0, margin: float = 1.05) -> NoiseProof:
    own, members, parts = noisy(sigma), np.linspace(*BOX[0], 9)[:, None], []
    cuts = np.concatenate(
        [[0.0], np.geomspace(0.2, 0.7, 5), np.linspace(0.75, 1.3, 23), np.geomspace(1.5, NYQUIST, 40)]
    )
    for low, high in itertools.pairwise(cuts.tolist()):
        omega = np.linspace(max(low, 1e-3), high, 9)
        level = margin * max(float(member_gains(own, w, members).max()) for w in omega)
        parts.append(NoisePart((0,), (low, high), level, proven(own, level, (low, high)).strips))
    return NoiseProof(own, ("k",), BOX, tuple(parts))


@pytest.fixture(scope="module")
def noise() -> NoiseProof:
    return noise_proof()


def test_the_noise_of_every_member_is_below_the_bound(noise: NoiseProof, tmp_path: Path) -> None:
    """Lyapunov equations of members; the bound is that of the envelope of all resonances, which is wider than one."""
    from scipy.linalg import solve_discrete_lyapunov

    largest = 0.0
    for deviation in np.linspace(*BOX[0], 11):
        A, N = tick_matrices(PLANT, LAW, float(deviation))
        largest = max(largest, math.sqrt(float(solve_discrete_lyapunov(A, N @ N.T)[0, 0])))
    write_loop_proof(noise, tmp_path / "noise.npz")
    checked = check_noise_proof(read_noise_proof(tmp_path / "noise.npz"), window=0.02)
    assert largest < checked.absolute.rms < 1.3 * largest and math.isinf(checked.stable_below)
    assert checked.relative is not None and 0.0 < checked.relative.rms < checked.absolute.rms
    assert checked.absolute.along == checked.absolute.rms, "one row is one axis"
    assert check_noise_proof(noise, stability=False).stable_below == 0.0


def test_the_relative_error_has_the_weight_of_the_window(noise: NoiseProof) -> None:
    """Its bound against the integral with the levels and the exact weight."""
    window = 0.05
    parts = sorted(noise.parts, key=lambda part: part.band)

    def weight(w: FloatArray) -> FloatArray:
        y = 1j * w * window
        return np.abs(y * (y + math.sqrt(12.0)) / (y**2 + 6.0 * y + 12.0)) ** 2

    total = sum(p.level**2 * trapezoid(weight(w := np.linspace(*p.band, 200)), w) for p in parts)
    exact = math.sqrt(DT / math.pi * total)
    bound = check_noise_proof(noise, stability=False, window=window).relative
    assert bound is not None and exact < bound.rms < 1.15 * exact


def test_noise_along_any_axis_and_of_single_rows(noise: NoiseProof) -> None:
    """Two rows: the bound of both together counts along any axis, and for rows without a bound of their own."""
    both = dataclasses.replace(noise.model, rows=(0, 1))
    together = tuple(dataclasses.replace(p, rows=(0, 1), level=1.2 * p.level) for p in noise.parts)
    parts = tuple(dataclasses.replace(part, rows=(row,)) for row in (0, 1) for part in noise.parts)
    alone = noise_bound(noise.model, noise.parts, 0.0)
    for own, rms in ((), 1.2 * math.sqrt(2.0)), (parts, math.sqrt(2.0)):
        require_parts(dataclasses.replace(noise, model=both, parts=own + together))
        found = noise_bound(both, own + together, 0.0)
        assert found.rms == pytest.approx(rms * alone.rms) and found.along == pytest.approx(1.2 * alone.rms)
    assert found.on_axis == pytest.approx(0.72)
    other = dataclasses.replace(parts[0], band=(0.0, 0.1))
    for wrong, match in (
        (parts, "all rows"),
        (parts + together[1:], "all rows"),
        ((*together, other), "single rows"),
        ((*together, parts[0], parts[0]), "single rows"),
        ((*together, dataclasses.replace(parts[0], rows=(2,))), "single rows"),
    ):
        with pytest.raises(ProofError, match=match):
            require_parts(dataclasses.replace(noise, model=both, parts=wrong))


def test_noise_with_a_part_left_out_or_lowered_is_refused(noise: NoiseProof) -> None:
    first, *others = noise.parts
    lower = dataclasses.replace(first, level=0.9 * first.level)
    for parts in ((), tuple(others), (lower, *others), (*others, dataclasses.replace(first, rows=(1,)))):
        with pytest.raises(ProofError):
            check_noise_proof(dataclasses.replace(noise, parts=parts), stability=False)
    for changes in ({"rows": (0, 0)}, {"window": 0.02}, {"commands": True}):
        forged = dataclasses.replace(noise.model, **changes)  # type: ignore[arg-type]
        with pytest.raises(ProofError):
            check_noise_proof(dataclasses.replace(noise, model=forged), stability=False)


def test_unstable_members_have_no_noise_bound_that_is_called_stable(noise: NoiseProof) -> None:
    louder = dataclasses.replace(noise.model, K_C=-10.0 * noise.model.K_C)
    with pytest.raises(ProofError):
        check_noise_proof(dataclasses.replace(noise, model=louder))
