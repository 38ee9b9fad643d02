"""The loop over two hosts (network namespaces): latency and missed ticks by the link between them.

    python benchmarks/two_host_loop.py [--seconds 20] [--docs] [--json]

Plant and recorder run on the first host, estimator and controller on the second. The links: none (one host), a veth
pair, and one that delays every packet by 0.2 ms, without losses and with one tick in a thousand lost each way.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import sys
import tempfile
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

from los_testbed.config.run_config import RunConfig
from los_testbed.run.runner import Runner
from real_time_loop import DOCS, write_between

from pointing_analysis.read.run import Run

SUPPORT = Path(__file__).parents[1] / "tests" / "support"


def links() -> dict[str, Callable[[], Any]]:
    """Links by name."""
    sys.path.insert(0, str(SUPPORT))
    hosts = import_module("two_hosts")
    return {
        "one host": contextlib.nullcontext,
        "two hosts": hosts.veth_pair,
        "two hosts, 0.2 ms each way": lambda: hosts.lossy_link(period=0),
        "two hosts, 0.2 ms each way, 0.1 % lost": lambda: hosts.lossy_link(period=1000),
    }


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--docs", action="store_true", help="write the table into docs/real_time.md")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    result = {name: measured(link, arguments.seconds) for name, link in links().items()}
    if arguments.docs:
        write_between(DOCS / "real_time.md", "two_hosts", table(result))
    print(json.dumps(result) if arguments.json else table(result))


def measured(link: Callable[[], Any], seconds: float) -> dict[str, float]:
    """One run over a link; its figures."""
    with tempfile.TemporaryDirectory(prefix="los_testbed_hosts_") as name, link() as hosts:
        folder = Path(name)
        config = RunConfig(duration=seconds, output=str(folder / "bag"), domain=88, wait_for_recorder=True)
        if hosts is None:
            Runner(config).run()
        else:
            hosts.run(config, folder)
            hosts.unplug()
        statistics = Run.open(folder / "bag").parameters["statistics"]
    plant = statistics["plant"]
    return {
        "ticks": int(plant["ticks"]),
        "missed_ticks": int(plant["missed_ticks"]),
        **{f"latency_{q}_us": float(plant[f"latency_{q}_us"]) for q in ("median", "p99", "p999")},
        "gap_ticks": int(statistics["estimator"]["gap_ticks"]),
        "packets_lost": 0 if hosts is None else hosts.lost,
    }


def table(result: dict[str, dict[str, float]]) -> str:
    """Markdown table."""
    lines = [
        "| link | missed ticks | latency median [us] | 99 % | 99.9 % | packets lost | ticks stepped over |",
        "|---|---:|---:|---:|---:|---:|---:|",
    ]
    for name, r in result.items():
        missed = f"{r['missed_ticks']} of {r['ticks']} ({100 * r['missed_ticks'] / r['ticks']:.2f} %)"
        times = " | ".join(f"{r[f'latency_{q}_us']:.0f}" for q in ("median", "p99", "p999"))
        lines.append(f"| {name} | {missed} | {times} | {r['packets_lost']} | {r['gap_ticks']} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
