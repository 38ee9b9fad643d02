"""What lost ticks cost: the largest change of the line of sight after a gap, for each choice of `--lost-samples`.

    python benchmarks/lost_ticks.py --docs

The loop of the telescope in one process, at the worst member of a stage. For the ticks of a gap the plant goes on with
the command that it has and no sample is sent; then observer and law step over the gap as their nodes do. The change is
that from the same run without a gap: the largest one over phases of the tone and seeds of the noise. `--docs` writes
the table of docs/real_time.md.
"""

from __future__ import annotations

import argparse
import itertools
import json
import sys
from pathlib import Path

import numpy as np
from los_testbed.config.members import worst_member
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.run_parts import RunParts

from lftkit.arrays import FloatArray
from pointing_analysis.replay.gap_stepping import FILLS, LINE, GapStepper
from pointing_analysis.units import RAD_PER_ARCSEC
from titop_plant.interface import DT, ESTIMATES, PLATFORM, TRUTH

CASES = (("fsm", "RPE"), ("fsm+pma", "RPE"), ("fsm+pma", "slow"))
GAPS = 1, 2, 4, 8, 12, 20, 40
FIRST, AFTER = 1000, 1000
"""Tick of the first gap, and ticks that are watched behind it."""
PHASES = 0, 5, 11
ROOT = Path(__file__).parents[1]


def line_of_sight(parts: RunParts, first: int, gap: int, fill: str = LINE) -> FloatArray:
    """True line of sight [rad], shape (ticks, 2), of a run that loses `gap` ticks from tick `first` on."""
    plant, estimator, controller = parts.plant(), parts.estimator(), parts.controller()
    ports = parts.ports
    estimator.reset()
    controller.reset()
    observe = GapStepper(estimator.step, ports.measurements, ports.held, fill)
    size = ESTIMATES + PLATFORM.stop - PLATFORM.start
    control = GapStepper(lambda x, out: controller.step(x[:ESTIMATES], x[ESTIMATES:], out), size, fill=fill)
    command, estimate, new = np.zeros(ports.commands), np.zeros(ESTIMATES), np.zeros(ports.commands)
    if parts.start.command is not None:
        command[:] = parts.start.command
    measurement, seen = np.zeros(ports.measurements), np.zeros((FIRST + AFTER, TRUTH))
    missing = 0
    for k in range(len(seen)):
        plant.step(command, measurement, seen[k])
        if first <= k < first + gap:
            missing += 1
            continue
        observe(measurement, missing, estimate)
        control(np.concatenate([estimate, measurement[PLATFORM]]), missing, new)
        command[:], missing = new, 0
    return seen


def measure(seeds: int) -> list[dict[str, object]]:
    """One entry for each stage and tone, with its cost [arcsec] by choice and length of the gap."""
    found: list[dict[str, object]] = []
    for loop, worst_of in CASES:
        settings = {"duration": (FIRST + AFTER) * DT, **worst_member(loop, worst_of)}
        runs = [RunParts(RunConfig.from_mapping({**settings, "seed": seed})) for seed in range(1, seeds + 1)]
        whole = [line_of_sight(parts, 0, 0) for parts in runs]
        cost: dict[str, list[float]] = {fill: [] for fill in FILLS}
        for fill, gap in itertools.product(FILLS, GAPS):
            changes = [
                np.abs(line_of_sight(parts, FIRST + phase, gap, fill) - without).max()
                for (parts, without), phase in itertools.product(zip(runs, whole), PHASES)
            ]
            cost[fill].append(round(float(max(changes)) / RAD_PER_ARCSEC, 3))
        found.append({"loop": loop, "worst_of": worst_of, "gaps": list(GAPS), "arcsec": cost})
    return found


def table(found: list[dict[str, object]]) -> str:
    """Markdown, arcsec."""
    rows = [
        f"| largest change [arcsec] | {' | '.join(f'{gap} lost' for gap in GAPS)} |",
        "|---" * (len(GAPS) + 1) + "|",
    ]
    for case in found:
        cost = case["arcsec"]
        assert isinstance(cost, dict)
        tone = {"RPE": "fast tone", "slow": "slow tone"}[str(case["worst_of"])]
        rows += [
            f"| {case['loop']}, {tone}, `{fill}` | {' | '.join(f'{x:.3g}' for x in values)} |"
            for fill, values in cost.items()
        ]
    return "\n".join(rows)


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=2, help="runs with other noise")
    parser.add_argument("--docs", action="store_true", help="write the table of docs/real_time.md")
    given = parser.parse_args()
    found = measure(given.seeds)
    if given.docs:
        page = ROOT / "docs" / "real_time.md"
        before, begin, rest = page.read_text("utf-8").partition("<!-- lost_ticks -->\n")
        _, end, after = rest.partition("<!-- end -->")
        page.write_text(f"{before}{begin}{table(found)}\n{end}{after}", "utf-8")
    sys.stdout.write(f"{table(found)}\n{json.dumps(found)}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
