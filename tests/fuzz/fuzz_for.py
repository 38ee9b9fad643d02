"""Run the fuzz tests with random examples for some minutes: ``python tests/fuzz/fuzz_for.py 10 [--seed=N] [FILE ...]``.

The seed, random without the option, gives the examples of all rounds; it is printed at the end, below a table of how
many examples each test had. How many rounds there are is a matter of the machine.

The rounds are in one process, so that the imports are done once, and this one keeps the time and answers signals: the
code that is fuzzed has answers to signals of its own. At the end of the time, at SIGINT, SIGTERM and SIGHUP the example
that runs is the last one; a second signal ends that, too. Exit code: 0 nothing found, 130 nothing found until a signal
came, 1 (or that of pytest) something found.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

ROUND = 20
"""Examples of each test in one round."""
HANG_S = 600
"""Wall time in which a test of one round must end, also on a busy machine; else the stacks are printed."""
SEEDS = 10**6
"""Seeds of rounds for each seed."""
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def rounds(seed: int, files: list[str]) -> int:
    """Rounds until the time is over or something was found; the exit code of the last one."""
    import pytest
    from _pytest.config import ExitCode
    from fuzz import fuzz_profile

    class NoMore:
        """No fixtures are made for a test that may not begin."""

        @pytest.hookimpl(tryfirst=True)
        def pytest_runtest_setup(self) -> None:
            if fuzz_profile.over():
                pytest.skip("the time of the fuzzing is over")

    options = ["-q", "-x", "-m", "not slow", f"--timeout={HANG_S}", "--timeout-method=thread", "-p", "no:cacheprovider"]
    count, code = 0, ExitCode.OK
    while not fuzz_profile.over() and not code:
        count += 1
        own = f"--hypothesis-seed={seed * SEEDS + count}"
        code = ExitCode(pytest.main([*options, own, *files], plugins=[NoMore()]))
    word = "something was found" if code else "nothing found"
    examples = fuzz_profile.Count.examples
    table = "".join(f"{name:60}{number:10d}\n" for name, number in sorted(examples.items()))
    sys.stdout.write(f"\n{'test':60}{'examples':>10}\n{table}")
    sys.stdout.write(
        f"{sum(examples.values())} examples in {count} rounds of {ROUND} examples of each test, seed {seed}, "
        f"{time.process_time():.0f} s of processor time: {word}\n"
    )
    return int(code)


def main(minutes: float, seed: int, files: list[str]) -> int:
    """Start the rounds, and close the pipe to them at the end of the time or at a signal; the exit code."""
    end, came = time.monotonic() + 60 * minutes, list[int]()
    for number in SIGNALS:
        signal.signal(number, lambda number, _: came.append(number))
    reading, writing = os.pipe()
    tests = Path(__file__).parents[1]
    path = os.pathsep.join([str(tests), *filter(None, [os.environ.get("PYTHONPATH")])])
    variables = {**os.environ, "FUZZ_EXAMPLES": str(ROUND), "FUZZ_STOP": str(reading), "PYTHONPATH": path}
    child = subprocess.Popen(
        [sys.executable, __file__, "--rounds", str(seed), *files],
        pass_fds=[reading],
        start_new_session=True,
        env=variables,
    )
    os.close(reading)
    while child.poll() is None and not came and time.monotonic() < end:
        time.sleep(0.1)
    os.close(writing)
    while child.poll() is None and len(came) < 2:
        time.sleep(0.1)
    if child.poll() is None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(child.pid, signal.SIGKILL)
    code = child.wait()
    if came:
        names = " and ".join(signal.Signals(number).name for number in came)
        sys.stdout.write(f"ended by {names} before the time was over\n")
    if code < 0 and len(came) < 2:
        sys.stdout.write(f"something was found: the tests ended by {signal.Signals(-code).name}\n")
        return 1
    return code if code > 0 else 130 if came else 0


if __name__ == "__main__":
    if sys.argv[1] == "--rounds":
        sys.exit(rounds(int(sys.argv[2]), sys.argv[3:]))
    parser = argparse.ArgumentParser()
    parser.add_argument("minutes", type=float)
    parser.add_argument("files", nargs="*")
    parser.add_argument("--seed", type=int, default=random.SystemRandom().randrange(SEEDS))
    given = parser.parse_intermixed_args()
    found = given.files or [str(file) for file in sorted(Path(__file__).parent.glob("test_fuzz_*.py"))]
    sys.exit(main(given.minutes, given.seed, found))
