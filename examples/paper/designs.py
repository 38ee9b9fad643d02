"""The four designs of the paper's problem on its telescope: nominal and robust K_FSM and K_PMA (`make paper-designs`).

python examples/paper/designs.py [FOLDER] [--starts 8] [--seed 0] [--time-limit SECONDS] [--workers N]
    [--only nominal|robust]

The nominal designs are made as the paper makes them: K_FSM from the Kalman filter, K_PMA behind it from random starts.
So is the robust K_FSM; then it is tuned further together with K_PMA, on the goals of both: of the observers that have
the same largest figure it becomes one with which K_PMA meets 40 mas. A design that is interrupted continues, and one
whose file is there with the same telescope and options is not made again (FOLDER, default: examples/paper/designs).
"""

import argparse
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from paper_case import FAMILY

from lftkit import SampledSystem
from lftkit.support.job import Job
from lftkit.support.threads import one_thread
from lftkit.tuning.structures.structures import gain_matrix_of
from los_design.search.worst_case_search import Search
from los_design.synthesis.design_folder import DesignFolder
from los_design.synthesis.options import DesignOptions
from los_design.synthesis.store import continuous
from los_design.synthesis.synthesis import QUICK, design_actuators, design_observer, design_pair
from los_loop.continuous_loop import ContinuousLoop, continuous_open_loop
from titop_plant.interface import MIRROR_STAGES
from titop_plant.telescope.load import load_telescope

HERE = Path(__file__).parent
FILE = HERE / "telescope.toml"
COMMAND = "make paper-designs"


class Designs:
    """The designs in a folder, made where they are missing."""

    def __init__(self, folder: Path, options: DesignOptions) -> None:
        self.options = options
        self.telescope = load_telescope(FILE)
        self.designs = DesignFolder(folder, self.telescope.parameters_hash, COMMAND, said())

    def nominal(self) -> None:
        """Both nominal designs, with their worst members over the family."""
        options = replace(self.options, nominal=True)

        def k_fsm(job: Job) -> list[SampledSystem]:
            return [design_observer(self.telescope, options, said("k_fsm_nominal"), job)]

        (observer,) = self.designs.made(["k_fsm_nominal"], k_fsm, options)

        def k_pma(job: Job) -> list[SampledSystem]:
            made = design_actuators(self.telescope, observer, options, said("k_pma_nominal"), job)
            worst = [case for stage in MIRROR_STAGES for case in self.over_the_family(observer, made, stage)]
            return [replace(made, provenance={**made.provenance, FAMILY: worst})]

        self.designs.made(["k_pma_nominal"], k_pma, options, {"k_fsm": observer})

    def over_the_family(self, k_fsm: SampledSystem, k_pma: SampledSystem, stage: str) -> list[dict[str, Any]]:
        """Worst members of a stage with these controllers, for each figure."""
        first, second = (gain_matrix_of(continuous(system).at({})) for system in (k_fsm, k_pma))
        loop = ContinuousLoop(continuous_open_loop(self.telescope), first, second, stage)
        found = Search(loop, QUICK).run()
        return [
            {"requirement": name, "stage": stage, "value": p.gamma, "omega": p.omega, "parameters": dict(p.parameters)}
            for name, (p, *_) in found.items()
        ]

    def robust(self) -> None:
        """Both robust designs."""
        options = self.options

        def k_fsm(job: Job) -> list[SampledSystem]:
            return [design_observer(self.telescope, options, said("k_fsm"), job)]

        (first,) = self.designs.made(["k_fsm_alone"], k_fsm, options)

        def pair(job: Job) -> tuple[SampledSystem, SampledSystem]:
            return design_pair(self.telescope, options, said("pair"), job, observer=first)

        self.designs.made(["k_fsm", "k_pma"], pair, options, {"k_fsm": first})


def said(name: str = "") -> Callable[[str], None]:
    """Reports of a design, with its name before them."""
    return lambda text: print(f"{name}: {text}" if name else text, flush=True)


def main() -> int:
    """Make what is missing."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path, default=HERE / "designs")
    parser.add_argument("--starts", type=int, default=8)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--time-limit", type=float, default=20000.0, help="of each design [s]")
    parser.add_argument("--workers", type=int, default=1, help="processes; the designs do not depend on them")
    parser.add_argument("--only", choices=("nominal", "robust"))
    args = parser.parse_args()
    options = DesignOptions(
        loop_delay=0.0, starts=args.starts, seed=args.seed, wall_limit=args.time_limit, workers=args.workers
    )
    designs = Designs(args.folder, options)
    with one_thread():
        for name in ("nominal", "robust") if args.only is None else (args.only,):
            getattr(designs, name)()
    return 0


if __name__ == "__main__":
    sys.exit(main())
