"""The tuner beside three nonsmooth optimisers on the published plants, same wall time, one core each.

    python benchmarks/tuning.py [--plants AC3,REA1] [--orders 0,1,2] [--seconds 60] [--json] [--table] [--cpu]
                                [--rows FILE] [--methods ours]

- ``bfgs``: :mod:`lftkit.benchmarks.bfgs`, apart from the tuner.
- ``sampling``: gradient sampling (:mod:`gradient_sampling`) on the same function, from the same random starts.
- ``other``: PyGRANSO (Curtis, Mitchell and Overton 2017; ``pip install pygranso torch osqp gurobipy slycot``; AGPL, so
  no dependency of the project) on the same function, from the same random starts; null where it is not installed.

Beside the plants of the library stand those of COMPleib that the package gym-lqr has whole (``pip install --no-deps
gym-lqr``; Apache-2.0), where it is installed; published values of those are not known here.

The tuner runs with its default options and the wall limit `--seconds`. The others get the wall time that it took or,
with ``--rival-time limit``, the whole limit. All values are certified upper bounds at the controllers that were found:
with large gains the norms that the others minimise can miss a peak. A loss is a value of the tuner
that is more than 0.1 % (and 1e-6) above the smaller one of the others.

With ``--cpu`` all limits and times are processor seconds of this process: on a machine that does other work, too, every
method then gets the same amount of computation. With ``--rows FILE`` every row is written there as soon as it is
measured, one JSON object a line (the last one of a plant and order counts), and what the file has is not measured
again; ``--methods`` says which methods to measure in this run, so that the tuner may run first.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import time
from collections.abc import Callable, Collection, Sequence
from functools import cache, partial
from itertools import product
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from gradient_sampling import by_sampling
from threadpoolctl import threadpool_limits

from lftkit.benchmarks.bfgs import Function, by_bfgs, restarted
from lftkit.benchmarks.norms import ab13dd
from lftkit.benchmarks.tuning import finite, tuned
from lftkit.systems.system import System
from lftkit.tuning.published_plants import BEST_KNOWN, PLANTS, CompleibPlant

try:
    import torch
    from pygranso.pygranso import pygranso
    from pygranso.pygransoStruct import pygransoStruct
except ImportError:
    pygranso = None

AGREEMENT, FLOOR = 1e-3, 1e-6
Row = dict[str, Any]
METHODS = ("ours", "bfgs", "sampling", "other")


@cache
def plants() -> dict[str, Callable[[], System]]:
    """Plants of the library, and those that gym-lqr has whole, by name."""
    spec = importlib.util.find_spec("gym_lqr")  # its module of plants alone: the package wants gymnasium
    folders = spec.submodule_search_locations if spec else None
    if not folders:
        return dict(PLANTS)
    inner = importlib.util.spec_from_file_location("gym_lqr_compleib", Path(folders[0]) / "compleib.py")
    assert inner is not None and inner.loader is not None
    module = importlib.util.module_from_spec(inner)
    inner.loader.exec_module(module)
    found: dict[str, Callable[[], System]] = dict(PLANTS)
    for name in sorted(module.SUPPORTED_COMPLEIB_SYSTEMS - set(PLANTS)):
        data = module.COMPleib(name)
        if all(size is not None and size > 0 for size in data[8:]):
            found[name] = partial(CompleibPlant(*data[:8]).system, name)
    return found


def by_pygranso(function: Function, x: np.ndarray, deadline: float) -> np.ndarray:
    """Best point that PyGRANSO meets from a stabilising `x`, with its default options."""
    best, where = np.inf, x

    def combined(variables: Any) -> list[Any]:
        nonlocal best, where
        point = variables.x.detach().numpy().ravel()
        value, slope = function(point)
        if value < best:
            best, where = value, point.copy()
        return [value, torch.from_numpy(slope.reshape(-1, 1)), None, None, None, None]

    options = pygransoStruct()
    options.x0 = torch.from_numpy(x.reshape(-1, 1))
    options.maxclocktime = max(deadline - time.monotonic(), 1e-3)
    options.globalAD, options.print_level, options.quadprog_info_msg = False, 0, False
    pygranso(var_spec={"x": [len(x), 1]}, combined_fn=combined, user_opts=options)
    return where


def measured(row: Row, seconds: float, whole_limit: bool, methods: Collection[str]) -> Row:
    """The row of a plant and order with these methods measured, too, where they were not."""
    plant, order, row = plants()[row["name"]](), row["order"], dict(row)
    if "ours" in methods and "ours" not in row:
        row |= tuned(plant, order, seconds)
    rival_seconds = seconds if whole_limit else row["seconds"]
    rivals = (("bfgs", by_bfgs), ("sampling", by_sampling), ("other", by_pygranso if pygranso else None))
    for name, minimise in rivals:
        if name in methods and name not in row and minimise:
            row[name] = finite(restarted(plant, order, rival_seconds, minimise))
            row["rival_seconds"] = rival_seconds
    return row


def compared(row: Row, rivals: tuple[str, ...]) -> int | None:
    """1 where the tuner is better than the best of the rivals by more than 0.1 %, -1 where it is worse, else 0.

    None where no rival was measured.
    """
    if not any(name in row for name in rivals):
        return None
    ours, rival = (np.inf if v is None else v for v in (row["ours"], min_of(row.get(name) for name in rivals)))
    if ours == rival or abs(ours - rival) <= AGREEMENT * min(ours, rival) + FLOOR:
        return 0
    return 1 if ours < rival else -1


def min_of(values: Any) -> float | None:
    """Smallest of the numbers; None where there is none."""
    return min((v for v in values if v is not None), default=None)


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Counts over the rows: within 0.1 % of the best known value; wins, ties and losses against the other methods."""
    known = [r for r in rows if r["best_known"] is not None]
    against = {"": METHODS[1:], **{f"_{name}": (name,) for name in METHODS[1:]}}
    counts = {
        f"{key}{suffix}": sum(compared(row, rivals) == sign for row in rows)
        for suffix, rivals in against.items()
        for key, sign in (("wins", 1), ("ties", 0), ("losses", -1))
    }
    value = {(r["name"], r["order"]): np.inf if r["ours"] is None else r["ours"] for r in rows}
    return {
        "plants": [dict.fromkeys(METHODS) | row for row in rows],
        "within_0.1_percent": sum(reached(r) for r in known),
        "known": len(known),
        **counts,
        "worse_than_lower_order": [
            f"{name} {order}"
            for name, order in value
            if any(
                value[name, k] * (1.0 + AGREEMENT) + FLOOR < value[name, order]
                for k in range(order)
                if (name, k) in value
            )
        ],
        "norm": "AB13DD" if ab13dd else "level iteration",
        "other_method": "PyGRANSO" if pygranso else None,
    }


def reached(row: dict[str, Any]) -> bool:
    """Whether the tuner is within 0.1 % of the best known value, or below 1e-6 where that is zero."""
    return row["ours"] is not None and bool(row["ours"] <= max(row["best_known"] * (1.0 + AGREEMENT), FLOOR))


def arguments() -> argparse.Namespace:
    """Options of the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plants", default=",".join(PLANTS), help="names, separated by commas")
    parser.add_argument("--orders", default="0", help="orders of the controller, separated by commas")
    parser.add_argument("--seconds", type=float, default=60.0, help="wall limit of the tuner")
    parser.add_argument("--methods", default=",".join(METHODS), help="those to measure, the tuner (ours) first")
    parser.add_argument("--rival-time", choices=("used", "limit"), default="used", help="wall time of the others")
    parser.add_argument("--cpu", action="store_true", help="all limits and times in processor seconds")
    parser.add_argument("--rows", type=Path, metavar="FILE", help="rows measured so far, and those to come")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--table", action="store_true", help="Markdown, a row for each plant and order")
    found = parser.parse_args()
    if unknown := sorted(set(found.plants.split(",")) - set(plants())):
        parser.error(f"--plants must be among {', '.join(plants())}, got {', '.join(unknown)}")
    if unknown := sorted(set(found.methods.split(",")) - set(METHODS)):
        parser.error(f"--methods must be among {', '.join(METHODS)}, got {', '.join(unknown)}")
    if any(not order.isdigit() for order in found.orders.split(",")):
        parser.error(f"--orders must be whole numbers separated by commas, got {found.orders}")
    if not found.seconds > 0:
        parser.error(f"--seconds must be positive, got {found.seconds}")
    return found


def line(row: dict[str, Any]) -> str:
    """One row as text."""
    numbers = {k: "none" if row.get(k) is None else f"{row[k]:.7g}" for k in ("best_known", *METHODS)}
    word = {1: "win", 0: "tie", -1: "LOSS", None: "no rival measured"}[compared(row, METHODS[1:])]
    return (
        f"{row['name']:6s} order {row['order']}: best known {numbers['best_known']}, ours {numbers['ours']} "
        f"({row['status']}), BFGS {numbers['bfgs']}, sampling {numbers['sampling']}, other {numbers['other']}, "
        f"{row['seconds']:.1f} s: {word}"
    )


def table(rows: Sequence[Row]) -> str:
    """Markdown with one line a plant and order; the smallest value, and what is within 0.1 % of it, is bold."""
    methods = [m for m in METHODS if any(row[m] is not None for row in rows)]
    heads = {"ours": "lftkit", "bfgs": "BFGS", "sampling": "gradient sampling", "other": "PyGRANSO"}
    names = ["plant", "states", "order", "published", *(heads[m] for m in methods), "status", "CPU time"]
    lines = [names, ["---"] * len(names)]
    for row in rows:
        least = min_of(row[m] for m in methods)
        values = []
        for m in methods:
            text = "none" if row[m] is None else f"{row[m]:.5g}"
            best = row[m] is not None and row[m] <= least * (1.0 + AGREEMENT) + FLOOR
            values.append(f"**{text}**" if best else text)
        published = "" if row["best_known"] is None else f"{row['best_known']:g}"
        states, order = str(plants()[row["name"]]().order), str(row["order"])
        lines.append(
            [row["name"], states, order, published, *values, f"`{row['status']}`", f"{row['cpu_seconds']:.0f} s"]
        )
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


def known_rows(file: Path | None) -> dict[tuple[str, int], Row]:
    """Rows measured before, by plant and order; of several the last."""
    if file is None or not file.exists():
        return {}
    rows = [json.loads(text) for text in file.read_text(encoding="utf-8").splitlines()]
    return {(row["name"], row["order"]): row for row in rows}


def main() -> None:
    """Measure and print."""
    options = arguments()
    if options.cpu:
        time.monotonic = time.time = time.process_time  # the clocks of the tuner, of the methods here and of PyGRANSO
    known, rows = known_rows(options.rows), []
    with threadpool_limits(1):
        if pygranso:
            torch.set_num_threads(1)
        for name, order in product(options.plants.split(","), map(int, options.orders.split(","))):
            best = BEST_KNOWN.get(name) if order == 0 else None
            row = known.get((name, order), {"name": name, "order": order, "best_known": best})
            rows.append(measured(row, options.seconds, options.rival_time == "limit", options.methods.split(",")))
            if options.rows and rows[-1] != row:
                with options.rows.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(rows[-1]) + "\n")
            if not (options.json or options.table):
                print(line(rows[-1]), flush=True)
    found = summary(rows)
    if options.table:
        print(table(found["plants"]))
    elif options.json:
        print(json.dumps(found))
    else:
        print({key: value for key, value in found.items() if key != "plants"})


if __name__ == "__main__":
    main()
