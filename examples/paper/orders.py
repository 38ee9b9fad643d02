"""Order of the controllers against their gammas, on the nominal telescope of the paper (it says: several were tested).

python examples/paper/orders.py [FOLDER] [--orders 0,1,2,3,4,5,6,7,8] [--parameters FILE] [--time-limit SECONDS]

Both controllers of each order are designed on the paper's problem, K_PMA behind the K_FSM of order 4. FOLDER (default:
build/orders) has one file per order, orders.json beside this script the table of all that are there. A file that is
there with the same key, the telescope and all options, is not made again: interrupted, the same command goes on.
"""

import argparse
import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

from lftkit import SampledSystem
from lftkit.support.threads import one_thread
from los_design.synthesis.options import DesignOptions
from los_design.synthesis.provenance import digest
from los_design.synthesis.synthesis import design_actuators, design_observer
from pointing_analysis.files.atomic_output import atomic_file
from titop_plant.simulation.build import telescope
from titop_plant.telescope.parameters import load_parameters, parameters_hash

HERE = Path(__file__).parent
OBSERVER_ORDER, STARTS = 4, 8  # of the K_FSM behind which every K_PMA is designed; random starts of K_PMA
NAMES = {"k-fsm": "k_fsm", "k-pma": "k_pma"}


def options_of(order: int, limit: float) -> DesignOptions:
    """Those of the nominal design of the paper's problem."""
    return DesignOptions(nominal=True, loop_delay=0.0, order=order, starts=STARTS, wall_limit=limit)


def file_of(folder: Path, kind: str, order: int) -> Path:
    """File of a design."""
    return folder / f"{NAMES[kind]}_order_{order}.json"


def designed(
    folder: Path, kind: str, options: DesignOptions, file: Path, observer: SampledSystem | None
) -> SampledSystem:
    """The design of an order: that of the folder if its key is the same, else a new one."""
    parameters, path = load_parameters(file), file_of(folder, kind, options.order)
    key: dict[str, Any] = {"kind": kind, "telescope": parameters_hash(parameters), **asdict(options)}
    if observer is not None:
        key["k_fsm"] = digest(observer)
    keys = path.with_suffix(".key")
    if path.exists() and keys.exists() and json.loads(keys.read_text("utf-8")) == key:
        return SampledSystem.from_file(path)
    keys.unlink(missing_ok=True)
    assembled = telescope(str(file))
    with one_thread():
        if observer is None:
            system = design_observer(assembled, parameters, options)
        else:
            system = design_actuators(assembled, parameters, observer, options)
    system.to_file(path)
    write(keys, key)
    return system


def row_of(order: int, systems: dict[str, SampledSystem]) -> dict[str, Any]:
    """What the table says of an order: gammas, status and seconds of both controllers."""
    row: dict[str, Any] = {"order": order}
    for kind, system in systems.items():
        made = system.provenance
        row[kind] = {"gammas": made["tuned_values"], **{name: made[name] for name in ("status", "seconds")}}
    return row


def write(path: Path, content: Any) -> None:
    """A file, whole or not at all."""
    with atomic_file(path) as temporary:
        temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def main() -> int:
    """Design what is missing and write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path, default=Path("build/orders"))
    parser.add_argument("--orders", default="0,1,2,3,4,5,6,7,8")
    parser.add_argument("--parameters", type=Path, default=HERE / "telescope.toml")
    parser.add_argument("--time-limit", type=float, default=1800.0)
    parser.add_argument("--output", type=Path, default=HERE / "orders.json")
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    rows, limit = list[dict[str, Any]](), given.time_limit
    behind = designed(given.folder, "k-fsm", options_of(OBSERVER_ORDER, limit), given.parameters, None)
    for order in (int(text) for text in given.orders.split(",")):
        options = options_of(order, limit)
        systems = {
            "k-fsm": designed(given.folder, "k-fsm", options, given.parameters, None),
            "k-pma": designed(given.folder, "k-pma", options, given.parameters, behind),
        }
        rows = sorted([*rows, row_of(order, systems)], key=lambda row: row["order"])
        print(json.dumps(row_of(order, systems)), flush=True)
        telescope_hash = parameters_hash(load_parameters(given.parameters))
        write(given.output, {"parameters_hash": telescope_hash, "k_fsm_order": OBSERVER_ORDER, "orders": rows})
    return 0


if __name__ == "__main__":
    sys.exit(main())
