"""Proofs, verification and searches on a Dask cluster of this machine: the results of this process, to the bit."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lftkit import Port, RealParameter, System
from lftkit.proofs.sampled_loop import LoopProof, box_of, check_loop_proof, loop_model
from lftkit.proofs.sampled_loop.files import read_loop_proof, write_loop_proof
from lftkit.support.threads import one_thread
from lftkit.support.workers import Workers
from los_design.search.worst_case_search import Search, SearchOptions
from los_design.search.worst_points import WorstPoint
from los_design.synthesis.store import load_designs
from los_design.verification.certify import PartResult, ProofPart, prove_part
from los_design.verification.stage_check import check_stages
from los_loop.implemented_loop import ImplementedLoop
from los_loop.open_loop import OpenLoop
from titop_plant.interface import MIRROR_STAGES

pytest.importorskip("distributed")
from los_testbed.campaign import cluster_work
from los_testbed.campaign.cluster_work import ClusterWorkers
from los_testbed.campaign.execution import cluster
from los_testbed.campaign.proof_parts import prove_on

pytestmark = pytest.mark.slow
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


def test_a_proof_is_the_same_file_whatever_the_workers(tmp_path: Path) -> None:
    """One worker, two, none; what is kept after an end in the midst is not proven again."""
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


@pytest.fixture(scope="module")
def client() -> Iterator[Any]:
    """Of a cluster with two workers."""
    with cluster("", 2) as found:
        yield found


def squared(value: float) -> float:
    if value < 0.0:
        raise ValueError("value must not be negative,\ngot one")
    return value * value


def ended_first(path: str) -> float:
    """Ends its worker the first time."""
    if not os.path.exists(path):
        with open(path, "w", encoding="utf-8"):
            pass
        os._exit(1)
    return 1.0


def test_results_come_in_the_order_of_the_items(client: Any) -> None:
    workers, items = ClusterWorkers(client), [float(k) for k in range(11)]
    assert workers.map(squared, items) == [k * k for k in items]
    assert workers.map(squared, []) == []
    with pytest.raises(RuntimeError, match=r"^an item failed: ValueError: value must not be negative, got one, start"):
        workers.map(squared, [1.0, -1.0, 2.0])


def test_what_a_lost_worker_did_is_done_again(client: Any, tmp_path: Any) -> None:
    items = [str(tmp_path / f"{k}") for k in range(2)]
    assert ClusterWorkers(client).map(ended_first, items) == [1.0, 1.0]


def test_a_worker_of_another_version_is_refused(client: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    here = cluster_work.versions()
    monkeypatch.setattr(cluster_work, "versions", lambda: {**here, "numpy": "0.1"})
    with pytest.raises(RuntimeError, match=r"a worker must have .*'numpy': '0.1'"):
        ClusterWorkers(client).map(squared, [1.0, 2.0])


def test_checks_and_searches_are_those_of_one_process(client: Any, system: Any, telescope: Any) -> None:
    """A few points of both stages, and a short search with climbs around its best points."""
    open_loop = OpenLoop(system, telescope, telescope.loop_ports.used_by())
    loops = [ImplementedLoop(open_loop, *load_designs("implemented"), stage) for stage in MIRROR_STAGES]
    points = [{}, *system.sample_values(np.random.default_rng(3), 2)]
    options = SearchOptions(frequencies=20, points=6, ascents=6, iterations=5, patience=1)

    def found(workers: Workers) -> tuple[list[Any], dict[str, list[WorstPoint]]]:
        with one_thread():
            checks = check_stages(loops, points, changes=False, workers=workers)
            return checks, Search(loops[1], options).run(["slow"], workers=workers)

    (alone, one), (there, two) = found(Workers()), found(ClusterWorkers(client))
    for here, other in zip(alone, there, strict=True):
        assert here.stable.tolist() == other.stable.tolist() and here.unstable_changes == other.unstable_changes
        assert all(np.array_equal(values, other.envelope[name]) for name, values in here.envelope.items())
        assert {name: plain(p) for name, p in here.worst.items()} == {n: plain(p) for n, p in other.worst.items()}
    assert list(map(plain, one["slow"])) == list(map(plain, two["slow"])) and len(one["slow"]) > 1


def plain(point: WorstPoint) -> tuple[Any, ...]:
    """A point with its vectors as bytes, which compare as a whole."""
    flat = vars(replace(point))
    return tuple(value.tobytes() if isinstance(value, np.ndarray) else value for value in flat.values())
