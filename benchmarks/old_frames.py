"""What late and lost camera frames cost: RPE of the loop over delay and loss, for each choice of `--old-frames`.

    python benchmarks/old_frames.py --seconds 15 --docs

The loop of the telescope (fsm+pma, the scenario's tones, noise) in one process; frames reach the observer through the
code that the estimator node has for them. `--docs` writes the table of docs/real_time.md and its picture.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import numpy as np
from los_testbed.config.run_config import OLD_FRAMES, RunConfig
from los_testbed.parts.run_parts import RunParts
from los_testbed.run.loop.slow_sensor import SlowSensor

from pointing_analysis.indices.metrics import windows
from pointing_analysis.units import RAD_PER_MAS
from titop_plant.interface import (
    CAMERA,
    DT,
    ESTIMATES,
    FSM_ANGLE,
    PLATFORM,
    TICK_NS,
    TRUTH,
)

DELAYS_MS = 0, 5, 10, 20, 40
LOSSES = 0.0, 0.1, 0.25, 0.5
ROOT = Path(__file__).parents[1]


def rpe(parts: RunParts, ticks: int, delay: int, loss: float, old: str) -> float:
    """Rms RPE of windows of 20 ms [mas], both axes, of a run whose frames come `delay` ticks late or not at all."""
    plant, estimator, controller = parts.plant(), parts.estimator(), parts.controller()
    for part in (plant, estimator, controller):
        part.reset()
    every, ports = plant.frame_ticks, parts.ports
    camera = SlowSensor("camera/los", CAMERA, every * TICK_NS, 0, old, FSM_ANGLE, parts.basis.los_sensitivity or 0.0)
    rng = np.random.default_rng(1)
    command, los = np.zeros(ports.commands), np.zeros(ESTIMATES)
    if parts.start.command is not None:
        command[:] = parts.start.command
    measurement, seen = np.zeros((ticks, ports.measurements)), np.zeros((ticks, TRUTH))
    pending: dict[int, tuple[int, np.ndarray]] = {}
    first = every * 50  # stamps begin above zero
    for k in range(ticks):
        row = measurement[k]
        plant.step(command, row, seen[k])
        given = row.copy()
        if k % every == 0 and k:
            lost = rng.random() < loss
            if delay and not lost:
                pending[k + delay] = k, row[CAMERA].copy()
            if delay or lost:
                given[CAMERA] = np.nan
        if k in pending:
            acquired, values = pending.pop(k)
            stamp, now = (first + acquired) * TICK_NS, (first + k) * TICK_NS
            if camera.note(stamp, stamp, now, now):
                camera.offer(stamp, values, (first + k - 1) * TICK_NS)
            camera.place(given, now, lambda tick: measurement[tick // TICK_NS - first])
        estimator.step(given, los)
        controller.step(los, given[PLATFORM], command)
    found = windows(seen[ticks // 3 :], DT, 0.02).rpe_rms
    return float(np.hypot(*found)) / RAD_PER_MAS


def measure(seconds: float) -> dict[str, object]:
    """Every case: RPE over delay for each choice, and over loss."""
    parts = RunParts(RunConfig(mode="inprocess"))
    ticks = round(seconds / DT)
    delays: dict[str, list[float | None]] = {}
    for old in OLD_FRAMES:
        apart = DELAYS_MS[:2] if old == "drop" else DELAYS_MS  # what is not used may come as late as it likes
        values = [rpe(parts, ticks, delay, 0.0, old) for delay in apart]
        delays[old] = [*values, *[None] * (len(DELAYS_MS) - len(values))]
    return {"seconds": seconds, "delays": delays, "losses": [rpe(parts, ticks, 0, loss, "correct") for loss in LOSSES]}


def table(result: dict[str, object]) -> str:
    """Markdown of the results."""
    delays = result["delays"]
    assert isinstance(delays, dict)
    head = "| RPE rms, 20 ms [mas] | " + " | ".join(f"{delay} ms late" for delay in DELAYS_MS) + " |"
    rows = [
        f"| `{old}` | " + " | ".join("as at 5 ms" if x is None else f"{x:.3g}" for x in values) + " |"
        for old, values in delays.items()
    ]
    losses = result["losses"]
    assert isinstance(losses, list)
    lost = ", ".join(f"{100 * share:g} %: {x:.3g} mas" for share, x in zip(LOSSES, losses))
    return "\n".join([head, "|---" * (len(DELAYS_MS) + 1) + "|", *rows, "", f"Frames lost, none late: {lost}."])


def picture(result: dict[str, object], path: Path) -> None:
    """RPE over delay and over loss."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, (left, right) = pyplot.subplots(1, 2, figsize=(8, 3), sharey=True, layout="constrained")
    delays, losses = result["delays"], result["losses"]
    assert isinstance(delays, dict) and isinstance(losses, list)
    for old, values in delays.items():
        left.plot(DELAYS_MS, [values[1] if x is None else x for x in values], "o-", label=old)
    left.set(xlabel="delay of the frames [ms]", ylabel="RPE rms, 20 ms [mas]")
    left.legend(title="--old-frames")
    right.plot([100 * share for share in LOSSES], losses, "o-")
    right.set(xlabel="frames lost [%]")
    for axes in (left, right):
        axes.grid(alpha=0.3)
    figure.savefig(path, dpi=120)


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=15.0, help="length of each run [s]")
    parser.add_argument("--docs", action="store_true", help="write the table and the picture of docs/real_time.md")
    given = parser.parse_args()
    result = measure(given.seconds)
    if given.docs:
        page = ROOT / "docs" / "real_time.md"
        text = page.read_text("utf-8")
        before, _, rest = text.partition("<!-- old_frames -->\n")
        _, end, after = rest.partition("<!-- end -->")
        page.write_text(f"{before}<!-- old_frames -->\n{table(result)}\n{end}{after}", "utf-8")
        picture(result, ROOT / "docs" / "figures" / "old_frames.png")
    sys.stdout.write(f"{table(result)}\n{json.dumps(result)}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
