"""Verification, searches and designs on a Dask cluster of this machine: the results of this process, to the bit."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from lftkit.support.threads import one_thread
from lftkit.support.workers import Workers
from los_design.search.worst_case_search import Search, SearchOptions
from los_design.search.worst_points import WorstPoint
from los_design.synthesis.store import load_designs
from los_design.verification.stage_check import check_stages
from los_loop.implemented_loop import ImplementedLoop
from los_loop.open_loop import OpenLoop
from titop_plant.interface import MIRROR_STAGES

pytest.importorskip("distributed")


@pytest.fixture(scope="module")
def client() -> Iterator[Any]:
    """Of a cluster with two workers."""
    from los_testbed.campaign.execution import cluster

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


@pytest.mark.slow
def test_results_come_in_the_order_of_the_items(client: Any) -> None:
    from los_testbed.campaign.cluster_work import ClusterWorkers

    workers, items = ClusterWorkers(client), [float(k) for k in range(11)]
    assert workers.map(squared, items) == [k * k for k in items]
    assert workers.map(squared, []) == []
    with pytest.raises(RuntimeError, match=r"^an item failed: ValueError: value must not be negative, got one, start"):
        workers.map(squared, [1.0, -1.0, 2.0])


@pytest.mark.slow
def test_what_a_lost_worker_did_is_done_again(client: Any, tmp_path: Any) -> None:
    from los_testbed.campaign.cluster_work import ClusterWorkers

    items = [str(tmp_path / f"{k}") for k in range(2)]
    assert ClusterWorkers(client).map(ended_first, items) == [1.0, 1.0]


@pytest.mark.slow
def test_a_worker_of_another_version_is_refused(client: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    from los_testbed.campaign import cluster_work

    here = cluster_work.versions()
    monkeypatch.setattr(cluster_work, "versions", lambda: {**here, "numpy": "0.1"})
    with pytest.raises(RuntimeError, match=r"a worker must have .*'numpy': '0.1'"):
        cluster_work.ClusterWorkers(client).map(squared, [1.0, 2.0])


@pytest.mark.slow
def test_checks_and_searches_are_those_of_one_process(client: Any, system: Any, telescope: Any) -> None:
    """A few points of both stages, and a short search with climbs around its best points."""
    from los_testbed.campaign.cluster_work import ClusterWorkers

    open_loop = OpenLoop(system, telescope)
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
