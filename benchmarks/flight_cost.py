"""Instructions of a step of the flight code, and its stack: counted by valgrind (callgrind), told by the compiler.

    python benchmarks/flight_cost.py --docs

Loops have fixed bounds and the only branches are those of absent samples, limits and stages, so that the largest count
over these cases is that of the worst step. `--docs` writes the table of docs/flight_code.md.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
import tempfile
from pathlib import Path

from los_testbed.flight.export import compiler, render
from los_testbed.flight.laws import laws_of
from los_testbed.flight.tables import HEADER, UNITS
from real_time_loop import write_between

from pointing_analysis.formatting.tables import TextTable

ROOT = Path(__file__).parents[1]
STEPS = 20
CASES = {"as usual": "1e-6", "frame absent": "NAN", "at the limits": "1.0", "large": "1e300"}
FUNCTIONS = ("los_k_fsm_step", "los_controller_step", "los_gate_offer", "los_gate_step")
LEVELS = ("-O0", "-O2")
MAIN = f"""
#include <math.h>
#include <stdlib.h>
#include "los_flight.h"

static los_k_fsm observer;
static los_controller controller;
static los_gate gate;

int main(int n, char **words)
{{
    double y[LOS_MEASUREMENTS];
    double estimate[LOS_ESTIMATES];
    double command[LOS_COMMANDS];
    const double value = strtod(words[n - 1], NULL);
    int k;
    int i;
    los_k_fsm_init(&observer);
    los_controller_init(&controller);
    los_gate_init(&gate, LOS_GATE_FORCES, LOS_TICK_NS);
    for (k = 1; k <= {STEPS}; ++k) {{
        for (i = 0; i < LOS_MEASUREMENTS; ++i) {{
            y[i] = ((value == value) || (i >= LOS_ACCEL_IP + 18)) ? value : 1e-6;
        }}
        los_k_fsm_step(&observer, y, estimate);
        los_controller_step(&controller, estimate, &y[LOS_ACCEL_IP], command);
        (void)los_gate_offer(&gate, k * LOS_TICK_NS, &command[LOS_FORCE], (k + 1) * LOS_TICK_NS);
        los_gate_step(&gate, (k + 1) * LOS_TICK_NS, &command[LOS_FORCE]);
    }}
    return 0;
}}
"""


def measure(folder: Path, level: str) -> dict[str, dict[str, int]]:
    """For each function the largest number of instructions of a call, and its bytes of stack, with what it calls."""
    command = compiler()
    if command is None:
        raise SystemExit("a C compiler must be there, got none")
    flags = ["-std=c99", level, "-ffp-contract=off"]
    for name, text in {**render(laws_of(), (HEADER, *(f"{unit}.c" for unit in UNITS))), "main.c": MAIN}.items():
        (folder / name).write_text(text)
    sources = [f"{unit}.c" for unit in UNITS]
    subprocess.run([*command, *flags, "-fstack-usage", "-c", *sources], cwd=folder, check=True)
    subprocess.run(
        [*command, *flags, "main.c", *(f"{u}.o" for u in UNITS), "-o", "main", "-lm"], cwd=folder, check=True
    )
    counts = {name: max(_calls(folder, name, value) for value in CASES.values()) for name in FUNCTIONS}
    used = dict(_stack(folder))
    inside = {"los_controller_step": used["los_k_pma_step"]}
    helpers = max(size for name, size in used.items() if not name.startswith("los_")) if level == "-O0" else 0
    return {
        name: {"instructions": counts[name], "stack_bytes": used[name] + inside.get(name, 0) + helpers}
        for name in FUNCTIONS
    }


def _calls(folder: Path, name: str, value: str) -> int:
    """Instructions of a call."""
    line = [
        "valgrind",
        "--tool=callgrind",
        "--callgrind-out-file=/dev/null",
        f"--toggle-collect={name}",
        "./main",
        value,
    ]
    done = subprocess.run(line, cwd=folder, capture_output=True, text=True, check=True)
    found = re.search(r"Collected : (\d+)", done.stderr)
    assert found is not None, done.stderr
    return round(int(found[1]) / STEPS)


def _stack(folder: Path) -> list[tuple[str, int]]:
    """Functions and their own bytes of stack; all sizes are known when they are compiled."""
    found = []
    for file in folder.glob("*.su"):
        for line in file.read_text().splitlines():
            place, size, kind = line.split("\t")
            assert kind == "static", line
            found.append((place.rsplit(":", 1)[1], int(size)))
    return found


def table(found: dict[str, dict[str, dict[str, int]]]) -> str:
    """Rows of the documentation."""
    heads = [f"{what}, {level}" for level in found for what in ("instructions", "stack [bytes]")]
    lines = [[f"`{name}`", *(f"{n:,}" for rows in found.values() for n in rows[name].values())] for name in FUNCTIONS]
    return TextTable.of(("function", *heads), lines).markdown() + "\n"


def main() -> int:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--docs", action="store_true", help="write the table of docs/flight_code.md")
    given = parser.parse_args()
    found = {}
    for level in LEVELS:
        with tempfile.TemporaryDirectory() as folder:
            found[level] = measure(Path(folder), level)
    print(json.dumps(found))
    if given.docs:
        write_between(ROOT / "docs" / "flight_code.md", "flight_cost", table(found))
    return 0


if __name__ == "__main__":
    sys.exit(main())
