"""The same commands by this code and by that of another checkout, in turn: processor seconds and their ratio.

    git worktree add ../before 86e1308d^           # the last commit without the compiled tick
    python benchmarks/versions.py ../before [--verify] [--json]

Both run with this interpreter and its packages; the code of the other checkout comes first on its path. A figure of a
part is the difference of two commands, for instance of campaigns of 72 and of 8 members. Each command is run
`--repeats` times in turn with the other version, and the least counts. Other work on the machine changes both in the
same way.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import tempfile
from pathlib import Path
from typing import Any

from goals import command

HERE = Path(__file__).parents[1]
RUN = ("run", "--mode", "inprocess", "--no-report", "--output", "{bag}", "--duration")
CAMPAIGN = ("campaign", "--workers", "1", "--output", "{bag}", "--samples")
DESIGN, WORST, MODEL = ("--scenario", "design"), ("--scenario", "worst_case"), ("--depth", "model")
PARTS: dict[str, tuple[tuple[str, ...], tuple[str, ...] | None, float]] = {
    "help": (("--help",), None, 1.0),
    "short_run": ((*RUN, "1"), None, 1.0),
    "second_of_a_run": ((*RUN, "70"), (*RUN, "10"), 60.0),
    "report_of_10_s": (("report", "{made}", "--output", "{bag}.html"), None, 1.0),
    "member_design": ((*CAMPAIGN, "72", *DESIGN), (*CAMPAIGN, "8", *DESIGN), 64.0),
    "member_worst_case": ((*CAMPAIGN, "72", *WORST), (*CAMPAIGN, "8", *WORST), 64.0),
    "member_model": ((*CAMPAIGN, "264", *MODEL), (*CAMPAIGN, "8", *MODEL), 256.0),
}
"""A command, the shorter one that is taken off, and by what the difference is divided."""
VERIFY = {"verify": (("design", "verify", "--workers", "1"), None, 1.0)}


class Version:
    """Code of a checkout, and a folder for what its commands write."""

    def __init__(self, checkout: Path, folder: Path) -> None:
        sources = [checkout, checkout / "ros_ws" / "src" / "los_testbed"]
        self.variables = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, sources))}
        self.folder, self._count = folder, 0
        folder.mkdir()

    def seconds(self, words: tuple[str, ...]) -> float:
        """Processor seconds of a command, child processes included."""
        self._count += 1
        new = self.folder / f"new{self._count}"
        filled = [word.format(bag=new, made=self.folder / "made") for word in words]
        # the working directory comes before all others on the path
        found = command(*filled, repeats=1, env=self.variables, cwd=self.folder)
        if new.is_dir():
            shutil.rmtree(new)
        return found["now"]

    def prepare(self) -> None:
        """Compile what is compiled once, and make the bag of the report."""
        self.seconds((*RUN[:-2], str(self.folder / "made"), "--duration", "10"))


def measured(versions: tuple[Version, Version], name: str, repeats: int) -> dict[str, Any]:
    """Least processor seconds of a part with both versions, and their ratio."""
    whole, taken_off, divisor = {**PARTS, **VERIFY}[name]
    values = []
    for commands in (whole, taken_off):
        if commands is None:
            values.append([0.0, 0.0])
            continue
        found = [[version.seconds(commands) for version in versions] for _ in range(repeats)]
        values.append([min(row[k] for row in found) for k in range(2)])
    before, now = ((values[0][k] - values[1][k]) / divisor for k in range(2))
    text = " ".join(whole) + (f" less {' '.join(taken_off)}, over {divisor:g}" if taken_off else "")
    return {
        "before_cpu_s": float(f"{before:.4g}"),
        "now_cpu_s": float(f"{now:.4g}"),
        "ratio": float(f"{before / now:.3g}"),
        "command": text,
    }


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkout", type=Path)
    parser.add_argument("--verify", action="store_true", help="design verify, too (minutes)")
    parser.add_argument("--repeats", type=int, default=2)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as text:
        both = Version(arguments.checkout.resolve(), Path(text) / "before"), Version(HERE, Path(text) / "now")
        for version in both:
            version.prepare()
        result = {name: measured(both, name, arguments.repeats) for name in PARTS}
        if arguments.verify:
            result |= {name: measured(both, name, 1) for name in VERIFY}
    print(json.dumps(result) if arguments.json else json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
