"""Run the fuzz tests with random examples for some minutes: ``python tests/fuzz/fuzz_for.py 10``."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

ROUND = 20
"""Examples of each test in one round."""


def main(minutes: float) -> int:
    """Rounds until the time is over or something was found; the exit code of the last one."""
    end, rounds = time.monotonic() + 60 * minutes, 0
    folder = Path(__file__).parent
    while time.monotonic() < end:
        rounds += 1
        environment = {**os.environ, "FUZZ_EXAMPLES": str(ROUND)}
        command = [sys.executable, "-m", "pytest", "-q", "-x", "-m", "not slow", "--timeout=3000", str(folder)]
        code = subprocess.run(command, env=environment, check=False).returncode
        if code:
            return code
    sys.stdout.write(f"{rounds} rounds of {ROUND} examples of each test: nothing found\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(float(sys.argv[1])))
