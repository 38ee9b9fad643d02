"""Run the fuzz tests with random examples for some minutes: ``python tests/fuzz/fuzz_for.py 10``.

All rounds are in this process: the imports, a third of the time of a round of its own, are done once.
"""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path

ROUND = 20
"""Examples of each test in one round."""
HANG_S = 600
"""Wall time in which a test of one round must end, also on a busy machine; else the stacks are printed."""


def main(minutes: float) -> int:
    """Rounds until the time is over or something was found; the exit code of the last one."""
    os.environ["FUZZ_EXAMPLES"] = str(ROUND)
    import pytest

    end, rounds = time.monotonic() + 60 * minutes, 0
    options = ["-q", "-x", "-m", "not slow", f"--timeout={HANG_S}", "--timeout-method=thread", "-p", "no:cacheprovider"]
    while time.monotonic() < end:
        rounds += 1
        code = pytest.main([*options, *map(str, sorted(Path(__file__).parent.glob("test_fuzz_*.py")))])
        if code:
            return int(code)
    sys.stdout.write(
        f"{rounds} rounds of {ROUND} examples of each test in {time.process_time():.0f} s of processor time: "
        "nothing found\n"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main(float(sys.argv[1])))
