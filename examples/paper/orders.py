"""Order of the controllers against their gammas, on the nominal telescope of the paper (it says: several were tested).

python examples/paper/orders.py [FOLDER] [--orders 0,1,2,3,4,5,6,7,8] [--parameters FILE] [--time-limit SECONDS]

Both controllers of each order are designed on the paper's problem, K_PMA behind the K_FSM of order 4. A controller of
lower order is one of each higher order: a design that ends worse than that of the order below is made again from it,
and the better of the two counts. FOLDER (default: build/orders) has their files, orders.json beside this script is the
table. A file that is there with the same telescope and options is not made again: interrupted, the same command goes
on.
"""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from lftkit import SampledSystem
from lftkit.support.atomic_output import write_text
from lftkit.support.job import Job
from lftkit.support.threads import one_thread
from los_design.synthesis.design_folder import DesignFolder
from los_design.synthesis.options import DesignOptions
from los_design.synthesis.synthesis import design_actuators, design_observer
from titop_plant.telescope.load import load_telescope

HERE = Path(__file__).parent
OBSERVER_ORDER, STARTS = 4, 8  # of the K_FSM behind which every K_PMA is designed; random starts of K_PMA
SOFT = {"k-fsm": ("APE", "RPE"), "k-pma": ("APE", "RPE", "noise -> APE")}  # the largest of these is minimised
WORSE = 1e-4  # part by which a design must be worse than that of the order below to be made again


class Orders:
    """Nominal designs of several orders, made where they are missing."""

    def __init__(self, folder: Path, file: Path, limit: float) -> None:
        self.telescope, self.limit = load_telescope(file), limit
        self.telescope_hash = self.telescope.parameters_hash
        self.designs = DesignFolder(folder, self.telescope_hash, "examples/paper/orders.py")

    def all(self, kind: str, orders: list[int], observer: SampledSystem | None = None) -> dict[int, SampledSystem]:
        """The best design of each order; `observer` is the K_FSM before K_PMA."""
        found: dict[int, SampledSystem] = {}
        lower: SampledSystem | None = None
        for order in sorted(orders):
            best = self.made(kind, order, observer)
            if lower is not None and largest(kind, best) > (1.0 + WORSE) * largest(kind, lower):
                best = min(best, self.made(kind, order, observer, lower), key=lambda system: largest(kind, system))
            lower = found[order] = best
            print(kind, json.dumps(row_of(order, {kind: best})), flush=True)
        return found

    def made(
        self, kind: str, order: int, observer: SampledSystem | None, start: SampledSystem | None = None
    ) -> SampledSystem:
        """The design of an order from its own starts, or from a given one."""
        options = DesignOptions(nominal=True, loop_delay=0.0, order=order, starts=STARTS, wall_limit=self.limit)
        name = f"{kind.replace('-', '_')}_order_{order}" + ("" if start is None else "_from_lower")

        def report(text: str) -> None:
            print(f"{name}: {text}", flush=True)

        def make(job: Job) -> list[SampledSystem]:
            if observer is None:
                return [design_observer(self.telescope, options, report, job, start)]
            return [design_actuators(self.telescope, observer, options, report, job, start)]

        given = {"k_fsm": observer, "start": start}
        return self.designs.made([name], make, options, {key: one for key, one in given.items() if one is not None})[0]


def largest(kind: str, system: SampledSystem) -> float:
    """What a design minimises."""
    return max(float(system.provenance["tuned_values"][name]) for name in SOFT[kind])


def row_of(order: int, systems: dict[str, SampledSystem]) -> dict[str, Any]:
    """What the table says of an order: gammas, status and seconds of both controllers."""
    row: dict[str, Any] = {"order": order}
    for kind, system in systems.items():
        made = system.provenance
        row[kind] = {"gammas": made["tuned_values"], **{name: made[name] for name in ("status", "seconds")}}
    return row


def main() -> int:
    """Design what is missing and write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path, default=Path("build/orders"))
    parser.add_argument("--orders", default="0,1,2,3,4,5,6,7,8")
    parser.add_argument("--parameters", type=Path, default=HERE / "telescope.toml")
    parser.add_argument("--time-limit", type=float, default=1800.0)
    parser.add_argument("--output", type=Path, default=HERE / "orders.json")
    given = parser.parse_args()
    asked = [int(text) for text in given.orders.split(",")]
    made = Orders(given.folder, given.telescope, given.time_limit)
    with one_thread():
        k_fsm = made.all("k-fsm", asked)
        behind = k_fsm[OBSERVER_ORDER] if OBSERVER_ORDER in k_fsm else made.made("k-fsm", OBSERVER_ORDER, None)
        k_pma = made.all("k-pma", asked, behind)
    rows = [row_of(order, {"k-fsm": k_fsm[order], "k-pma": k_pma[order]}) for order in sorted(k_fsm)]
    table = {"parameters_hash": made.telescope_hash, "k_fsm_order": OBSERVER_ORDER, "orders": rows}
    write_text(given.output, json.dumps(table, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
