"""Files of tests that could fail on another machine: clocks, signals, processes, terminals, paths, the last bits.

`make test-anywhere` runs them; `tests/elsewhere.py` makes such machines. As a program: their names, for pytest.
"""

from __future__ import annotations

import sys

ANYWHERE = (
    "architecture/test_environment.py",
    "integration/test_loop_without_ros.py",
    "integration/test_run_start.py",
    "ros/test_runs_with_processes.py",
    "ros/test_told_counts.py",
    "unit/lftkit/analysis/test_discrete_norm.py",
    "unit/lftkit/analysis/test_hinf_norm.py",
    "unit/lftkit/support/test_workers.py",
    "unit/lftkit/tuning/test_tuner.py",
    "unit/los_testbed/cli/test_command_line.py",
    "unit/los_testbed/run/test_compiled_loop.py",
    "unit/los_testbed/rig/test_device_faults.py",
    "unit/los_testbed/rig/test_device_samples.py",
    "unit/los_testbed/cli/test_exit_codes.py",
    "unit/los_testbed/flight/test_flight_code.py",
    "unit/los_testbed/run/test_scheduling.py",
    "unit/los_testbed/run/test_summary_on_screen.py",
    "unit/los_testbed/cli/test_unusual_files.py",
)
"""Below `tests`."""

if __name__ == "__main__":
    sys.stdout.write(" ".join(f"tests/{name}" for name in ANYWHERE) + "\n")
