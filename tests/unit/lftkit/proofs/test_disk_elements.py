"""Bounds with complex and dynamic elements: closed forms, members that are what they are said to be, forged proofs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy import linalg
from support.forged_proofs import forged
from support.slow_cases import slow

from lftkit import System, complex_gain, discretise, dynamic, feedback, hinf_norm, matrix, real, s
from lftkit.proofs import (
    BoundOptions,
    ProofError,
    ProvenBounds,
    check_proof,
    gain_profile,
    robust_performance,
    robust_stability,
    stability_profile,
    worst_case_gain,
)
from lftkit.proofs.state_space.bounds import named_member, smallest_unstable
from lftkit.proofs.state_space.cover import WHOLE
from lftkit.proofs.state_space.disk_search import DiskSearch
from lftkit.proofs.state_space.disks import dynamics_with, real_first
from lftkit.proofs.state_space.search import Member
from lftkit.uncertainty.elements import ComplexParameter, DynamicElement, RealParameter

LONG = BoundOptions(wall_limit=3600.0)


def lag(element: Any, dt: float = 0.0) -> System:
    """``1 / (s + 1 + element)``."""
    system: System = (1 / (s + 1 + element)).system("u", "y")
    return discretise(system, dt) if dt else system


@pytest.mark.parametrize("dt", [0.0, 0.1])
@pytest.mark.parametrize("element", [complex_gain("f", 0.0, radius=0.5), dynamic("f", bound=0.5)])
def test_a_lag_by_hand(element: Any, dt: float) -> None:
    """Gain 1 / (1 - 0.5) at zero, unstable from radius 1 on, twice the given one."""
    system = lag(element, dt)
    gain, margin = worst_case_gain(system, options=LONG), robust_stability(system, options=LONG)
    assert gain.status == margin.status == "closed"
    assert gain.lower == pytest.approx(2.0, rel=1e-6) and 2.0 <= gain.upper <= 1.05 * 2.0
    assert margin.upper == pytest.approx(2.0, rel=1e-6) and 2.0 / 1.05 <= margin.lower <= 2.0
    for bounds, radius in ((gain, 0.5), (margin, margin.lower * 0.5)):
        checked = check_proof(bounds.proof)
        assert checked.stable and checked.disks == {"f": radius} and checked.box == {}


def test_a_number_that_occurs_twice() -> None:
    """``1 / ((s + 1)^2 - f^2)``, two occurrences: poles -1 +- f, unstable from 1 on, and the phase of f is free."""
    f = complex_gain("f", 0.0, radius=0.5)
    system = (1 / ((s + 1) ** 2 - f * f)).system("u", "y")
    assert system.occurrences() == {"f": 2}
    margin = robust_stability(system)
    assert margin.status == "closed" and margin.upper == pytest.approx(2.0, rel=1e-6)
    worst = worst_case_gain(system)
    assert worst.lower == pytest.approx(1 / 0.75, rel=1e-6) and worst.upper <= 1.05 / 0.75
    assert check_proof(margin.proof).stable and check_proof(worst.proof).stable


@pytest.mark.parametrize("shape", [(2, 2), (1, 3)])
def test_a_matrix_of_dynamics_has_the_margin_of_the_norm(shape: tuple[int, int]) -> None:
    """One full block: the margin is one over the norm of what it sees."""
    rng = np.random.default_rng(sum(shape))
    A, B, C = -np.diag([1.0, 2.0, 3.0]), rng.normal(size=(3, shape[0])), rng.normal(size=(shape[1], 3))
    width = max(shape)
    into, out = np.zeros((3, width)), np.zeros((width, 3))
    into[:, : shape[0]], out[: shape[1]] = B, C
    element = DynamicElement("f", *shape, bound=0.2)
    system = System(A, into, out, np.zeros((width, width)), (), (), channels=("f",) * width, elements=(element,))
    margin = robust_stability(system, options=LONG)
    exact = 5.0 / hinf_norm(A, B, C, np.zeros((shape[1], shape[0]))).value
    assert margin.upper == pytest.approx(exact, rel=1e-5) and exact / 1.05 <= margin.lower <= exact
    assert check_proof(margin.proof).stable
    poles = system.at(margin.point).poles()
    assert np.abs(poles - 1j * margin.frequency).min() < 1e-6 * max(1.0, margin.frequency)


def mixed(dt: float = 0.0) -> System:
    k, f = real("k", 10, 7, 14), dynamic("f", bound=0.2)
    plant = (18 / (s**2 + 1.8 * s + k) * (1 + f)).system("u", "y")
    law = (0.1 + 0.3 / s).system("e", "u")
    loop = feedback(plant @ law)
    return discretise(loop, dt) if dt else loop


NARROW = {"k": (9.5, 10.5)}


@cache
def margin_of(dt: float) -> ProvenBounds:
    return robust_stability(mixed(dt), options=replace(LONG, gap=0.3))


@cache
def worst_of(dt: float) -> ProvenBounds:
    return worst_case_gain(mixed(dt), NARROW, options=replace(LONG, gap=0.25))


@pytest.mark.parametrize("dt", [0.0, pytest.param(0.05, marks=pytest.mark.slow)])
def test_members_that_are_named_are_as_bad_as_is_said(dt: float) -> None:
    """An asymmetric real parameter beside dynamics: the margin's member has its pole on the axis, or on the circle."""
    loop, margin, worst = mixed(dt), margin_of(dt), worst_of(dt)
    assert margin.status == "closed" and margin.lower <= margin.upper <= 1.3 * margin.lower
    poles = loop.at(margin.point, beyond_range=True).poles()
    at = np.exp(1j * margin.frequency * dt) if dt else 1j * margin.frequency
    assert np.abs(poles - at).min() < 1e-5 * max(1.0, abs(at))
    size = hinf_norm(*margin.point["f"].matrices, dt=dt or None).value / 0.2
    offset = margin.point["k"] - 10.0
    assert max(size, offset / 4.0 if offset > 0.0 else -offset / 3.0) == pytest.approx(margin.upper, rel=1e-6)
    assert check_proof(margin.proof).disks == {"f": pytest.approx(0.2 * margin.lower)}
    assert worst.status == "closed" and worst.lower <= worst.upper <= 1.25 * worst.lower
    member = loop.at(worst.point)
    assert hinf_norm(*member.matrices, dt=dt or None).value >= worst.lower * (1.0 - 1e-6)


def test_no_member_is_above_what_is_proven() -> None:
    """Random members, dynamics as all-pass systems: stable, with gains below the upper bound."""
    loop, worst, rng = mixed(), worst_of(0.0), np.random.default_rng(4)
    for values in loop.sample_values(rng, 40):
        member = loop.at({**values, "k": rng.uniform(*NARROW["k"])})
        assert member.poles().real.max() < 0.0
        assert hinf_norm(*member.matrices).value <= worst.upper


@pytest.mark.parametrize("omega", [0.0, 0.3, 20.0])
@pytest.mark.parametrize("dt", [0.0, 0.05])
def test_dynamics_have_the_value_and_the_norm_that_is_asked(omega: float, dt: float) -> None:
    rng = np.random.default_rng(2)
    u, v = (rng.normal(size=n) + 1j * rng.normal(size=n) * (omega > 0.0) for n in (3, 2))
    value = np.outer(u, v)
    member = dynamics_with(value, omega, dt)
    at = np.exp(1j * omega * dt) if dt else 1j * omega
    np.testing.assert_allclose(member(at), value, atol=1e-12 * linalg.norm(value))
    for w in (0.0, 0.1, 1.0, 7.0, 60.0):
        there = np.exp(1j * w * dt) if dt else 1j * w
        assert linalg.norm(member(there), 2) == pytest.approx(linalg.norm(value, 2), rel=1e-9)
    assert np.all(np.abs(member.poles()) < 1.0) if dt else np.all(member.poles().real < 0.0)


@pytest.fixture(scope="module")
def content() -> dict[str, Any]:
    check_proof(margin_of(0.0).proof)
    return dict(margin_of(0.0).proof.content)


def _disk(content: dict[str, Any], **changes: Any) -> None:
    content["plant"]["disks"][0].update(changes)


@pytest.mark.parametrize(
    "change",
    [
        lambda c: _disk(c, radius=2.0 * c["plant"]["disks"][0]["radius"]),
        lambda c: _disk(c, radius=-1.0),
        lambda c: _disk(c, radius=float("nan")),
        lambda c: _disk(c, name="k"),
        lambda c: _disk(c, name="g"),
        lambda c: _disk(c, outputs=2),
        lambda c: _disk(c, inputs=0),
        lambda c: c["plant"].pop("disks"),
        lambda c: c["plant"].update(disks=2 * c["plant"]["disks"]),
        lambda c: c["stable"]["weights"].pop("f"),
        lambda c: c["stable"]["weights"].update(f=[-1.0]),
        lambda c: [cell["D"].pop("f") for cell in c["cells"]],
        lambda c: [cell["D"].update(f=[[[0.0]], [[0.0]]]) for cell in c["cells"]],
        lambda c: [cell["D"].update(f=[[[-cell["D"]["f"][0][0][0]]], [[0.0]]]) for cell in c["cells"]],
        lambda c: c["plant"]["channels"].reverse(),
    ],
)
def test_a_forged_proof_is_refused(content: dict[str, Any], change: Callable[[dict[str, Any]], Any]) -> None:
    with pytest.raises(ProofError):
        check_proof(forged(content, change))


def test_a_smaller_radius_follows(content: dict[str, Any]) -> None:
    radius = 0.9 * content["plant"]["disks"][0]["radius"]
    assert check_proof(forged(content, lambda c: _disk(c, radius=radius))).stable


def test_what_is_not_available_is_a_line() -> None:
    loop = mixed()
    once = "a matrix of dynamics must occur once in a bound, got element 'f' 2"
    twice = matrix([[s + 1, 0], [0, s + 2]]).inverse() @ dynamic("f", 2, 2, bound=0.1)
    repeated = (twice @ twice).system([("u", 2)], [("y", 2)])
    for call, message in (
        (lambda: robust_performance(unstable()), "the nominal member must be stable, got an unstable one"),
        (lambda: gain_profile(repeated, [1.0]), once),
        (lambda: stability_profile(repeated, [1.0]), once),
        (lambda: worst_case_gain(loop, {"f": (0.0, 0.1)}), "element 'f' must be real"),
        (lambda: robust_stability(repeated), once),
    ):
        with pytest.raises(ValueError, match=message) as caught:
            call()
        assert "\n" not in str(caught.value)


def unstable() -> System:
    return ((1 + dynamic("f", bound=0.5)) / (s - 1)).system("u", "y")


def test_the_factor_of_dynamics_that_keeps_a_gain_by_hand(monkeypatch: pytest.MonkeyPatch) -> None:
    """(1 + f) / (s + 1), |f| <= t / 2: the largest gain 1 + t / 2 is at rest."""
    system = ((1 + dynamic("f", bound=0.5)) / (s + 1)).system("u", "y")
    bounds = robust_performance(system, level=1.4, options=replace(LONG, gap=0.4))
    assert bounds.status == "closed" and bounds.upper == pytest.approx(0.8, rel=1e-6)
    assert bounds.upper <= 1.4 * bounds.lower and check_proof(bounds.proof).level == 1.4
    assert hinf_norm(*system.at(bounds.point).matrices).value == pytest.approx(1.4, rel=1e-6)
    nominal = robust_performance(system, level=0.9)
    assert nominal.status == "violated" and nominal.upper == 0.0 and nominal.proof is None
    searched: list[DiskSearch] = []
    search = DiskSearch.worst_member

    def counted(own: DiskSearch) -> Member:
        searched.append(own)
        return search(own)

    monkeypatch.setattr(DiskSearch, "worst_member", counted)
    late = robust_performance(system, level=1.4, options=BoundOptions(wall_limit=1e-9))
    assert late.status == "out_of_time" and late.upper >= 0.8 and len(searched) == 1


@pytest.mark.slow
def test_real_and_complex_numbers_keep_a_gain_by_hand() -> None:
    """(1 + c) / (s + 1 - p), both of size t / 2: (1 + t / 2) / (1 - t / 2) is 2 at t = 2 / 3, 1e-6 of it by search."""
    system = ((1 + complex_gain("c", 0.0, radius=0.5)) / (s + 1 - real("p", 0.0, -0.5, 0.5))).system("u", "y")
    bounds = robust_performance(system, level=2.0, options=LONG)
    assert bounds.status == "closed" and bounds.upper == pytest.approx(2.0 / 3.0, rel=1e-6)
    assert bounds.upper <= 1.05 * bounds.lower and check_proof(bounds.proof).level == 2.0
    assert bounds.point["p"] == pytest.approx(1.0 / 3.0, rel=1e-5)


@pytest.mark.parametrize("corner", [1.0, 1e-10])
def test_the_gain_that_a_frequency_is_said_to_have_is_reached_there(corner: float) -> None:
    """(1 - f^2) / (s / corner + 1), |f| <= 1/2: 5/4 is approached, for f = j / 2, next to zero; at zero f is real."""
    f = dynamic("f", bound=0.5)
    system = ((1 + f) * (1 - f) / (s / corner + 1)).system("u", "y")
    found = DiskSearch(real_first(system), [], WHOLE, 0).largest_gain()
    values = named_member(system, found)
    assert found.gain == pytest.approx(1.25, rel=1e-5) and found.frequency > 0.0
    assert abs(system.at(values).response([found.frequency])[0, 0, 0]) == pytest.approx(found.gain, rel=1e-9)


@pytest.mark.parametrize("phase", [2e-9, 1e-3, 2.0, np.pi - 1e-7])
@pytest.mark.parametrize("end", [0.0, 1.0])
def test_dynamics_of_samples_at_the_ends_of_the_circle_are_stable(phase: float, end: float) -> None:
    """Their poles had been at 1 to rounding: the member that a bound names was no stable one."""
    dt, value = 0.1, 0.4 * np.exp(1j * phase)
    member = dynamics_with(np.array([[value]]), end * np.pi / dt, dt)
    assert np.abs(member.poles()).max(initial=0.0) < 1.0 - 1e-13
    assert hinf_norm(*member.matrices, dt=dt).value == pytest.approx(0.4, rel=1e-9)
    for z in (1.0, -1.0):  # the poles are next to one of them, 1e-5 of the gain had been lost
        assert abs(member(z)) == pytest.approx(0.4, rel=1e-12)
    near = abs(end * np.pi - 2e-6) / dt  # tan(omega dt / 2) is 1e-6, or one over it
    assert abs(member.response([near])[0, 0, 0] - value) < 0.4 * 1.1e-5


@pytest.mark.further
@pytest.mark.parametrize("seed", [11, 51, slow(4), slow(56)])
def test_the_smallest_unstable_factor_is_that_of_a_grid(seed: int) -> None:
    """Two equal resonances of damping ratio 0.015; a pole is on the axis where the complex element closes the loop."""
    rng = np.random.default_rng(seed)
    A, B, C = (
        np.kron(np.eye(2), [[-0.01, 1.0], [-1.0, -0.03]]),
        rng.standard_normal((4, 2)),
        rng.standard_normal((2, 4)),
    )
    elements = RealParameter("p", 0.0, -0.7, 0.4), ComplexParameter("f", 0.0, 0.3)
    system = System(A, 0.25 * B, 0.25 * C, np.zeros((2, 2)), (), (), channels=("p", "f"), elements=elements)
    omega = np.concatenate([np.linspace(0.0, 3.0, 2000), np.linspace(0.9, 1.1, 2000)])
    parts = np.linspace(-2.0, 2.0, 3201)
    M = np.array([0.25 * C @ linalg.solve(1j * w * np.eye(4) - A, 0.25 * B) for w in omega])
    p = np.where(parts < 0.0, 0.7, 0.4) * parts
    closed = M[:, 1, 1, None] + (M[:, 1, 0] * M[:, 0, 1])[:, None] * p / (1.0 - M[:, :1, 0] * p)
    expected = float(np.maximum(np.abs(parts), 1.0 / (0.3 * np.abs(closed))).min())
    found, _ = smallest_unstable(system, [(-0.7, 0.4)], 2.0, seed=0)
    assert found == pytest.approx(expected, rel=6e-3) if expected < 1.9 else found >= 1.9
