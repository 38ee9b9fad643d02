"""A program of a run as a child process of the runner."""

from __future__ import annotations

import contextlib
import json
import signal
import subprocess
from collections.abc import Mapping, Sequence
from typing import IO, Any

from los_testbed.run.loop.scheduling import MAX_BUSY_S
from los_testbed.run.processes.memory import TOO_LITTLE_MEMORY, names_memory


class NodeProcess:
    """One program, with one node or several, as a child process; its events come line by line.

    Parameters
    ----------
    name : str
    command : sequence of str
    variables : mapping
        Its environment.
    inherited : sequence of int
        Descriptors that it keeps.
    nodes : sequence of str
        Its nodes; default: one that has its name.
    """

    def __init__(
        self,
        name: str,
        command: Sequence[str],
        variables: Mapping[str, str],
        inherited: Sequence[int] = (),
        nodes: Sequence[str] = (),
    ) -> None:
        self.name = name
        self.nodes = tuple(nodes) or (name,)
        self.process = subprocess.Popen(
            command,
            env=dict(variables),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            pass_fds=tuple(inherited),
            start_new_session=True,  # the terminal's interrupt is for the runner, which ends them in order
        )
        self.errors = ""
        self._rest = b""
        self.asked_to_stop = False

    @property
    def streams(self) -> tuple[IO[bytes], IO[bytes]]:
        """Output and error output."""
        assert self.process.stdout is not None and self.process.stderr is not None
        return self.process.stdout, self.process.stderr

    def feed(self, data: bytes) -> list[dict[str, Any]]:
        """Events in the output that came."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        events = []
        for line in lines:
            with contextlib.suppress(ValueError):
                event = json.loads(line)
                if isinstance(event, dict) and "event" in event:
                    events.append(event)
        return events

    def how_it_ended(self, code: int, number: int = 0) -> str:
        """Exit code or signal, with its cause where that is known, and the last line of the error output.

        Parameters
        ----------
        code : int
            Exit code, or the negative number of the signal that killed it.
        number : int
            Signal after which it ended in order; 0 without one.
        """
        number = max(number, -code)
        how = f"signal {number}" if number else f"exit code {code}"
        if code == -signal.SIGXCPU:
            how += f": it computed for {MAX_BUSY_S:g} s without yielding at real-time priority"
        if names_memory(self.errors):
            how += f": {TOO_LITTLE_MEMORY}"
        last = self.errors.strip().splitlines()[-1:] or [""]
        return f"{self.name} ended unexpectedly ({how}) {last[0]}".strip()

    def interrupt(self) -> None:
        """Ask it to end."""
        self.asked_to_stop = True
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
