"""Entry point of ``los-testbed`` and ``python -m los_testbed``: a signal ends it with one line, also during imports.

The imports take most of a second, before the handlers of the command line are installed.
"""

from __future__ import annotations

import os
import signal
from typing import Any, NoReturn

from los_testbed.run.processes.memory import check_command
from pointing_analysis.command.exit_codes import ExitCode


def _end(number: int, frame: Any) -> NoReturn:
    """Exit on a signal during the imports: nothing is open yet, and an exception inside an import could be replaced."""
    os.write(2, b"los-testbed: interrupted\n")
    os._exit(ExitCode.INTERRUPTED)


def main() -> int:
    """Entry point: that of the command line, see `los_testbed.cli.app.main`."""
    interrupt = signal.getsignal(signal.SIGINT)
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _end)
    try:
        check_command()
    except ValueError as error:
        os.write(2, f"los-testbed: {error}\n".encode())
        return ExitCode.USER_ERROR
    from los_testbed.cli.app import main as command_line

    signal.signal(signal.SIGINT, interrupt)
    return command_line()


if __name__ == "__main__":
    raise SystemExit(main())
