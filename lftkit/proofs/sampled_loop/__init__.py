"""Guaranteed worst case of sampled loops of any order, by scalings at frequencies, with a proof and its checker."""

from lftkit.proofs.sampled_loop.bounds import LoopBounds, prove_level
from lftkit.proofs.sampled_loop.build import box_of, loop_model
from lftkit.proofs.sampled_loop.checker import CheckedLoop, check_loop_proof
from lftkit.proofs.sampled_loop.model import LoopModel
from lftkit.proofs.sampled_loop.proof import LoopProof, Strip

__all__ = [
    "CheckedLoop",
    "LoopBounds",
    "LoopModel",
    "LoopProof",
    "Strip",
    "box_of",
    "check_loop_proof",
    "loop_model",
    "prove_level",
]
