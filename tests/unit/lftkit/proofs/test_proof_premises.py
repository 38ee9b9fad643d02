"""Each premise of a loop's proof: a forged proof that lacks it alone is refused, by the function that asks for it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np
import pytest

from lftkit import Port, RealParameter, SampledSystem, System
from lftkit.proofs import ProofError
from lftkit.proofs.sampled_loop import LoopModel, LoopProof, bounds, check_loop_proof, loop_model, prove_level
from lftkit.proofs.sampled_loop.bounds import member_gains
from lftkit.proofs.trusted import sampled_loop, stability, strips
from lftkit.proofs.trusted.proof import Strip
from lftkit.proofs.trusted.stability import (
    beyond,
    channels,
    commands_bound,
    nominal_windows,
    stable_below,
    windows_above,
)

DT = 0.01
NYQUIST = math.pi / DT
BAND = (0.5, 2.0)
BOX = ((-0.05, 0.3),)


def damped(frequency: float, damping: float = 0.1, feedthrough: float = 0.0) -> LoopModel:
    """A mode whose damping is uncertain, under a weak sampled velocity feedback; a channel may have a feedthrough."""
    d = RealParameter("d", damping, 0.5 * damping, 2.0 * damping)
    A, B = [[0.0, 1.0], [-(frequency**2), -damping]], [[0.0, 0.0, 0.0], [-1.0, 1.0, 1.0]]
    C, D = [[0.0, 1.0], [0.0, 1.0], [1.0, 0.0]], np.zeros((3, 3))
    D[0, 0] = feedthrough
    inputs, outputs = (Port("force", 1), Port("u", 1)), (Port("v", 1), Port("x", 1))
    plant = System(A, B, C, D, inputs, outputs, channels=("d",), elements=(d,))
    law = SampledSystem([[0.8]], [[0.2]], [[-0.003]], [[0.0]], (Port("v", 1),), (Port("u", 1),), dt=DT, name="law")
    return loop_model(plant, DT, law, commands=["u"], measurements=["v"])


def proven(model: LoopModel, box: tuple[tuple[float, float], ...]) -> LoopProof:
    found = prove_level(model, box, BAND, 1e3)
    assert not found.uncovered
    return LoopProof(model, ("d",), box, BAND, 1e3, tuple(found.strips))


@pytest.fixture(scope="module")
def proof() -> LoopProof:
    return proven(damped(1.0), BOX)


def with_model(proof: LoopProof, **changes: object) -> LoopProof:
    return dataclasses.replace(proof, model=dataclasses.replace(proof.model, **changes))  # type: ignore[arg-type]


def with_strips(proof: LoopProof, **changes: Callable[[object], object]) -> LoopProof:
    strips = [
        dataclasses.replace(s, **{name: change(getattr(s, name)) for name, change in changes.items()})  # type: ignore[arg-type]
        for s in proof.strips
    ]
    return dataclasses.replace(proof, strips=tuple(strips))


ALONE: dict[str, tuple[str, Callable[[LoopProof], LoopProof]]] = {
    "single precision": ("require_numbers", lambda p: with_model(p, poles=p.model.poles.astype(np.complex64))),
    "complex feedthrough": ("require_numbers", lambda p: with_model(p, D=p.model.D * (1.0 + 0.0j))),
    "infinite limit": ("require_numbers", lambda p: with_model(p, scale=math.inf)),
    "nothing bounded": ("require_sizes", lambda p: with_model(p, rows=())),
    "row from the end": ("require_sizes", lambda p: with_model(p, rows=(-1,))),
    "no interval": ("require_groups", lambda p: dataclasses.replace(p, box=())),
    "no name": ("require_groups", lambda p: dataclasses.replace(p, names=())),
    "nominal left out": ("require_box", lambda p: dataclasses.replace(p, box=((0.1, 0.3),))),
    "infinite level": ("require_band", lambda p: dataclasses.replace(p, level=math.inf)),
    "single precision of nodes": ("require_strip", lambda p: with_strips(p, nodes=lambda n: np.float32(n))),
}
"""Function that refuses, and a proof that all other code accepts."""

ALSO: dict[str, Callable[[LoopProof], LoopProof]] = {
    "not a number": lambda p: with_model(p, C=p.model.C * np.nan),
    "infinite interval": lambda p: dataclasses.replace(p, box=((-math.inf, math.inf),)),
    "turned interval": lambda p: dataclasses.replace(p, box=((0.3, -0.05),)),
    "negative hold": lambda p: with_model(p, frame=np.array([-5])),
    "dt zero": lambda p: with_model(p, dt=0.0),
    "channel twice": lambda p: with_model(p, groups=((0, 0),)),
    "no scalings": lambda p: with_strips(p, D=lambda _: ()),
    "scalings of one node": lambda p: with_strips(p, G=lambda g: tuple(m[:1] for m in g)),  # type: ignore[attr-defined]
    "negative frequencies": lambda p: with_strips(p, nodes=lambda n: n - 1.0),  # type: ignore[operator]
    "band above half of the sampling rate": lambda p: dataclasses.replace(p, band=(0.5, 1.1 * NYQUIST)),
    "level negative": lambda p: dataclasses.replace(p, level=-p.level),
}


def test_the_proof_itself_passes(proof: LoopProof) -> None:
    checked = check_loop_proof(proof)
    assert (checked.stable, checked.stable_below) == (False, 0.0), "a part of the band says nothing of stability"


@pytest.mark.parametrize("name", ALONE)
def test_what_lacks_one_premise_is_refused_by_its_function_alone(
    proof: LoopProof, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    function, change = ALONE[name]
    forged = change(proof)
    with pytest.raises(ProofError):
        check_loop_proof(forged)
    monkeypatch.setattr(strips if function == "require_strip" else sampled_loop, function, lambda *_: None)
    check_loop_proof(forged)


@pytest.mark.parametrize("name", ALSO)
def test_other_forged_proofs_are_refused_with_a_reason(proof: LoopProof, name: str) -> None:
    with pytest.raises(ProofError):
        check_loop_proof(ALSO[name](proof))


def test_a_box_of_unstable_members_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Damping -0.4 to -0.2: each member has a frequency response, none is stable, none crosses the axis."""
    box = ((-0.5, -0.3),)
    with pytest.raises(ValueError, match="contain zero"):
        prove_level(damped(1.0), box, BAND, 1e3)
    with monkeypatch.context() as unasked:
        unasked.setattr(bounds, "require_box", lambda _: None)
        forged = proven(damped(1.0), box)
    with pytest.raises(ProofError, match="contain zero"):
        check_loop_proof(forged)


def resonant() -> LoopModel:
    """Unit mass, damping 0.1, on a spring of 1 N/m that is uncertain; its position by a force."""
    k = RealParameter("k", 1.0, 0.5, 1.5)
    A, B, C = [[0.0, 1.0], [-1.0, -0.1]], [[0.0, 0.0], [-1.0, 1.0]], [[1.0, 0.0], [1.0, 0.0]]
    plant = System(A, B, C, np.zeros((2, 2)), (Port("force", 1),), (Port("x", 1),), channels=("k",), elements=(k,))
    return loop_model(plant, DT)


def outside_proof(model: LoopModel, level: float) -> LoopProof:
    """Scalings with D < 0, which bound the gain *outside* of the box: the resonance is inside."""
    box, omega = ((-0.3, 0.3),), 1.0
    z, e = model.at(omega)
    w = np.eye(1, 2)
    first, second = w - box[0][0] * z, box[0][1] * z - w
    gain = e.conj().T @ e / level**2 - np.diag([0.0, 1.0])

    def largest(D: float, G: float) -> float:
        half = D * first.conj().T @ second + 1j * G * z.conj().T @ w
        return float(np.linalg.eigvalsh(half + half.conj().T + gain)[-1])

    tried = [
        (-D, sign * G) for D in np.geomspace(1e-3, 1e3, 60) for G in np.geomspace(1e-4, 1e3, 60) for sign in (-1, 1)
    ]
    D, G = min(tried, key=lambda pair: largest(*pair))
    band = omega - 1e-4, omega + 1e-4
    scalings = [(np.full((2, 1, 1), value, dtype=complex),) for value in (D, G)]
    strip = Strip(box, np.array(band), scalings[0], scalings[1], np.ones(2))
    return LoopProof(model, ("k",), box, band, level, (strip,))


def refused_without(
    proof: LoopProof, place: object, function: str, answer: object, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Refused, and accepted where one function of the checker is not asked."""
    with pytest.raises(ProofError):
        check_loop_proof(proof)
    monkeypatch.setattr(place, function, lambda *_: answer)
    assert check_loop_proof(proof).level == proof.level


def test_a_hole_is_refused_by_its_function_alone(proof: LoopProof, monkeypatch: pytest.MonkeyPatch) -> None:
    refused_without(dataclasses.replace(proof, band=(0.4, 2.0)), strips, "require_cover", None, monkeypatch)


def test_negative_scalings_are_refused_by_their_function_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without it a level of 5 would be "proven", which the nominal member is above twice."""
    model = resonant()
    assert float(member_gains(model, 1.0, np.zeros((1, 1)))[0]) > 9.9
    refused_without(outside_proof(model, 5.0), strips, "scalings_allowed", True, monkeypatch)


@pytest.mark.parametrize("change", [lambda V: V[:, :-1], lambda V: np.zeros_like(V), lambda V: np.inf * V])
def test_coordinates_that_are_none_prove_nothing(
    proof: LoopProof, change: Callable[[np.ndarray], np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nobody trusts them: with fewer of them than signals a part of the form would be left out."""
    right = LoopModel.coordinates
    monkeypatch.setattr(LoopModel, "coordinates", lambda *asked: change(right(*asked)))
    with pytest.raises(ProofError, match="must hold beyond rounding"), np.errstate(invalid="ignore"):
        check_loop_proof(proof)


def test_a_level_that_is_exceeded_is_refused_by_the_inequality_alone(
    proof: LoopProof, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert float(member_gains(proof.model, 1.0, np.zeros((1, 1)))[0]) > 1.0
    refused_without(dataclasses.replace(proof, level=1.0), strips, "negative", True, monkeypatch)


def whole(model: LoopModel, box: tuple[tuple[float, float], ...], band: tuple[float, float]) -> LoopProof:
    found = prove_level(model, box, band, 1e4)
    assert not found.uncovered
    return LoopProof(model, ("d",), box, band, 1e4, tuple(found.strips))


UNSTABLE: dict[str, Callable[[], LoopProof]] = {
    "whole_axis": lambda: whole(damped(1.0), ((-0.2, 0.0),), (1.5, NYQUIST)),
    "nominal_windows": lambda: whole(overdriven(), ((-0.01, 0.01),), (0.0, NYQUIST)),
    "windows_above": lambda: whole(damped(500.0), ((-0.101, 0.0),), (0.0, NYQUIST)),
}
"""Function that is asked about stability, and a proof, with unstable members, that lacks its premise alone."""


def overdriven() -> LoopModel:
    """The nominal loop is unstable: the feedback of the velocity takes more than the damping away."""
    model = damped(1.0)
    return dataclasses.replace(model, K_C=-100.0 * model.K_C)


@pytest.mark.parametrize("function", UNSTABLE)
def test_unstable_members_are_not_called_stable_by_one_function_alone(
    function: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    forged = UNSTABLE[function]()
    checked = check_loop_proof(forged)
    assert not checked.stable and checked.stable_below < math.inf
    monkeypatch.setattr(stability, function, lambda *_: True)
    assert check_loop_proof(forged).stable


def test_stable_includes_poles_above_half_of_the_sampling_rate() -> None:
    """A mode of 500 rad/s above 314 rad/s: its damping passes zero, or does not."""
    model, whole = damped(500.0), (0.0, NYQUIST)
    assert nominal_windows(model)
    assert stable_below(model, whole, ((-0.101, 0.0),)) == NYQUIST
    assert stable_below(model, whole, ((-0.09, 0.2),)) == math.inf
    assert stable_below(model, BAND, ((-0.09, 0.2),)) == 0.0


def test_members_must_be_well_posed() -> None:
    """Beyond ``deviation feedthrough = 1`` a pole has come from infinity: no frequency shows it."""
    model = damped(1.0, feedthrough=1.0)
    assert windows_above(model, ((-0.1, 0.5),)) and not windows_above(model, ((-0.1, 2.0),))


def test_the_channels_above_are_enclosed() -> None:
    model = damped(500.0)
    far = beyond(model, 2000.0, commands_bound(model))
    for omega in np.geomspace(2000.0, 1e6, 50):
        exact = model.at(float(omega))[0][:, :1]
        assert np.all(np.abs(exact - far.c[0]) <= far.rad)
        window = channels(model, float(omega), float(omega) + 1e-3)
        assert np.all(np.abs(exact - window.c[0]) <= window.sizes[1:].sum(axis=0) + window.rad + 1e-13 * abs(exact))
