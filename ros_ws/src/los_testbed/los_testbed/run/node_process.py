"""A node as a child process of the runner."""

from __future__ import annotations

import contextlib
import json
import signal
import subprocess
from collections.abc import Mapping, Sequence
from typing import IO, Any


class NodeProcess:
    """One node as a child process; its events come line by line."""

    def __init__(
        self, name: str, command: Sequence[str], variables: Mapping[str, str], inherited: Sequence[int] = ()
    ) -> None:
        self.name = name
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

    def interrupt(self) -> None:
        """Ask it to end."""
        self.asked_to_stop = True
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
