"""Content of files of proofs of a lower bound: the plant, the level, and vectors that no controller can influence."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lftkit.proofs.proof_files import Content, header_entries, write_content
from lftkit.proofs.trusted.entries import Form, array, each, header_of, index, number, record, text
from lftkit.proofs.trusted.lower_bound import LowerBoundClaim
from lftkit.proofs.trusted.proof import require

KIND = "lower bound"
PROPERTY = "H-infinity norm of any controller"
ARRAYS: dict[str, Form] = {
    name: array("float64", None, None)
    for name in (
        *"ABCD",
        "unseen",
        "unmoved",
        "left",
        "right",
        "noiseless",
        "weightless",
        "decaying",
        "decaying_adjoint",
        "undisturbed",
        "undisturbed_adjoint",
    )
}
HEADER: dict[str, Form] = {
    "claim": record({"property": text, "level": number}),
    "plant": record({"measured": each(index), "commanded": each(index), "dt": number}),
}


@dataclass(frozen=True)
class LowerBoundProof(LowerBoundClaim):
    """A claim (:class:`~lftkit.proofs.trusted.lower_bound.LowerBoundClaim`) that can be checked and written."""

    def to_file(self, path: Path) -> None:
        """Write the proof as a compressed ``.npz``."""
        write_content(path, self.content)

    @property
    def content(self) -> Content:
        """Content of its file."""
        claim = {"property": PROPERTY, "level": self.level}
        plant = {"measured": self.measured, "commanded": self.commanded, "dt": self.dt}
        arrays: dict[str, Any] = {name: np.asarray(getattr(self, name)) for name in ARRAYS}
        return header_entries(KIND, claim, plant), arrays


def lower_bound_proof_of(content: Content) -> LowerBoundProof:
    """The proof of a file's content; a ProofError where it is none."""
    header = header_of(content[0], KIND, HEADER)
    arrays = record(ARRAYS)(dict(content[1]), "the file")
    claim = header["claim"]
    require(claim["property"] == PROPERTY, f"property must be {PROPERTY!r}, got {claim['property']!r}"[:200])
    return LowerBoundProof(level=claim["level"], **header["plant"], **arrays)
