"""How far the shipped designs are from any linear controller: one JSON object.

    python benchmarks/design_gap.py [--designs reference;small_telescope]

For each design, stage and error the largest figure of merit of the nominal telescope over what is tuned for (tones of
the disturbances, sensor noise), the lower bound of it for linear controllers of any order
(:class:`los_design.synthesis.unreachable.StageBounds`), and the figures that the bound weighs. The bound has neither
the authorities nor the sensitivities nor the uncertain parameters, which the designs keep, too.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from lftkit import SampledSystem
from lftkit.synthesis.shared_h2 import shared_bound
from los_design.synthesis.store import load_designs
from los_design.synthesis.unreachable import NOTED, StageBounds
from los_design.verification.verification import ImplementedCheck, check_implemented
from los_loop.figures_of_merit import figures
from los_loop.open_loop import OpenLoop
from titop_plant.telescope.control_plant import loop_plant
from titop_plant.telescope.load import load_telescope
from titop_plant.telescope.telescope import Telescope

Pair = tuple[SampledSystem, SampledSystem]
EXAMPLES = Path(__file__).parents[1] / "examples" / "spacecraft"
SHIPPED = {"reference": "implemented", "reference, nominal": "implemented_nominal"}
DESIGNS = (*SHIPPED, "small_telescope", "earth_observer")


def design(name: str) -> tuple[Telescope, Pair]:
    """Telescope and controllers."""
    if name in SHIPPED:
        return load_telescope(), load_designs(SHIPPED[name])
    k_fsm, k_pma = (SampledSystem.from_file(EXAMPLES / name / f"{kind}.json") for kind in ("k_fsm", "k_pma"))
    return load_telescope(EXAMPLES / f"{name}.toml"), (k_fsm, k_pma)


def reached(check: ImplementedCheck, telescope: Telescope, stage: str, relative: bool) -> dict[str, float]:
    """Figures of a design over what is tuned for."""
    found = {}
    for row in figures(stage):
        if row.relative == relative and (row.is_noise or row.is_error):
            value = check.noise[stage][relative].rms if row.is_noise else check.gamma(stage, row.name)
            unit = 1.0 if row.is_noise else row.limit(telescope, stage)
            found[row.name] = float(value * unit / row.tuned_for(telescope, stage))
    return found


def measured(name: str) -> list[dict[str, Any]]:
    """Rows of a design."""
    telescope, pair = design(name)
    ports = telescope.loop_ports
    open_loop = OpenLoop(loop_plant(telescope, ports), telescope, ports)
    system = loop_plant(telescope, ports.used_by(*pair))
    check, rows = check_implemented(system, telescope, *pair, [{}], changes=False), []
    for stage in telescope.mirror_stages:
        for relative in (True, False):
            start, bounds = time.process_time(), StageBounds(open_loop, stage, relative)
            plant, tones = bounds.plant_with_noises()
            bound, values = shared_bound(plant), reached(check, telescope, stage, relative)
            rows.append(
                {
                    "design": name,
                    "stage": stage,
                    "error": bounds.error,
                    "figures": {figure: round(value, 4) for figure, value in values.items()},
                    "largest": max(values.values()),
                    "bound": bound.value,
                    "tones_rad_s": [round(float(w), 2) for w in tones[bound.weights[: len(tones)] > NOTED]],
                    "noise_weight": round(float(bound.weights[len(tones) :].sum()), 3),
                    "cpu_seconds": round(time.process_time() - start, 2),
                }
            )
    return rows


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--designs", default=";".join(DESIGNS), help="names, separated by semicolons")
    names = parser.parse_args().designs.split(";")
    if unknown := sorted(set(names) - set(DESIGNS)):
        parser.error(f"--designs must be among {'; '.join(DESIGNS)}, got {'; '.join(unknown)}")
    print(json.dumps({"rows": [row for name in names for row in measured(name)]}))


if __name__ == "__main__":
    main()
