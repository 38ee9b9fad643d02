"""The checker passes a proof and refuses whatever was changed in it."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy import linalg
from support.uncertain_examples import aligned_modes, de_gaston_safonov

from lftkit.proofs import BoundOptions, ProofError, check_proof, robust_stability, worst_case_gain
from lftkit.proofs.trusted.arithmetic import Ball, definite_ratio, exact_product
from lftkit.proofs.trusted.cells import digest
from lftkit.proofs.trusted.proof import uncovered

Content = dict[str, Any]


@pytest.fixture(scope="module")
def proof() -> Content:
    bounds = worst_case_gain(aligned_modes(2, damping=0.02), options=BoundOptions(wall_limit=3600.0))
    assert bounds.proof is not None and bounds.proof.cells > 2 and check_proof(bounds.proof).margin >= 1.0
    return bounds.proof.content


def changed(proof: Content, change: Callable[[Content], None]) -> Content:
    """The proof with a change and with the digest of the changed content, as a forger would make it."""
    content = copy.deepcopy(proof)
    change(content)
    content["sha256"] = digest(content)
    return content


def test_a_change_without_a_new_digest_is_refused(proof: Content) -> None:
    content = copy.deepcopy(proof)
    content["cells"][0]["performance"] *= 1.0 + 1e-12
    with pytest.raises(ProofError, match="SHA-256"):
        check_proof(content)


def test_each_cell_is_needed(proof: Content) -> None:
    for number in range(len(proof["cells"])):
        with pytest.raises(ProofError, match="hole"):
            check_proof(changed(proof, lambda c, n=number: c["cells"].pop(n)))


def test_no_cell_can_be_widened(proof: Content) -> None:
    for number, cell in enumerate(proof["cells"]):
        low, high = cell["band"]

        def widen(content: Content, n: int = number, low: float = low, high: float | None = high) -> None:
            content["cells"][n]["band"] = [0.9 * low, None if high is None else 1.1 * high]

        with pytest.raises(ProofError, match="overlap"):
            check_proof(changed(proof, widen))


def test_a_wide_cell_cannot_replace_the_others(proof: Content) -> None:
    for number in range(len(proof["cells"])):

        def only(content: Content, n: int = number) -> None:
            content["cells"] = [{**content["cells"][n], "band": [0.0, None]}]

        with pytest.raises(ProofError, match="inequality"):
            check_proof(changed(proof, only))


@pytest.mark.parametrize(
    "change",
    [
        lambda c: c["claim"].update(level=0.94 * c["claim"]["level"]),  # the gain reaches 50
        lambda c: c["cells"][0].update(performance=-1.0),
        lambda c: c["cells"][0]["P"][0][0].__setitem__(0, -1.0),
        lambda c: c["cells"][1]["D"]["k0"][0][0].__setitem__(0, 0.0),
        lambda c: c["cells"][1].update(D={**c["cells"][1]["D"], "k0": [[[1e6]], [[0.0]]]}),
        lambda c: c["plant"]["A"][1].__setitem__(1, -0.03),  # less damping
        lambda c: c["claim"]["box"].update(k0=[0.8, 2.7]),
        lambda c: c["stable"]["point"].__setitem__(0, 9.0),
        lambda c: c["stable"]["L"][0].__setitem__(0, float("inf")),
        lambda c: c["cells"][0].pop("Q"),
        lambda c: c["cells"][0]["Q"][0][0].__setitem__(0, float("nan")),
        lambda c: c.update(claim={**c["claim"], "property": "stability", "level": None}, stable=None),
        lambda c: c["claim"].update(property="stability"),
        lambda c: c["claim"].update(level=None),
        lambda c: c["cells"].clear(),
    ],
)
def test_what_is_altered_is_refused_even_with_a_new_digest(proof: Content, change: Callable[[Content], None]) -> None:
    with pytest.raises(ProofError):
        check_proof(changed(proof, change))


def test_a_proof_of_stability_does_not_hold_for_an_unstable_box() -> None:
    proof = robust_stability(de_gaston_safonov(), options=BoundOptions(wall_limit=3600.0)).proof
    assert proof is not None

    def larger(content: Content) -> None:
        box = content["claim"]["box"]
        for owner in [box, *(dict(zip(box, c["intervals"])) for c in content["cells"])]:
            for ends in owner.values():
                ends[:] = [3.42 / 3.27 * end for end in ends]

    with pytest.raises(ProofError, match="inequality"):
        check_proof(changed(proof.content, larger))


def test_the_rounding_bound_of_a_product_covers_the_exact_one() -> None:
    rng = np.random.default_rng(3)
    for _ in range(20):
        a, b = (rng.normal(size=(6, 6)) * np.exp(rng.normal(size=(6, 6)) * 8.0) for _ in range(2))
        exact, rounded = exact_product(a, b), Ball(a) @ Ball(b)
        assert np.all(np.abs(exact.mid - rounded.mid) <= rounded.rad + exact.rad)


def test_a_matrix_that_is_not_certainly_definite_fails() -> None:
    rng = np.random.default_rng(4)
    for n in (2, 5, 12):
        basis = linalg.qr(rng.normal(size=(n, n)))[0]
        eigenvalues = np.linspace(1.0, 2.0, n)
        for least, passes in ((1e-3, True), (1e-17, False), (-1e-12, False)):
            matrix = basis @ np.diag([least, *eigenvalues[1:]]) @ basis.T
            assert (definite_ratio(Ball(matrix)) >= 1.0) is passes
        certain = basis @ np.diag(eigenvalues) @ basis.T
        assert definite_ratio(Ball(certain, np.full((n, n), 1.1 / n))) == 0.0  # the bound of the error is too large


def test_coverage_finds_a_hole_of_any_size() -> None:
    box = [(0.0, 1.0), (0.0, np.inf)]
    cells = [[(0.0, 1.0), (0.0, 1.0)], [(0.0, 0.5), (1.0, np.inf)], [(0.5, 1.0), (1.0, np.inf)]]
    assert uncovered(box, cells) is None
    assert uncovered([(0.3, 0.3), (0.0, np.inf)], cells) is None
    cells[2] = [(np.nextafter(0.5, 1.0), 1.0), (1.0, np.inf)]
    assert uncovered(box, cells) == [(0.5, np.nextafter(0.5, 1.0)), (1.0, np.inf)]
    assert uncovered(box, []) == box
