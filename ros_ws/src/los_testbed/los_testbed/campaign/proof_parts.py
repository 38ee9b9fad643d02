"""Parts of proofs on the worker processes of a Dask cluster: each is stored as soon as it is proven."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

from lftkit.support.workers import Workers
from los_design.verification.certify import (
    PartResult,
    ProofPart,
    Prover,
    keep_part,
    kept_part,
    prove_part,
    prove_task,
    task_of,
)
from los_testbed.campaign.cluster_work import ClusterWorkers, Work, results_on


def _named(part: ProofPart) -> str:
    low, high = part.band
    return f"the part from {low:g} to {high:g} rad/s"


PARTS = Work[ProofPart, PartResult](
    prove_task,
    sent=task_of,
    kept=kept_part,
    keep=keep_part,
    named=_named,
    advice="proven parts are stored: run again to resume",
)


def prover_of(workers: Workers) -> Prover:
    """Prover of parts on workers: of this machine, or of a cluster, which read and write no files."""
    if isinstance(workers, ClusterWorkers):
        return partial(prove_on, workers.client)
    return partial(workers.each, prove_part)


def prove_on(client: Any, parts: Sequence[ProofPart]) -> Iterator[PartResult]:
    """Results in the order of the parts; stored ones are read.

    Raises
    ------
    RuntimeError
        The connection to the scheduler or all workers were lost, or a part ends its workers; proven parts are stored.
    """
    return results_on(client, PARTS, parts)
