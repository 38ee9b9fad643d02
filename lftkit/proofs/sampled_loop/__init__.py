"""Guaranteed worst case of sampled loops of any order, by scalings at frequencies, with a proof and its checker."""

from typing import TYPE_CHECKING

from lftkit.support.on_demand import names_on_demand

if TYPE_CHECKING:
    from lftkit.proofs.sampled_loop.bounds import BisectionOptions, LoopBounds, prove_level
    from lftkit.proofs.sampled_loop.build import box_of, loop_model
    from lftkit.proofs.sampled_loop.files import read_loop_proof, write_loop_proof
    from lftkit.proofs.sampled_loop.model import LoopModel
    from lftkit.proofs.trusted.sampled_loop import CheckedLoop, LoopProof, check_loop_proof

__all__ = [
    "BisectionOptions",
    "CheckedLoop",
    "LoopBounds",
    "LoopModel",
    "LoopProof",
    "box_of",
    "check_loop_proof",
    "loop_model",
    "prove_level",
    "read_loop_proof",
    "write_loop_proof",
]

__getattr__ = names_on_demand(
    __name__,
    {
        "bounds": ("BisectionOptions", "LoopBounds", "prove_level"),
        "build": ("box_of", "loop_model"),
        "files": ("read_loop_proof", "write_loop_proof"),
        "model": ("LoopModel",),
        "lftkit.proofs.trusted.sampled_loop": ("CheckedLoop", "LoopProof", "check_loop_proof"),
    },
)
