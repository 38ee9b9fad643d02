"""Two hosts on one machine: network namespaces joined by a veth pair, or by a link that delays and loses packets."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from los_testbed.config.run_config import RunConfig
from los_testbed.run.processes.node_launch import environment, node_command, parameter_file

LINK = str(Path(__file__).with_name("lossy_link.py"))
HOST_OF_NODE = {"plant": "a", "recorder": "a", "estimator": "b", "controller": "b"}


class NotPermittedError(RuntimeError):
    """Network namespaces cannot be made here."""


@dataclass
class Hosts:
    """Names of the namespaces; after :meth:`unplug`, what the lossy link carried and lost.

    ``lost_outward`` and ``lost_returning`` are stamps of ticks [ns] whose samples were lost on the way from the
    plant's host and on the way back to it.
    """

    names: Mapping[str, str]
    link: subprocess.Popen[str] | None = None
    carried: int = 0
    lost: int = 0
    lost_outward: tuple[int, ...] = ()
    lost_returning: tuple[int, ...] = ()
    processes: dict[str, subprocess.Popen[bytes]] = field(default_factory=dict)

    def unplug(self) -> None:
        """End the lossy link and read its account."""
        if self.link is not None and self.link.poll() is None:
            self.link.terminate()
            account = json.loads(self.link.communicate()[0])
            self.carried, self.lost = account["carried"], account["lost"]
            self.lost_outward, self.lost_returning = (tuple(stamps) for stamps in account["stamps"])

    def run(self, config: RunConfig, folder: Path, plant: Sequence[str] | None = None) -> None:
        """Plant and recorder on the first host, estimator and controller on the second, until the run is over.

        Raises
        ------
        RuntimeError
            A node ended with an error.
        """
        parameters = folder / "run.yaml"
        parameter_file(config, parameters)
        variables = {**environment(config.domain, folder), "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}
        try:
            for name, host in HOST_OF_NODE.items():
                command = plant if plant is not None and name == "plant" else node_command(name)
                self.processes[name] = subprocess.Popen(
                    ["ip", "netns", "exec", self.names[host], *command, "--ros-args", "--params-file", str(parameters)],
                    env=variables,
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.PIPE,
                )
            self._await("plant", config.duration + 60.0)
            for name in ("estimator", "controller", "recorder"):
                self.processes[name].send_signal(signal.SIGINT)
                self._await(name, 60.0)
        finally:
            for process in self.processes.values():
                process.kill()
                process.communicate()

    def _await(self, name: str, seconds: float) -> None:
        process = self.processes[name]
        if process.wait(seconds) != 0:
            assert process.stderr is not None
            raise RuntimeError(f"{name}: {process.stderr.read().decode(errors='replace')}")


@contextlib.contextmanager
def veth_pair() -> Iterator[Hosts]:
    """Two hosts joined by a veth pair, which loses nothing.

    Raises
    ------
    NotPermittedError
    """
    with _namespaces("ab") as names:
        a, b = names["a"], names["b"]
        _sh("ip", "link", "add", a, "netns", a, "type", "veth", "peer", b, "netns", b)
        _address(a, b)
        yield Hosts(names)


@contextlib.contextmanager
def lossy_link(delay: float = 2e-4, period: int = 100) -> Iterator[Hosts]:
    """Two hosts and a link that delays every packet by `delay` [s] and loses the data of two ticks in `period`.

    Raises
    ------
    NotPermittedError
    """
    with _namespaces("abw") as names:
        a, b, w = names["a"], names["b"], names["w"]
        for host in (a, b):
            _sh("ip", "link", "add", host, "netns", host, "type", "veth", "peer", f"{host}w", "netns", w)
            _sh("ip", "-n", w, "link", "set", f"{host}w", "up")
        _address(a, b)
        for host in (a, b):
            _sh("ip", "netns", "exec", host, sys.executable, LINK, "--whole-checksums", host)
        command = ["ip", "netns", "exec", w, sys.executable, LINK, f"{a}w", f"{b}w", str(delay), str(period)]
        link = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        try:
            yield Hosts(names, link)
        finally:
            link.kill()
            link.wait()


@contextlib.contextmanager
def _namespaces(letters: str) -> Iterator[dict[str, str]]:
    """Namespaces with names of this process's own."""
    names = {letter: f"los{os.getpid() % 100000}{letter}" for letter in letters}
    try:
        for name in names.values():
            _sh("ip", "netns", "add", name)
        yield names
    finally:
        for name in names.values():
            with contextlib.suppress(FileNotFoundError):
                subprocess.run(["ip", "netns", "del", name], capture_output=True, check=False)


def _address(*names: str) -> None:
    for number, name in enumerate(names, start=1):
        _sh("ip", "-n", name, "addr", "add", f"10.99.0.{number}/24", "dev", name)
        _sh("ip", "-n", name, "link", "set", name, "up")
        _sh("ip", "-n", name, "link", "set", "lo", "up")
        _sh("ip", "-n", name, "route", "add", "224.0.0.0/4", "dev", name)


def _sh(*command: str) -> None:
    try:
        subprocess.run(command, check=True, capture_output=True, text=True)
    except (subprocess.CalledProcessError, FileNotFoundError) as error:
        raise NotPermittedError(str(getattr(error, "stderr", None) or error).strip()) from None
