"""Cost of the members of a campaign beside a loop over recorded runs, and how it scales with the workers.

    python benchmarks/campaign.py [--members 10] [--workers 1,2] [--counts 100,1000,10000] [--json]

``time_depth_ratio`` is the CPU time of a loop over ``run_in_process`` with the metrics read from each bag, over that of
the same members at depth ``time``, in chunks of ten, both in this process, in the scenario of the command (``design``),
each with its start computed anew; worst relative and absolute error must agree to the last bit. ``worst_case_cpu_s`` is
that of a member in the scenario worst_case, whose tone is searched for. ``scaling`` is members per second of wall time
through a local Dask cluster with so many workers, at depth ``time``. ``growth`` is for
campaigns of ``--counts`` members at depth ``model`` with two workers: CPU seconds a member of workers and client (with
scheduler and writing), and the most memory that the client and a worker had. ``hours_for_1e6`` are the hours that 1e6
members take on so many cores from the CPU times of the members and of the client in the largest of these campaigns; a
client that is busier than its one core is the limit.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from los_testbed.campaign.dataset import Campaign, ResultFolder
from los_testbed.campaign.execution import cluster, evaluate_chunk, run_campaign
from los_testbed.campaign.member import MemberEvaluator
from los_testbed.campaign.portable import portable
from los_testbed.campaign.sampling import MemberParameters
from los_testbed.config.run_config import RunConfig
from los_testbed.parts import start as run_start
from los_testbed.run.identity import identity
from los_testbed.run.loop.simulate import run_in_process

from pointing_analysis.read.run import Run
from pointing_analysis.requirements.summary import summarise
from titop_plant.simulation import build as simulation
from titop_plant.simulation import modal_plant

CORES = (2, 32, 512)


def forget() -> None:
    """What is kept of the last runs: no member has the start of another, or of its recorded run."""
    run_start._found.clear()
    simulation._design_tones.cache_clear()
    modal_plant._modal_plant.cache_clear()


def cost(base: RunConfig, count: int) -> dict[str, float]:
    """CPU seconds of a member: recorded run, depth time, depth model."""
    evaluator = MemberEvaluator.of(base)
    chunks = [chunk for _, chunk in Campaign.of(base, "uniform", count, 1, "time", {}).chunks()]
    for depth in ("time", "model"):  # what a process prepares once is left out
        evaluator.rows(chunks[0][:1], depth)
    seconds = dict.fromkeys(("recorded", "time", "model"), 0.0)
    found = []
    with tempfile.TemporaryDirectory() as folder:
        for member in (member for chunk in chunks for member in chunk):
            forget()
            start = time.process_time()
            bag = Path(folder) / str(member["index"])
            run_in_process(replace(base, **MemberParameters.of().settings(member)), bag)
            summary = summarise(Run.open(bag))
            seconds["recorded"] += time.process_time() - start
            found.append((summary.rpe_quantile, summary.ape_max))
    rows = []
    for depth in ("model", "time"):
        forget()
        start = time.process_time()
        rows = [row for chunk in chunks for row in evaluator.rows(chunk, depth)]
        seconds[depth] = time.process_time() - start
    if [(row["rpe_p997_mas"], row["ape_max_arcsec"]) for row in rows] != found:
        raise SystemExit("the metrics differ from those of the bags")
    return {name: value / count for name, value in seconds.items()}


def time_cost(base: RunConfig, count: int) -> float:
    """CPU seconds of a member at depth time."""
    evaluator = MemberEvaluator.of(base)
    members = [
        member for _, chunk in Campaign.of(base, "uniform", count + 1, 1, "time", {}).chunks() for member in chunk
    ]
    evaluator.rows(members[:1], "time")
    forget()
    start = time.process_time()
    evaluator.rows(members[1:], "time")
    return (time.process_time() - start) / count


def rate(base: RunConfig, members: int, workers: int) -> float:
    """Members per second of wall time with a local cluster, its start left out."""
    campaign = Campaign.of(base, "uniform", members, 1, "time", identity(base))
    with tempfile.TemporaryDirectory() as folder, cluster("", workers) as client:
        results = ResultFolder(Path(folder) / "campaign")
        start = time.monotonic()
        run_campaign(campaign, results, client, results.open(campaign, False))
        return members / (time.monotonic() - start)


def usage() -> tuple[float, float]:
    """CPU seconds and largest memory [MB] of this process so far."""
    return time.process_time(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def growth(base: RunConfig, counts: list[int]) -> dict[str, dict[str, float]]:
    """Cost of campaigns of so many members at depth model, in rising order: memory is the most so far."""
    found = {}
    with cluster("", 2) as client:
        first = Campaign.of(base, "uniform", 1, 1, "model", identity(base))
        (_, members), *_ = first.chunks()
        client.run(evaluate_chunk, portable(base, first.identity), members, "model")  # each worker prepares itself
        for count in sorted(counts):
            campaign = Campaign.of(base, "uniform", count, 1, "model", identity(base))
            before, own = client.run(usage), usage()
            with tempfile.TemporaryDirectory() as folder:
                results = ResultFolder(Path(folder) / "campaign")
                run_campaign(campaign, results, client, results.open(campaign, False))
            after, done = client.run(usage), usage()
            found[str(count)] = {
                "worker_cpu_s_per_member": sum(after[w][0] - before[w][0] for w in before) / count,
                "client_cpu_s_per_member": (done[0] - own[0]) / count,
                "client_mb": done[1],
                "worker_mb": max(memory for _, memory in after.values()),
            }
    return found


def hours(member: float, client: float, cores: int) -> float:
    """Hours of 1e6 members from the CPU seconds of a member and of the client for it."""
    return float(f"{1e6 / 3600 * max((member + client) / cores, client):.3g}")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--members", type=int, default=10)
    parser.add_argument("--duration", type=float, default=10.0, help="of the runs [s]")
    parser.add_argument("--workers", default="1,2", help="of the local cluster, separated by commas; empty for none")
    parser.add_argument("--counts", default="100", help="members of campaigns at depth model; empty for none")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    base = RunConfig(mode="inprocess", scenario="design", duration=arguments.duration)
    seconds = cost(base, arguments.members)
    workers, counts = ([int(n) for n in text.split(",") if n] for text in (arguments.workers, arguments.counts))
    grown = growth(base, counts) if counts else {}
    client = grown[str(max(counts))]["client_cpu_s_per_member"] if counts else 0.0
    result: dict[str, Any] = {
        "time_depth_ratio": seconds["recorded"] / seconds["time"],
        "time_depth_cpu_s": seconds["time"],
        "worst_case_cpu_s": time_cost(replace(base, scenario="worst_case"), arguments.members),
        "model_depth_per_s": 1.0 / seconds["model"],
        "scaling": {str(count): rate(base, 10 * arguments.members, count) for count in workers},
        "growth": grown,
        "hours_for_1e6": {
            depth: {str(n): hours(seconds[depth], client, n) for n in CORES} for depth in ("time", "model")
        },
    }
    print(json.dumps(result) if arguments.json else "\n".join(f"{k:20s} {v}" for k, v in result.items()))


if __name__ == "__main__":
    main()
