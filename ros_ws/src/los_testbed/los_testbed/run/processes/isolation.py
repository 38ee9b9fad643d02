"""A separate network for the nodes of a run: no other program is on their ROS domain.

A network namespace has a loopback interface of its own and no other. A process outside has no address by which it could
reach a socket inside, whatever its domain, names and rate. A server for viewers listens outside: the runner opens its
sockets and hands them over, so nothing has to pass on what it sends.
"""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from lftkit.errors import InputError
from los_testbed.run.processes import namespaces
from los_testbed.run.processes.node_launch import (
    LAYER,
    LOCALHOST_VARIABLE,
    PROFILE_VARIABLES,
    RANGE_VARIABLE,
    TRANSPORT_VARIABLE,
)
from los_testbed.run.processes.ros_variables import LAYER_VARIABLE
from los_testbed.run.processes.viewers import Live, opened_here

_PROGRAM = [sys.executable, "-I", "-S", str(Path(namespaces.__file__))]
MAX_ANSWER, MAX_NAMESPACES = 1000, 2
LEFT_OUT = {*PROFILE_VARIABLES, TRANSPORT_VARIABLE, LOCALHOST_VARIABLE, "ROS_STATIC_PEERS", "ROS_DISCOVERY_SERVER"}


@dataclass(frozen=True)
class Network:
    """Network of the nodes of a run: that of this process, or one that exists as long as a process is inside.

    Attributes
    ----------
    descriptors : of its namespaces, in the order in which they are to be entered; empty for that of this process
    """

    descriptors: tuple[int, ...] = ()

    def command(self, command: Sequence[str]) -> list[str]:
        """Command that begins inside, with the same process number; it must inherit the descriptors."""
        if not self.descriptors:
            return list(command)
        return [*_PROGRAM, "enter", ",".join(map(str, self.descriptors)), *command]

    def environment(self, variables: Mapping[str, str]) -> dict[str, str]:
        """Environment of a node inside.

        Raises
        ------
        ValueError
            As :func:`isolated_environment`.
        """
        return isolated_environment(variables) if self.descriptors else dict(variables)

    @contextlib.contextmanager
    def server(self, live: Live | None) -> Iterator[Live | None]:
        """The server for viewers, which listens in the network of this process.

        Raises
        ------
        ValueError
            A port is in use.
        """
        with contextlib.ExitStack() as held:
            yield held.enter_context(opened_here(live)) if live is not None and self.descriptors else live


@contextlib.contextmanager
def network_of_nodes(isolated: bool) -> Iterator[Network]:
    """That of this process, or a new one.

    Raises
    ------
    ValueError
        As :func:`isolated_network`.
    """
    with contextlib.ExitStack() as held:
        yield held.enter_context(isolated_network()) if isolated else Network()


@contextlib.contextmanager
def isolated_network() -> Iterator[Network]:
    """A new network, with nothing but a loopback interface.

    Raises
    ------
    ValueError
        This machine does not permit it to this user.
    """
    own, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with own:
        with other:
            number = other.fileno()
            maker = subprocess.Popen([*_PROGRAM, "make", str(number)], pass_fds=[number], stdin=subprocess.DEVNULL)
        answer, descriptors, _, _ = socket.recv_fds(own, MAX_ANSWER, MAX_NAMESPACES)
        maker.wait()
    if not descriptors:
        reason = answer.decode(errors="replace") or f"exit code {maker.returncode}"
        raise InputError(f"--isolated must be permitted (user and network namespaces), got: {reason}")
    try:
        yield Network(tuple(descriptors))
    finally:
        for descriptor in descriptors:
            os.close(descriptor)


def isolated_environment(variables: Mapping[str, str]) -> dict[str, str]:
    """Environment of nodes in a network of their own: UDP on its loopback interface, and no other way.

    Settings of the user could add shared memory, which is not part of a network: they are ignored.

    Raises
    ------
    ValueError
        Another middleware, whose transports are not known.
    """
    layer = variables.get(LAYER_VARIABLE, LAYER)
    if not layer.startswith(LAYER):
        raise InputError(f"{LAYER_VARIABLE} must be {LAYER}_cpp with --isolated, got {layer}")
    kept = {name: value for name, value in variables.items() if name not in LEFT_OUT}
    return {**kept, RANGE_VARIABLE: "LOCALHOST"}
