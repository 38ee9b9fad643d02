"""Whether a proof is of given controllers, telescope, stage and figure: its model is made again.

The words in a proof file are for people and prove nothing, and its matrices need not be those of the loop that it
names. So the model of that loop is made anew (:func:`proof_of_loop`), and what is checked are the scalings of the file
**with that model**: nothing of the file's own matrices is used. :func:`compare_proof` says, before that work, what of a
file is another one: every entry that is not a matrix must be the same. The matrices are in modal coordinates, which
differ from machine to machine: their poles and their responses are compared, at each resonance and between them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from lftkit.arrays import ComplexArray, FloatArray
from lftkit.proofs.sampled_loop import LoopModel, LoopProof
from lftkit.proofs.trusted.loop import Loop
from lftkit.proofs.trusted.noise import NoiseProof
from lftkit.proofs.trusted.proof import Interval, ProofError
from los_design.verification.loop_models import NYQUIST, box_of, provable, telescope_model
from los_design.verification.noise_certificate import noise_of_loop
from los_loop.implemented_loop import ImplementedLoop, LoopMetric

SAME = 1e-6
"""Largest difference of responses, of the largest entry at their frequency, and of poles, of their modulus."""
EXACT = ("dt", "frame", "groups", "angle", "weights", "window", "rows", "scale", "commands", "added", "returned")
"""Fields of a model that are the same on every machine."""
POLES = {"poles": "telescope", "K_poles": "controllers"}
LOWEST, BETWEEN = 1e-3, 50
"""First frequency [rad/s] and number of frequencies between the resonances."""


@dataclass(frozen=True)
class ProofComparison:
    """What a comparison of a proof with a loop found.

    Parameters
    ----------
    mismatches : tuple of str
        What is another one in the proof than in the loop, a phrase each; empty if it is a proof of the loop.
    difference : float
        Largest difference of the responses, of the largest entry at its frequency; NaN if they were not compared.
    frequency : float
        Where that is [rad/s].
    """

    mismatches: tuple[str, ...]
    difference: float = np.nan
    frequency: float = np.nan

    @property
    def same(self) -> bool:
        """Whether the proof is of the loop."""
        return not self.mismatches


def compare_proof(proof: LoopProof, loop: ImplementedLoop, figure: str) -> ProofComparison:
    """Compare a proof with a loop.

    Parameters
    ----------
    proof : LoopProof
    loop : ImplementedLoop
        Controllers, telescope and stage.
    figure : str
        One of :func:`los_design.verification.loop_models.provable`.
    """
    metric = provable(loop.telescope, loop.stage, loop.ports).get(figure)
    if metric is None:
        return ProofComparison((f"stage {loop.stage} has no figure {figure}",))
    mismatches, model = _claim_mismatches(proof, loop, metric), telescope_model(loop, metric)
    return _compared(proof.model, model, metric.band, mismatches)


def compare_noise(proof: NoiseProof, loop: ImplementedLoop) -> ProofComparison:
    """Compare a proof of noise with a loop."""
    try:
        anew = noise_of_loop(proof, loop)
    except ProofError as error:
        return ProofComparison((str(error),))
    return _compared(proof.model, anew.model, (0.0, NYQUIST), [])


def _compared(one: Loop, model: Loop, band: Interval, mismatches: list[str]) -> ProofComparison:
    """Compare the model of a file with that of a loop; `mismatches` is what else is another one."""
    mismatches = [name for name in EXACT if not _equal(getattr(model, name), getattr(one, name))] + mismatches
    for name, where in POLES.items():
        if not _same_poles(getattr(one, name), getattr(model, name)):
            mismatches.append(f"poles of the {where}")
    if mismatches or _shapes(one) != _shapes(model):
        return ProofComparison(tuple(mismatches) or ("sizes of telescope or controllers",))
    omega = _frequencies(model, band)
    differences = np.array([_difference(one, model, at) for at in omega])
    worst = int(np.argmax(differences))
    wrong = () if differences[worst] <= SAME else ("responses of telescope or controllers",)
    return ProofComparison(wrong, float(differences[worst]), float(omega[worst]))


def proof_of_loop(proof: LoopProof, loop: ImplementedLoop, figure: str) -> LoopProof:
    """The proof of a file as one of a loop: box, band, level and scalings are of the file, the model is made anew.

    Parameters
    ----------
    proof : LoopProof
    loop : ImplementedLoop
    figure : str

    Raises
    ------
    ProofError
        The loop has no such figure, or the file claims less than its whole box and band.
    """
    metric = provable(loop.telescope, loop.stage, loop.ports).get(figure)
    if metric is None:
        raise ProofError(f"stage {loop.stage} has no figure {figure}")
    missing = _claim_mismatches(proof, loop, metric)
    if missing:
        raise ProofError(f"{loop.stage}, {figure}: the proof must be of the whole loop, got other {', '.join(missing)}")
    about = {"stage": loop.stage, "figure": figure, "limit": metric.limit}
    return replace(proof, model=telescope_model(loop, metric), about=about)


def _claim_mismatches(proof: LoopProof, loop: ImplementedLoop, metric: LoopMetric) -> list[str]:
    """What the claim of a proof leaves out of a figure of a loop: parameters, parts of the box, of the band."""
    mismatches = []
    if proof.names != tuple(p.name for p in loop.system.parameters):
        mismatches.append("names of the parameters")
    elif not all(map(_covers, proof.box, box_of(loop))):
        mismatches.append("box of the parameters")
    if not _covers(proof.band, metric.band):
        mismatches.append("band of frequencies")
    return mismatches


def _equal(one: Any, other: Any) -> bool:
    return np.array_equal(one, other) if isinstance(one, np.ndarray) else one == other


def _shapes(model: Loop) -> tuple[tuple[int, ...], ...]:
    return tuple(getattr(model, name).shape for name in ("C", "B", "D", "K_C", "K_B", "K_D"))


def _covers(proven: Interval, needed: Interval) -> bool:
    """Whether an interval holds another one, to the last bit: a statement names the interval of the proof."""
    return proven[0] <= needed[0] and proven[1] >= needed[1]


def _same_poles(one: ComplexArray, other: ComplexArray) -> bool:
    """Whether two sets agree, each pole with the nearest of the other set that is left."""
    if len(one) != len(other):
        return False
    left = list(other)
    for pole in one:
        nearest = int(np.argmin(np.abs(np.array(left) - pole)))
        if abs(left.pop(nearest) - pole) > SAME * max(abs(pole), 1e-3):
            return False
    return True


def _frequencies(model: Loop, band: Interval) -> FloatArray:
    """Resonances of telescope and controllers in a band, and frequencies between them."""
    low, high = max(band[0], LOWEST), band[1]
    resonances = np.abs(model.poles.imag), np.abs(np.angle(model.K_poles)) / model.dt
    omega: FloatArray = np.unique(np.concatenate([*resonances, np.geomspace(low, high, BETWEEN)]))
    return omega[(omega >= low) & (omega <= high)]


def _difference(one: Loop, other: Loop, omega: float) -> float:
    """Largest difference of the responses at a frequency, of the largest entry of each."""
    pairs = zip(*(cast("LoopModel", model).at(omega) for model in (one, other)))  # those of files and loops have it
    return max(float(np.abs(a - b).max() / max(np.abs(b).max(), np.finfo(float).tiny)) for a, b in pairs)
