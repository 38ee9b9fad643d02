"""Nodes of a run as copies of one process that has imported what they need: a fork in place of a start of Python.

A start of Python with the imports of a node costs half a second of processor time, and a run has three of them. In
``tests/ros`` the runner gets its nodes from here (see ``conftest.py`` there): processes of their own as ever, each with
the environment, folder and descriptors that the runner gives it, its parent the process of the runner. Whatever a fork
cannot give is started as outside the tests: another command than that of a node, other variables of the interpreter or
of the loader. Runs of the command line are not changed by this.

    python node_template.py DESCRIPTOR        the process that is copied
"""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import gc
import importlib
import json
import os
import runpy
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

PACKAGE = "los_testbed.nodes"
PROGRAMS = ("plant", "estimator", "controller", "estimator_controller", "recorder")
NODES = {
    **{("-m", f"{PACKAGE}.{name}"): f"{PACKAGE}.{name}" for name in PROGRAMS},
    **{(str(Path(__file__).with_name(f"{name}.py")),): name for name in ("simple_telescope", "attacker")},
}
"""Modules with a `main`, by the arguments of the interpreter that start them."""

OWN = "code of a test"
"""Instead of a module: what follows `-c`, or a script."""

LATE_IMPORTS = (
    "email.parser",
    "los_design.verification.statements",
    "rosidl_generator_py",
    "service_msgs.msg",
    "std_srvs.srv",
    "titop_plant.telescope.error_budget",
    "type_description_interfaces.srv",
)
"""Modules that nodes import when they have begun."""

EARLY_VARIABLES = ("PYTHON", "ROS_PYTHON", "LD_", "MALLOC_", "OPENBLAS_")
"""Beginnings of the names of variables that are read when a process starts or imports."""

FIRST_FREE = 300
"""Descriptors from here on are in nobody's way."""

_SET_CHILD_SUBREAPER = 36


def early(variables: Mapping[str, str]) -> dict[str, str]:
    """The variables that a copy cannot take over."""
    return {name: value for name, value in variables.items() if name.startswith(EARLY_VARIABLES)}


class Copy:
    """A copy of the template: the part of ``subprocess.Popen`` that a runner uses."""

    def __init__(self, pid: int, output: int, errors: int) -> None:
        self.pid = pid
        self.returncode: int | None = None
        self.stdout, self.stderr = open(output, "rb"), open(errors, "rb")  # noqa: SIM115 (closed by the runner)
        self._lock = threading.Lock()

    def poll(self) -> int | None:
        """Exit code, or the negative number of a signal; None while it runs."""
        with self._lock:
            if self.returncode is None:
                found, status = os.waitpid(self.pid, os.WNOHANG)
                self.returncode = os.waitstatus_to_exitcode(status) if found else None
            return self.returncode

    def wait(self) -> int:
        """Exit code, when it has ended."""
        while (code := self.poll()) is None:
            time.sleep(0.01)
        return code

    def send_signal(self, number: int) -> None:
        """Send a signal, if it runs."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        """Kill it, if it runs."""
        self.send_signal(signal.SIGKILL)


class NodeTemplate:
    """Starts nodes; takes the place of the module ``subprocess`` where the runner starts its own."""

    DEVNULL, PIPE = subprocess.DEVNULL, subprocess.PIPE

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._channel: socket.socket | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._early: dict[str, str] = {}

    def Popen(
        self, command: Sequence[str], *, env: Mapping[str, str], pass_fds: Sequence[int] = (), **options: Any
    ) -> Copy | subprocess.Popen[bytes]:
        """Start a command: a copy where it is a node, else as ever."""
        module, arguments = _node_of(command)
        with self._lock:
            if module and self._channel is None and early(env) == early(os.environ):
                self._begin(env)
            if not module or early(env) != self._early:
                return subprocess.Popen(list(command), env=dict(env), pass_fds=tuple(pass_fds), **options)
            return self._copy(module, arguments, env, pass_fds)

    def _begin(self, variables: Mapping[str, str]) -> None:
        self._channel, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with other:
            command = [sys.executable, __file__, str(other.fileno())]
            self._early = early(variables)
            self._process = subprocess.Popen(
                command,
                env=dict(variables),
                stdin=subprocess.DEVNULL,
                pass_fds=[other.fileno()],
                start_new_session=True,  # it ends with this process: a key of the terminal is not for it
            )

    def _copy(self, module: str, arguments: list[str], variables: Mapping[str, str], passed: Sequence[int]) -> Copy:
        assert self._channel is not None
        output, errors = os.pipe(), os.pipe()
        request = {
            "module": module,
            "arguments": arguments,
            "variables": dict(variables),
            "folder": os.getcwd(),
            "parent": os.getpid(),
            "descriptors": [1, 2, *passed],
        }
        kernel = ctypes.CDLL(None)
        try:
            kernel.prctl(_SET_CHILD_SUBREAPER, 1, 0, 0, 0)  # the copy becomes a child of this process
            socket.send_fds(self._channel, [json.dumps(request).encode()], [output[1], errors[1], *passed])
            pid = int(self._channel.recv(100))
        finally:
            kernel.prctl(_SET_CHILD_SUBREAPER, 0, 0, 0, 0)
            os.close(output[1])
            os.close(errors[1])
        return Copy(pid, output[0], errors[0])

    def close(self) -> None:
        """End the template; its copies go on."""
        if self._channel is not None and self._process is not None:
            self._channel.close()
            self._process.wait()


def _node_of(command: Sequence[str]) -> tuple[str, list[str]]:
    """Module of a node and its arguments; an empty name for another command."""
    program, *rest = command
    for begin, module in NODES.items():
        if program == sys.executable and tuple(rest[: len(begin)]) == begin:
            return module, list(rest[len(begin) :])
    own = program == sys.executable and (rest[0] == "-c" or rest[0].endswith(".py"))
    return (OWN, list(rest)) if own else ("", [])


def serve(channel: socket.socket) -> int:
    """Make copies until the other side is closed. In a copy: its exit code."""
    for name in (*NODES.values(), *LATE_IMPORTS):
        importlib.import_module(name)
    first_moments()
    assert threading.active_count() == 1, "a fork copies one thread only"
    tell = tracing_library()
    while True:
        data, descriptors, _, _ = socket.recv_fds(channel, 1 << 20, 100)
        if not data:
            return 0
        reading, writing = os.pipe()
        tell("before_fork")
        between = os.fork()
        if not between:
            copy = os.fork()
            if copy:
                os.write(writing, str(copy).encode())
                os._exit(0)
            tell("after_fork_child")
            for descriptor in (reading, writing, channel.detach()):
                os.close(descriptor)
            return become(json.loads(data), descriptors)
        tell("after_fork_parent")
        os.waitpid(between, 0)
        for descriptor in (writing, *descriptors):
            os.close(descriptor)
        channel.send(os.read(reading, 100))
        os.close(reading)


def first_moments() -> None:
    """What every node does before its first tick and which is the same for all: once, before the copies are made.

    Type supports of messages, the shipped telescope, the search for libraries of linear algebra. The garbage collector
    leaves what is there alone from now on, so that a copy does not write to the pages of all objects.
    """
    from los_testbed.config.run_config import RunConfig
    from los_testbed.parts.run_parts import RunParts
    from rclpy.type_support import check_for_type_support

    from lftkit.support.threads import one_thread

    for module in [module for module in sys.modules.values() if hasattr(module, "__dict__")]:
        for kind in [value for value in vars(module).values() if isinstance(value, type)]:
            if hasattr(type(kind), "_TYPE_SUPPORT"):
                check_for_type_support(kind)
    one_thread()
    RunParts(RunConfig()).plant()
    gc.collect()
    gc.freeze()


def tracing_library() -> Callable[[str], None]:
    """A function that tells the tracing library of rclpy of a moment of a fork, since it has threads.

    Before a fork it takes its locks, and signals wait until it has given them back or, in the copy, has begun anew.
    Where rclpy has none, nobody is told.
    """
    signals = ctypes.create_string_buffer(1024)  # a `sigset_t`
    mapped = [line for line in Path("/proc/self/maps").read_text().splitlines() if "/" in line]
    calls = []
    for path in {line.split(maxsplit=5)[-1] for line in mapped}:
        library = ctypes.CDLL(path) if Path(path).name.startswith("liblttng-ust") else None
        begin = next((b for b in ("lttng_ust_", "ust_") if hasattr(library, f"{b}before_fork")), "")
        if begin:
            calls.append(lambda moment, of=library, begin=begin: getattr(of, begin + moment)(signals))
    return calls[-1] if calls else lambda moment: None


def become(request: Mapping[str, Any], descriptors: Sequence[int]) -> int:
    """Be the node that is asked for; returns its exit code."""
    while os.getppid() != request["parent"]:  # the process between has not ended yet
        time.sleep(0.001)
    os.setsid()
    os.chdir(request["folder"])
    moved = [fcntl.fcntl(descriptor, fcntl.F_DUPFD, FIRST_FREE) for descriptor in descriptors]
    for descriptor in descriptors:
        os.close(descriptor)
    for source, target in zip(moved, request["descriptors"]):
        os.dup2(source, target)
        os.close(source)
    os.environ.clear()
    os.environ.update(request["variables"])
    if request["module"] == OWN:
        return run_own(request["arguments"])
    own = importlib.import_module(request["module"])
    if request["module"].startswith(PACKAGE):
        sys.path[0] = request["folder"]
    sys.argv[:] = [str(own.__file__), *request["arguments"]]
    importlib.invalidate_caches()
    return int(own.main())


def run_own(arguments: list[str]) -> int:
    """Code or a script of a test, as Python starts it: its folder, arguments and file; a SystemExit goes through."""
    first, *rest = arguments
    importlib.invalidate_caches()
    if first == "-c":
        sys.path[0], sys.argv[:] = "", ["-c", *rest[1:]]
        exec(compile(rest[0], "<string>", "exec"), {"__name__": "__main__"})
        return 0
    sys.path[0], sys.argv[:] = str(Path(first).parent), [first, *rest]
    runpy.run_path(first, run_name="__main__")
    return 0


if __name__ == "__main__":
    with contextlib.suppress(KeyboardInterrupt):
        sys.exit(serve(socket.socket(fileno=int(sys.argv[1]))))
