"""Missed ticks of the 1 kHz loop with and without images of the guide camera, in alternating pairs of runs.

    python benchmarks/image_camera.py --pairs 5 --seconds 60 --json

Each run is four processes with real-time scheduling, the recorder included. Both runs of a pair have the same model of
the camera in the loop (`magnitude` and `image` of docs/image_quality.md); which of them is first alternates. Ticks are
missed `as without images` if the interval of 95 % confidence of the mean difference of the pairs (Student) contains 0
or lies below it.

`cost` is what a frame costs the process of the plant, without any other load: its parts in µs, medians and 99 %.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from los_testbed.bags.cdr import codec_for
from los_testbed.config.run_config import RunConfig
from los_testbed.config.topics import image_topic
from los_testbed.parts.image_camera import image_camera_of
from los_testbed.parts.run_parts import RunParts
from los_testbed.run.loop.compiled_loop import compile_telescope
from los_testbed.run.runner import Runner
from real_time_loop import cpu_seconds, figures, machine
from scipy import stats

from lftkit.support.threads import one_thread
from titop_plant.interface import TRUTH

KINDS = ("magnitude", "image")
COST_TICKS = 4000


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", type=int, default=5, help="pairs of runs (default 5)")
    parser.add_argument("--seconds", type=float, default=60.0, help="length of each run (default 60)")
    parser.add_argument("--domain", type=int, default=88, help="ROS domain (default 88)")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    args = parser.parse_args()
    load = os.getloadavg()[0]
    with tempfile.TemporaryDirectory(prefix="los_testbed_bench_") as name:
        folder = Path(name)
        files = {kind: parameter_file(folder, kind) for kind in KINDS}
        cost = costs(files["image"])
        pairs = []
        for number in range(args.pairs):
            order = KINDS if number % 2 == 0 else KINDS[::-1]
            runs = {kind: fly(files[kind], folder / f"{number}-{kind}", args.seconds, args.domain) for kind in order}
            pairs.append({"first": order[0], **runs})
            print(f"pair {number + 1}: {missed(pairs[-1])} ticks missed", file=sys.stderr)
    result = {
        "seconds": args.seconds,
        **comparison(pairs),
        "cost": cost,
        "pairs": pairs,
        "machine": {**machine(), "load_before": load},
    }
    print(json.dumps(result) if args.json else table(result))


def parameter_file(folder: Path, kind: str) -> str:
    file = folder / f"{kind}.toml"
    file.write_text(f'base = "reference"\n[sensors]\ncamera = "{kind}"\n', "utf-8")
    return str(file)


def fly(parameters: str, bag: Path, seconds: float, domain: int) -> dict[str, Any]:
    """Figures of one run."""
    seen: list[tuple[float, dict[str, float]]] = []

    def progress(ticks: int) -> None:
        if ticks >= 500 and (not seen or time.monotonic() - seen[-1][0] > 0.9):
            seen.append((time.monotonic(), {n: cpu_seconds(pid) for n, pid in runner.processes.items()}))

    config = RunConfig(
        duration=seconds, output=str(bag), domain=domain, wait_for_recorder=True, parameters=parameters, priority=True
    )
    runner = Runner(config, progress)
    results = runner.run()
    (start, first), (ended, last) = seen[0], seen[-1]
    cpu = {node: round(100 * (last[node] - first[node]) / max(ended - start, 1e-9), 1) for node in first}
    frames = {k: int(v) for k, v in results.statistics["plant"].items() if k.startswith("frames")}
    return {**figures(results, cpu), "frames": frames}


def missed(pair: dict[str, Any]) -> str:
    return ", ".join(f"{kind} {pair[kind]['missed_ticks']}" for kind in KINDS)


def comparison(pairs: list[dict[str, Any]]) -> dict[str, Any]:
    """Missed ticks per million of both kinds, and whether they differ beyond the noise of the pairs."""
    rates = np.array([[1e6 * pair[kind]["miss_rate"] for kind in KINDS] for pair in pairs])
    found: dict[str, Any] = {f"missed_ppm_{kind}": rates[:, i].mean().round(2) for i, kind in enumerate(KINDS)}
    differences = rates[:, 1] - rates[:, 0]
    found["difference_ppm"] = differences.mean().round(2)
    if len(pairs) > 1:
        half = stats.t.ppf(0.975, len(pairs) - 1) * differences.std(ddof=1) / np.sqrt(len(pairs))
        found["half_width_ppm"] = round(float(half), 2)
        found["as_without_images"] = bool(differences.mean() <= half)
    return found


def costs(parameters: str) -> dict[str, dict[str, float]]:
    """Time of the parts of a frame in the process of the plant [µs]."""
    with one_thread():
        parts = RunParts(RunConfig(parameters=parameters, duration=COST_TICKS / 1000))
        plant = parts.plant()
        camera = image_camera_of(plant)
        assert camera is not None
        compile_telescope(plant, COST_TICKS)
        u, y, truth = np.zeros(parts.ports.commands), np.zeros(parts.ports.measurements), np.zeros(TRUTH)
        steps, works = np.zeros(COST_TICKS), np.zeros(COST_TICKS)
        for k in range(COST_TICKS):
            steps[k] = spent(lambda: plant.step(u, y, truth))
            works[k] = spent(camera.work)
    period, delay = plant.frame_ticks, round(1000 * camera.camera.camera.readout_delay)
    codec, pixels = codec_for(image_topic(camera.camera.camera.window)), camera.image.ravel()
    after = slice(2 * period, None)
    by_phase = {
        "tick_without_frame": steps[after].reshape(-1, period)[:, 2],
        "tick_at_end_of_exposure": steps[after].reshape(-1, period)[:, -delay % period],
        "tick_with_angles": steps[after].reshape(-1, period)[:, 0],
        "frame_between_ticks": works[after].reshape(-1, period)[:, -delay % period],
        "centroid_between_ticks": works[after].reshape(-1, period)[:, (1 - delay) % period],
        "message": np.array([spent(lambda: codec.encode(1, pixels)) for _ in range(200)]),
    }
    return {
        name: {"median": float(np.median(values).round(1)), "p99": float(np.quantile(values, 0.99).round(1))}
        for name, values in by_phase.items()
    }


def spent(call: Callable[[], object]) -> float:
    """[µs]."""
    begin = time.perf_counter_ns()
    call()
    return (time.perf_counter_ns() - begin) / 1000


def table(result: dict[str, Any]) -> str:
    """Markdown."""
    rows = [
        "| pair | camera | missed ticks | latency median / 99.9 % / max [µs] | CPU plant/est./ctl./rec. [%] |",
        "|---|---|---|---|---|",
    ]
    for number, pair in enumerate(result["pairs"], 1):
        for kind in KINDS:
            run, late = pair[kind], pair[kind]["latency_us"]
            rows.append(
                f"| {number} | {kind} | {run['missed_ticks']} of {run['ticks'] + run['skipped_periods']} "
                f"| {late['median']:.0f} / {late['p999']:.0f} / {late['max']:.0f} "
                f"| {'/'.join(f'{share:.0f}' for share in run['cpu_percent'].values())} |"
            )
    parts = (f"{name} {value['median']:g} ({value['p99']:g})" for name, value in result["cost"].items())
    shown = {key: value for key, value in result.items() if key not in ("pairs", "cost", "machine")}
    return "\n".join([*rows, "", f"[µs], median (99 %): {', '.join(parts)}", json.dumps(shown)])


if __name__ == "__main__":
    main()
