"""The four designs of the paper's problem on its telescope: nominal and robust K_FSM and K_PMA (`make paper-designs`).

python examples/paper/designs.py [FOLDER] [--starts 8] [--seed 0] [--time-limit SECONDS] [--only nominal|robust]

The nominal designs are made as the paper makes them: K_FSM from the Kalman filter, K_PMA behind it from random starts.
So is the robust K_FSM; then it is tuned further together with K_PMA, on the goals of both: of the observers that have
the same largest figure it becomes one behind which K_PMA keeps 40 mas. A design that is interrupted goes on, and one
whose file is there with the same telescope and options is not made again (FOLDER, default: examples/paper/designs).
"""

import argparse
import json
import sys
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from lftkit import SampledSystem
from lftkit.support.threads import one_thread
from lftkit.tuning.structures.structures import gain_matrix_of
from los_design.figures.paper_case import FAMILY
from los_design.search.worst_case_search import Search
from los_design.synthesis.options import DesignOptions
from los_design.synthesis.provenance import digest
from los_design.synthesis.store import continuous
from los_design.synthesis.synthesis import QUICK, design_actuators, design_observer, design_pair
from los_loop.continuous_loop import ContinuousLoop, continuous_open_loop
from pointing_analysis.files.atomic_output import write_text
from titop_plant.interface import MIRROR_STAGES
from titop_plant.simulation.build import telescope
from titop_plant.telescope.parameters import load_parameters, parameters_hash

HERE = Path(__file__).parent
FILE = HERE / "telescope.toml"
COMMAND = "make paper-designs"
Kept = tuple[Path, dict[str, Any]]


class Designs:
    """The designs in a folder, made where they are missing."""

    def __init__(self, folder: Path, options: DesignOptions) -> None:
        self.folder, self.options = folder, options
        self.parameters, self.telescope = load_parameters(FILE), telescope(str(FILE))

    def made(self, name: str, make: Callable[[Kept], Any], key: dict[str, Any]) -> list[SampledSystem]:
        """What `make` designs, read where the files are there with this key."""
        key = {"telescope": parameters_hash(self.parameters), **key}
        paths = [self.folder / f"{part}.json" for part in name.split("+")]
        keys = self.folder / "build" / f"{paths[-1].stem}.key"
        if keys.exists() and all(path.exists() for path in paths) and json.loads(keys.read_text("utf-8")) == key:
            return [SampledSystem.from_file(path) for path in paths]
        rounds = keys.with_suffix(".rounds.json")
        systems = make((rounds, key))
        systems = list(systems) if isinstance(systems, tuple) else [systems]
        for path, system in zip(paths, systems, strict=True):
            replace(system, provenance={**system.provenance, "command": COMMAND}).to_file(path)
        write_text(keys, json.dumps(key))
        rounds.unlink(missing_ok=True)
        print(*(f"{path.name}: {system.provenance['status']}" for path, system in zip(paths, systems)), flush=True)
        return systems

    def nominal(self) -> None:
        """Both nominal designs, with their worst members over the family."""
        options = replace(self.options, nominal=True)
        key = {**asdict(options), "wall_limit": 0.0, "progress": False}

        def k_fsm(kept: Kept) -> SampledSystem:
            return design_observer(self.telescope, self.parameters, options, said("k_fsm_nominal"), kept)

        (observer,) = self.made("k_fsm_nominal", k_fsm, key)

        def k_pma(kept: Kept) -> SampledSystem:
            made = design_actuators(self.telescope, self.parameters, observer, options, said("k_pma_nominal"), kept)
            worst = [case for stage in MIRROR_STAGES for case in self.over_the_family(observer, made, stage)]
            return replace(made, provenance={**made.provenance, FAMILY: worst})

        self.made("k_pma_nominal", k_pma, {**key, "k_fsm": digest(observer)})

    def over_the_family(self, k_fsm: SampledSystem, k_pma: SampledSystem, stage: str) -> list[dict[str, Any]]:
        """Worst members of a stage with these controllers, for each figure."""
        matrices = [gain_matrix_of(continuous(system).at({})) for system in (k_fsm, k_pma)]
        loop = ContinuousLoop(continuous_open_loop(self.telescope, self.parameters), *matrices, stage)
        found = Search(loop, QUICK).run()
        return [
            {"requirement": name, "stage": stage, "value": p.gamma, "omega": p.omega, "parameters": dict(p.parameters)}
            for name, (p, *_) in found.items()
        ]

    def robust(self) -> None:
        """Both robust designs."""
        options = self.options
        key = {**asdict(options), "wall_limit": 0.0, "progress": False}

        def k_fsm(kept: Kept) -> SampledSystem:
            return design_observer(self.telescope, self.parameters, options, said("k_fsm"), kept)

        (first,) = self.made("k_fsm_alone", k_fsm, key)

        def pair(kept: Kept) -> tuple[SampledSystem, SampledSystem]:
            return design_pair(self.telescope, self.parameters, options, said("pair"), kept, observer=first)

        self.made("k_fsm+k_pma", pair, {**key, "k_fsm": digest(first)})


def said(name: str) -> Callable[[str], None]:
    """Reports of a design, with its name before them."""
    return lambda text: print(f"{name}: {text}", flush=True)


def main() -> int:
    """Make what is missing."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path, default=HERE / "designs")
    parser.add_argument("--starts", type=int, default=8)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--time-limit", type=float, default=3000.0, help="of each design [s]")
    parser.add_argument("--only", choices=("nominal", "robust"))
    given = parser.parse_args()
    (given.folder / "build").mkdir(parents=True, exist_ok=True)
    options = DesignOptions(loop_delay=0.0, starts=given.starts, seed=given.seed, wall_limit=given.time_limit)
    designs = Designs(given.folder, options)
    with one_thread():
        for name in ("nominal", "robust") if given.only is None else (given.only,):
            getattr(designs, name)()
    return 0


if __name__ == "__main__":
    sys.exit(main())
