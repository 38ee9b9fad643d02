"""Parts of a proof on a Dask cluster of this machine: the same files for one worker and for two, and without it."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lftkit import Port, RealParameter, System
from lftkit.proofs.sampled_loop import LoopProof, box_of, check_loop_proof, loop_model
from lftkit.proofs.sampled_loop.files import read_loop_proof, write_loop_proof
from los_design.verification.certify import PartResult, ProofPart, prove_part

pytest.importorskip("distributed")

DT, LEVEL = 0.01, 12.0
BANDS = ((0.0, 0.4), (0.4, 0.8), (0.8, 0.95), (0.95, 1.2), (1.2, 10.0), (10.0, math.pi / DT))


def parts(folder: Path) -> list[ProofPart]:
    """Of the position of a mass on a spring of uncertain stiffness, by a force."""
    k = RealParameter("k", 1.0, 0.8, 1.3)
    A, B, C = [[0.0, 1.0], [-1.0, -0.1]], [[0.0, 0.0], [-1.0, 1.0]], [[1.0, 0.0], [1.0, 0.0]]
    system = System(A, B, C, np.zeros((2, 2)), (Port("force", 1),), (Port("x", 1),), channels=("k",), elements=(k,))
    folder.mkdir(exist_ok=True)
    model, box = loop_model(system, DT), box_of(system)
    return [ProofPart(model, box, band, LEVEL, math.inf, folder / f"{n}.npz") for n, band in enumerate(BANDS)]


def written(folder: Path, results: list[PartResult]) -> bytes:
    """Bytes of the proof of all parts."""
    own = parts(folder)[0]
    strips = tuple(strip for result in results for strip in result.strips)
    proof = LoopProof(own.model, ("k",), own.box, (0.0, BANDS[-1][1]), LEVEL, strips)
    write_loop_proof(proof, folder / "proof.npz")
    assert check_loop_proof(read_loop_proof(folder / "proof.npz")).level == LEVEL
    return (folder / "proof.npz").read_bytes()


def kept(folder: Path) -> dict[str, int]:
    return {path.name: path.stat().st_mtime_ns for path in folder.glob("[0-9].npz")}


@pytest.mark.slow
def test_a_proof_is_the_same_file_whatever_the_workers(tmp_path: Path) -> None:
    """One worker, two, none; what is kept after an end in the midst is not proven again."""
    from los_testbed.campaign.execution import cluster
    from los_testbed.campaign.proof_parts import prove_on

    expected = written(tmp_path / "alone", [prove_part(part) for part in parts(tmp_path / "alone")])
    for workers in (1, 2):
        folder = tmp_path / str(workers)
        with cluster("", workers) as client:
            first = prove_on(client, parts(folder))
            next(first), next(first)
            first.close()  # as an interrupt ends it
            before = kept(folder)
            assert len(before) >= 2
            results = list(prove_on(client, parts(folder)))
            assert before.items() <= kept(folder).items() and len(kept(folder)) == len(BANDS)
            with pytest.raises(RuntimeError, match="proven parts are stored"):
                list(prove_on(client, [replace(parts(tmp_path / "none")[0], model=None)]))  # type: ignore[arg-type]
        assert written(folder, results) == expected
        summary = json.loads(bytes(np.load(folder / "2.npz")["header"]).decode())
        assert summary["finished"] and not summary["uncovered"]
