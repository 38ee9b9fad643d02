"""D-K iteration: the bound holds on a dense grid, for members, and by a proof; all kinds of elements; refusals."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import linalg

from lftkit import InputError, System, complex_gain, connect, dynamic, hinf_norm, real, s
from lftkit.proofs import BoundOptions, check_proof
from lftkit.proofs.robustness import scaled_elements
from lftkit.synthesis import MuDesign, hinfsyn, musyn
from lftkit.systems.sampled.bilinear import to_discrete

OMEGA = np.geomspace(1e-3, 1e3, 40)


def plant(expression: Any) -> System:
    """Reference w to weighted error z and weighted command; the controller sees the error e."""
    return connect(
        {
            "G": expression.system("u", "y"),
            "W": (0.5 * (s + 0.8) / (s + 0.008)).system("e", "z"),
            "error": System.static([[1.0, -1.0]], [("r", 1), ("y", 1)], [("e", 1)]),
            "effort": System.static([[0.05]], [("u", 1)], [("z", 1)]),
        },
        [("u", "G.u"), ("u", "effort.u"), ("w", "error.r"), ("G.y", "error.y"), ("error.e", "W.e")],
        inputs=[("w", 1), ("u", 1)],
        outputs={"z": "W.z", "effort": "effort.z", "e": "error.e"},
    )


LAG = 1 / ((s + 1) * (0.2 * s + 1))
UNMODELLED = plant((1 + 0.3 * (s + 1) / (0.1 * s + 1) * dynamic("delta")) * LAG)


def scaled_gain(design: MuDesign, omega: Any) -> float:
    """Largest norm of the loop between the scalings, element by element of size 1, from responses alone."""
    closed = design.closed.normalised()
    q = len(closed.channels)
    M = System(closed.A, closed.B, closed.C, closed.D, [("w", closed.D.shape[1])], [("z", closed.D.shape[0])])
    largest = 0.0
    for k, response in enumerate(M.response(omega)):
        d = np.array([abs(one.response([omega[k]])[0, 0, 0]) for one in design.scalings])
        assert len(d) == q
        left, right = (np.concatenate([d, np.ones(n - q)]) for n in response.shape)
        largest = max(largest, float(linalg.norm(left[:, None] * response / right, 2)))
    return largest


@pytest.fixture(scope="module")
def found() -> MuDesign:
    return musyn(UNMODELLED, "e", "u", omega=OMEGA, options=BoundOptions(gap=0.05, wall_limit=3600.0))


@pytest.mark.further
def test_the_bound_holds_between_the_frequencies_of_the_design(found: MuDesign) -> None:
    assert found.status == "converged"
    assert found.value <= found.bound <= 1.02 * min(found.peaks)
    assert found.value >= 0.98 * found.bound
    dense = np.geomspace(1e-4, 1e4, 500)
    assert 0.99 * found.bound < scaled_gain(found, dense) <= found.bound * (1.0 + 1e-6)
    for one in found.scalings:
        assert np.all(one.poles().real < 0.0) and np.all(one.inverse().poles().real < 0.0)


@pytest.mark.further
def test_members_within_one_over_the_bound_are_stable_with_a_gain_below_it(found: MuDesign) -> None:
    inside = scaled_elements(found.closed, 1.0 / found.bound)
    gains = [hinf_norm(*member.matrices).value for member in inside.sample(np.random.default_rng(0), 40)]
    assert max(gains) < found.bound
    assert max(gains) > 0.5 * found.bound


def test_it_is_better_than_the_controller_of_the_least_norm(found: MuDesign) -> None:
    assert min(found.peaks) < found.peaks[0]
    nominal = hinfsyn(UNMODELLED.nominal(), "e", "u")
    assert nominal.value < found.bound, "without uncertainty less can be reached"


@pytest.mark.further
def test_the_bound_is_proven_by_separate_code(found: MuDesign) -> None:
    assert found.proof is not None
    assert found.proof.lower >= 0.75 / found.bound
    assert check_proof(found.proof.proof).stable


def test_the_best_controller_is_kept(found: MuDesign) -> None:
    first = musyn(UNMODELLED, "e", "u", iterations=1, omega=OMEGA)
    assert first.status == "iteration_limit" and len(first.peaks) == 1
    assert found.peaks[0] == pytest.approx(first.peaks[0], rel=1e-6)
    assert found.bound <= first.bound * (1.0 + 1e-6)


@pytest.mark.further
def test_real_and_complex_elements_are_scaled_to_their_ranges() -> None:
    k, c = real("k", 1.0, 0.7, 1.3), complex_gain("c", 1.0, radius=0.1)
    found = musyn(plant(c * LAG * k), "e", "u", iterations=2, omega=OMEGA[::2])
    assert scaled_gain(found, np.geomspace(1e-3, 1e3, 200)) <= found.bound * (1.0 + 1e-6)
    assert found.value <= found.bound <= 1.05 * min(found.peaks)
    inside = 0.3 / found.bound
    for value in (1.0 - inside, 1.0, 1.0 + inside):
        member = found.closed.at({"k": value, "c": 1.0 + 0.1 / found.bound}, beyond_range=True)
        assert hinf_norm(*member.matrices).value < found.bound


def test_matrices_of_dynamics_need_not_be_square() -> None:
    """Two loops with a block of three outputs and two inputs."""
    rng = np.random.default_rng(0)
    E, F = 0.1 * rng.standard_normal((2, 3)), rng.standard_normal((2, 2))
    eye, ports = np.eye(2), ([("u", 2)], [("y", 2)])
    whole = connect(
        {
            "G": System(-eye, eye, eye, 0.0 * eye, *ports),
            "rest": (E @ dynamic("block", 3, 2) @ F).system(*ports),
            "error": System.static(0.5 * eye, *ports),
            "effort": System.static(0.1 * eye, *ports),
        },
        [("u", "G.u"), ("u", "rest.u"), ("u", "effort.u"), (("G.y", "rest.y", "d"), "error.u")],
        inputs=[("d", 2), ("u", 2)],
        outputs={"z": "error.y", "effort": "effort.y", "y": ("G.y", "rest.y", "d")},
    )
    found = musyn(whole, "y", "u", iterations=2, omega=OMEGA)
    assert found.value <= found.bound < np.inf
    inside = scaled_elements(found.closed, 1.0 / found.bound)
    for member in inside.sample(np.random.default_rng(1), 10):
        assert hinf_norm(*member.matrices).value < found.bound


@pytest.mark.further
def test_a_sampled_image_has_the_same_bound() -> None:
    dt = 0.05
    image = UNMODELLED.with_lft(to_discrete(*UNMODELLED.lft, dt), dt=dt)
    omega = OMEGA[::2]
    first = musyn(UNMODELLED, "e", "u", iterations=2, omega=omega)
    second = musyn(image, "e", "u", iterations=2, omega=2.0 / dt * np.arctan(0.5 * dt * omega))
    assert second.controller.dt == dt and second.closed.dt == dt
    assert second.bound == pytest.approx(first.bound, rel=1e-3)
    assert np.all(np.abs(second.closed.nominal().poles()) < 1.0)


K = real("k", 1.0, 0.8, 1.2)


@pytest.mark.parametrize(
    ("given", "options", "message"),
    [
        (plant(K * LAG * (1 + 0.1 * K)), {}, "element 'k' must occur once for musyn, got 2 occurrences"),
        (plant(LAG), {}, "must have uncertain elements for musyn"),
        (UNMODELLED, {"iterations": 0}, "iterations must be at least 1, got 0"),
        (UNMODELLED, {"iterations": 1.5}, "iterations must be an integer, got 1.5"),
        (UNMODELLED, {"scaling_order": -1}, "scaling_order must be at least 0, got -1"),
        (UNMODELLED, {"omega": "low"}, "omega must be a vector of finite numbers, got str"),
        (UNMODELLED, {"omega": [-1.0, 1.0]}, "omega must be positive and rising, below inf rad/s"),
    ],
)
def test_what_it_does_not_take_is_refused_by_name(given: System, options: Any, message: str) -> None:
    """A fit that refuses its frequencies ended the iteration as if no controller existed."""
    with pytest.raises(InputError, match=message):
        musyn(given, "e", "u", **options)
