"""The 1 kHz loop of the testbed against the same cores on rclpy's executors, in one run.

    python benchmarks/real_time_loop.py --seconds 60 --hogs 2 --json
    python benchmarks/real_time_loop.py --seconds 60 --docs        # writes table and histogram into docs/real_time.md
    python benchmarks/real_time_loop.py --seconds 60 --fair        # the same scheduling for both

`ours` has real-time scheduling and three processes: plant, both laws, the testbed's recorder. `ours_separate` has four,
with a process for each law; `ours_ordinary` is `ours` without any rights, `ours_hogs` with busy processes beside it;
before and after, bare loops (benchmarks/bare_loop.py) show what the machine allows. `events_executor` and
`single_threaded` are benchmarks/executor_nodes.py: message objects, callbacks, a ROS timer.

Latency: from the plant's wake-up to the arrival of the mirror command of the same tick at the plant's middleware.
Lateness: from the deadline to the wake-up. A tick is missed if the plant had to hold an older command or lost a
period; the rate is that of all periods, run or lost. Durations above 20 ms share one cell: a quantile there is the
maximum.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
import textwrap
import time
from pathlib import Path
from typing import Any

from bare_loop import bare_loops, summed_shares
from los_testbed.config.run_config import RunConfig
from los_testbed.config.topics import NODES
from los_testbed.run.results import Results
from los_testbed.run.runner import Runner

HERE = Path(__file__).parent
DOCS = HERE.parent / "docs"
WIDTH = 118  # of lines in the documentation
LABELS = {
    "ours": "own clock, WaitSet, bytes, real-time scheduling",
    "ours_separate": "the same, a process for each law",
    "ours_hogs": "the same, with busy processes",
    "ours_ordinary": "the same, ordinary scheduling",
    "events_executor": "EventsExecutor, ROS timer, objects",
    "single_threaded": "SingleThreadedExecutor, ROS timer, objects",
    "events_real_time": "EventsExecutor, ROS timer, objects, real-time scheduling",
}
FAIR = ("ours", "events_real_time", "ours_ordinary", "events_executor")
"""Both loops with real-time scheduling, and both with ordinary scheduling."""
AS_IT_COMES = (f"FASTRTPS_DEFAULT_PROFILES_FILE={os.devnull}", "FASTDDS_BUILTIN_TRANSPORTS=DEFAULT")
"""The testbed sets its own discovery profile and transport only where the environment names none."""

TICKS_PER_S = os.sysconf("SC_CLK_TCK")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0, help="length of each run (default 60)")
    parser.add_argument("--hogs", type=int, default=2, help="busy processes of the run with load (default 2; 0: none)")
    parser.add_argument("--loops", nargs="+", choices=LABELS, default=list(LABELS)[:6], help="which to run")
    parser.add_argument("--fair", action="store_true", help="both loops with and without real-time scheduling")
    parser.add_argument("--domain", type=int, default=87, help="ROS domain (default 87)")
    parser.add_argument("--docs", action="store_true", help="write table and histogram into docs/real_time.md")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    args = parser.parse_args()
    if args.fair and args.docs:
        parser.error("expected one of --fair and --docs, got both")
    loops = list(FAIR) if args.fair else [name for name in args.loops if args.hogs or name != "ours_hogs"]
    load = os.getloadavg()[0]
    runs, bare = {}, {}
    for name in loops:
        before = bare_beside(name, args.hogs, args.seconds)
        runs[name] = fly(name, args.seconds, args.hogs, args.domain)
        bare[name] = before + bare_beside(name, args.hogs, args.seconds)
    result: dict[str, Any] = {name: figures(*run) for name, run in runs.items()}
    for name, found in bare.items():
        if found:
            result[name]["bare"] = summed_shares(found)
            result[name]["miss_rate_to_bare"] = result[name]["miss_rate"] / max(
                summed_shares(found)["late_300_us"], 1e-9
            )
    result["seconds"], result["hogs"] = args.seconds, args.hogs
    if "ours" in result:
        result["miss_rate"] = result["ours"]["miss_rate"]
        if "events_executor" in result:
            medians = [result[name]["latency_us"]["median"] for name in ("events_executor", "ours")]
            result["latency_ratio_events"] = medians[0] / medians[1]
    if "ours_hogs" in result:
        result["miss_rate_hogs"] = result["ours_hogs"]["miss_rate"]
    result["machine"] = {**machine(), "load_before": load}
    if args.docs:
        write_between(DOCS / "real_time.md", "real_time_loop", table(result))
        histogram({name: run[0].latency for name, run in runs.items()}, DOCS / "figures" / "real_time_latency.png")
    print(json.dumps(result) if args.json else table(result))


def write_between(page: Path, name: str, text: str) -> None:
    """Put `text` into a page between the marks of that name."""
    start, end = f"<!-- {name} -->\n", "<!-- end -->"
    head, _, rest = page.read_text("utf-8").partition(start)
    page.write_text(head + start + text + end + rest.partition(end)[2], "utf-8")


def bare_beside(name: str, hogs: int, seconds: float) -> list[list[dict[str, Any]]]:
    """Bare loops under the same load, a quarter as long, for the runs with real-time scheduling."""
    if name not in ("ours", "ours_separate", "ours_hogs"):
        return []
    busy = busy_processes(hogs if name == "ours_hogs" else 0)
    try:
        return [bare_loops(seconds / 4)]
    finally:
        end_processes(busy)


def busy_processes(count: int) -> list[subprocess.Popen[bytes]]:
    return [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]


def end_processes(busy: list[subprocess.Popen[bytes]]) -> None:
    for process in busy:
        process.kill()
        process.wait()


def fly(name: str, seconds: float, hogs: int, domain: int) -> tuple[Results, dict[str, float]]:
    """One run; what the nodes said, and the processor time of each process in per cent."""
    commands = {}
    if not name.startswith("ours"):
        kind = {"events_executor": "events", "events_real_time": "events-real-time"}.get(name, "single")
        script = str(HERE / "executor_nodes.py")
        commands = {
            node: ["env", *AS_IT_COMES, sys.executable, script, node, kind] for node in NODES if node != "recorder"
        }
    busy = busy_processes(hogs if "hogs" in name else 0)
    seen: list[tuple[float, dict[str, float]]] = []

    def progress(ticks: int) -> None:
        if ticks >= 500 and (not seen or time.monotonic() - seen[-1][0] > 0.9):
            pids: dict[int, str] = {}
            for node, pid in runner.processes.items():
                pids[pid] = f"{pids[pid]}+{node}" if pid in pids else node
            seen.append((time.monotonic(), {nodes: cpu_seconds(pid) for pid, nodes in pids.items()}))

    try:
        with tempfile.TemporaryDirectory(prefix="los_testbed_bench_") as folder:
            config = RunConfig(
                duration=seconds,
                output=f"{folder}/bag",
                domain=domain,
                wait_for_recorder=True,
                priority=name != "ours_ordinary",
                processes="separate" if name == "ours_separate" else "composed",
            )
            runner = Runner(config, progress, commands)
            results = runner.run()
    finally:
        end_processes(busy)
    (start_time, first), (ended, last) = seen[0], seen[-1]
    span = max(ended - start_time, 1e-9)
    return results, {node: round(100 * (last[node] - first[node]) / span, 1) for node in first}


def cpu_seconds(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS_PER_S


def figures(results: Results, cpu: dict[str, float]) -> dict[str, Any]:
    plant, recorder = results.statistics["plant"], results.statistics["recorder"]

    def quantiles(name: str) -> dict[str, float]:
        return {key: float(plant[f"{name}_{key}_us"]) for key in ("median", "p99", "p999", "max")}

    ticks, missed, skipped = (int(plant.get(name, "0")) for name in ("ticks", "missed_ticks", "skipped_periods"))
    return {
        "ticks": ticks,
        "missed_ticks": missed,
        "skipped_periods": skipped,
        "miss_rate": missed / (ticks + skipped),
        "latency_us": quantiles("latency"),
        "lateness_us": quantiles("lateness"),
        "execution_us": quantiles("execution"),
        "cpu_percent": cpu,
        "messages": int(recorder["messages"]),
        "messages_lost": int(recorder["samples_lost"]),
        "warnings": results.warnings + results.failures,
    }


def machine() -> dict[str, Any]:
    """What the figures depend on; nothing that tells whose machine it is."""
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    model = next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "unknown")
    virtual = any(line.startswith("flags") and " hypervisor" in line for line in lines)
    import importlib.metadata

    versions = {name: importlib.metadata.version(f"ros-jazzy-{name}") for name in ("rclpy", "rmw-fastrtps-cpp")}
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    kernel = platform.release().split("-")[0] + (" PREEMPT_RT" if "PREEMPT_RT" in platform.version() else "")
    return {
        "processor": model,
        "processors": len(os.sched_getaffinity(0)),
        "virtual": virtual,
        "memory_GiB": round(memory, 1),
        "kernel": f"{platform.system()} {kernel}",
        "python": platform.python_version(),
        **versions,
    }


def table(result: dict[str, Any]) -> str:
    """Markdown table."""
    rows = [
        "| loop | missed ticks | latency median / 99 % / 99.9 % / max [µs] | lateness median / 99.9 % / max [µs] "
        "| CPU of each process [%] | messages lost |",
        "|---|---|---|---|---|---|",
    ]
    for name, label in LABELS.items():
        if name not in result:
            continue
        run = result[name]
        latency, late, cpu = run["latency_us"], run["lateness_us"], run["cpu_percent"]
        rows.append(
            f"| {label} | {run['missed_ticks']} of {run['ticks'] + run['skipped_periods']} "
            f"({100 * run['miss_rate']:.3g} %) "
            f"| {latency['median']:.0f} / {latency['p99']:.0f} / {latency['p999']:.0f} / {latency['max']:.0f} "
            f"| {late['median']:.0f} / {late['p999']:.0f} / {late['max']:.0f} "
            f"| {', '.join(f'{node} {share:.0f}' for node, share in cpu.items())} "
            f"| {run['messages_lost']} of {run['messages']} |"
        )
    rows += ["", *bare_lines(result)] if any("bare" in result.get(name, {}) for name in LABELS) else []
    m = result["machine"]
    machine = (
        f"{result['seconds']:g} s each, recorder included; {result['hogs']} busy processes where there are any. "
        f"{m['processor']}{' (virtual machine)' if m['virtual'] else ''}, {m['processors']} processors, "
        f"{m['memory_GiB']} GiB, {m['kernel']}, Python {m['python']}, rclpy {m['rclpy']}, rmw_fastrtps_cpp "
        f"{m['rmw-fastrtps-cpp']}; load average before the first run {m['load_before']:.1f}."
    )
    return "\n".join([*rows, "", textwrap.fill(machine, WIDTH)]) + "\n"


def bare_lines(result: dict[str, Any]) -> list[str]:
    """Lateness of bare loops, one per processor, before and after the runs with real-time scheduling."""
    found = [
        f"- {LABELS[name]}: {100 * run['bare']['late_300_us']:.3g} % of the ticks of bare loops late by more than "
        f"0.3 ms, {100 * run['bare']['late_1000_us']:.3g} % by more than 1 ms, at most "
        f"{run['bare']['largest_us'] / 1000:.1f} ms"
        for name in LABELS
        if (run := result.get(name, {})).get("bare")
    ]
    return ["\n".join(textwrap.fill(line, WIDTH, subsequent_indent="  ") for line in found)]


def histogram(cells: dict[str, dict[int, int]], path: Path) -> None:
    """Share of ticks that took longer than so much, on logarithmic axes: the tail is what a loop is judged by."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    import numpy as np

    figure, axes = plt.subplots(1, 2, figsize=(10, 4.3), layout="constrained")
    edges = np.geomspace(50, 20_000, 90)
    for name, counts in cells.items():
        values, weights = np.array(list(counts)), np.array(list(counts.values()))
        axes[0].hist(values + 0.5, edges, weights=weights / weights.sum(), histtype="step", label=LABELS[name])
        order = np.argsort(values)
        left = 1 - np.cumsum(weights[order]) / weights.sum()
        axes[1].step(values[order] + 1, np.maximum(left, 0.5 / weights.sum()), where="post")
    for ax in axes:
        ax.set_xscale("log")
        ax.axvline(1000, color="0.7", zorder=0)
        ax.set_xlabel("wake-up of the plant to mirror command [µs]; grey: one period")
    axes[0].set_ylabel("share of ticks")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper left", ncols=3, fontsize=8)
    axes[1].set(yscale="log", ylabel="share of ticks that took longer", xlim=(50, 20_000))
    path.parent.mkdir(exist_ok=True)
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    main()
