"""Scheduling of a process: what is refused, the middleware's thread, a thread that never blocks; supervision."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys

import pytest
from los_testbed.run.loop.scheduling import enlarge_receive_buffers


def test_what_is_not_permitted_is_named_and_not_an_error():
    code = (
        "import os, sys, ctypes\n"
        "from los_testbed.run.loop import scheduling\n"
        "def refuse(*a): raise PermissionError('no')\n"
        "os.sched_setscheduler = refuse\n"
        "class NoLock:\n"
        "    def mlockall(self, flags): return -1\n"
        "ctypes.CDLL = lambda *a, **k: NoLock()\n"
        "print(scheduling.become_real_time(80, 0))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=600)
    assert done.stdout.strip() == "['real-time scheduling', 'locked memory']"


def test_the_resending_thread_has_a_lower_priority_than_the_other_threads():
    """At the same priority, on the same processor, a polling thread would block the others of its process."""
    code = (
        "import os, threading\n"
        "from los_testbed.run.loop.scheduling import become_real_time\n"
        "def work():\n"
        "    with open('/proc/thread-self/comm', 'w') as name:\n"
        "        name.write('dds.asyn.0.0')\n"
        "    named.set()\n"
        "    threading.Event().wait()\n"
        "named = threading.Event()\n"
        "thread = threading.Thread(target=work, daemon=True); thread.start(); named.wait()\n"
        "refused = become_real_time(70)\n"
        "print(refused, os.sched_getparam(0).sched_priority, os.sched_getparam(thread.native_id).sched_priority)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=600)
    if "real-time scheduling" in done.stdout:
        pytest.skip("real time is not permitted here")
    assert done.stdout.split("]")[1].split() == ["70", "69"]


def code_in_real_time(script):
    """Exit code of a process that runs `script` at real-time priority; skips the test where that is not permitted."""
    begin = (
        "import sys; from los_testbed.run.loop.scheduling import become_real_time\n"
        "if 'real-time scheduling' in become_real_time(1): sys.exit(77)\n"
    )
    code = subprocess.run([sys.executable, "-c", begin + script], capture_output=True, timeout=600).returncode
    if code == 77:
        pytest.skip("real-time scheduling is not permitted here")
    return code


def test_a_real_time_process_that_never_pauses_is_ended_by_the_kernel():
    """Nobody of lower priority on its processor could end it."""
    assert code_in_real_time("while True: pass") == -signal.SIGXCPU


def test_a_loop_that_is_late_at_every_tick_is_not_ended_by_the_kernel():
    """On a machine that is too slow for the plant no deadline is waited for; its ticks count as missed."""
    script = (
        "import time; from los_testbed.run.loop.scheduling import MAX_BUSY_S\n"
        "from los_testbed.run.loop.tick_clock import TickClock\n"
        "clock = TickClock(1_000_000); clock.begin(time.monotonic_ns()); begin = time.process_time()\n"
        "while time.process_time() < begin + 1.5 * MAX_BUSY_S:\n"
        "    end = time.monotonic_ns() + 1_500_000\n"
        "    while time.monotonic_ns() < end: pass\n"
        "    clock.wait()\n"
        "    clock.resume_at(clock.present())\n"
    )
    assert code_in_real_time(script) == 0


@pytest.mark.further
def test_memory_that_takes_long_to_lock_is_locked_before_the_limit_holds():
    """As the first time on a virtual machine: the kernel must not take it for a process that never pauses."""
    script = (
        "import os, time; from los_testbed.run.loop import scheduling\n"
        "class Library:\n"
        "    def mlockall(self, flags):\n"
        "        while time.process_time() < 1.5 + scheduling.MAX_BUSY_S:\n"
        "            pass\n"
        "        print('locked at', os.sched_getscheduler(0) == os.SCHED_FIFO)\n"
        "        return 0\n"
        "scheduling.ctypes.CDLL = lambda *_, **__: Library()\n"
        "print(scheduling.become_real_time(1))\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, timeout=600)
    assert "locked at False" in done.stdout and "locked memory" not in done.stdout


@pytest.mark.parametrize(("before", "code"), [(True, -signal.SIGTERM), (False, 7)])
def test_a_process_ends_whose_parent_was_gone_before_it_asked_to_end_with_it(before, code):
    """The runner may be killed while its nodes import their modules."""
    number = "os.getppid()" + " + 1" * before
    script = (
        "import os, sys; from los_testbed.run.loop.scheduling import end_with_parent\n"
        f"end_with_parent({number})\n"
        "sys.exit(7)"
    )
    assert subprocess.run([sys.executable, "-c", script], timeout=600).returncode == code


def test_receive_buffers_of_udp_sockets_are_enlarged_and_others_left_alone():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as datagrams, socket.socket() as stream:
        datagrams.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 10_000)
        before = stream.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
        assert enlarge_receive_buffers(100_000) >= 1
        assert datagrams.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) >= 100_000
        assert stream.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) == before


CODE = """
import os, sys
from pathlib import Path
from los_testbed.run.supervision import supervise
from los_testbed.run.results import RunError
try:
    supervise(["plant my:Plant"], Path("none"))
except RunError as error:
    sys.exit(f"RunError: {error}")
if os.fork() == 0:  # a worker of the user's code, until the test has seen the end of the others
    os.closerange(0, 3)
    os.read(int(sys.argv[1]), 1)
    os._exit(0)
{end}
"""


def ended(end: str) -> tuple[int, str]:
    """Exit code, and what was said, of a run whose code of the user leaves a process behind, while that one lives."""
    reading, writing = os.pipe()
    try:
        command = [sys.executable, "-c", CODE.replace("{end}", end), str(reading)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=600, pass_fds=[reading])
    finally:
        os.close(writing)
        os.close(reading)
    return done.returncode, done.stderr


def test_a_process_that_is_left_behind_is_not_waited_for() -> None:
    code, said = ended("os._exit(0)")
    assert code == 1 and "ended in user code (exit code 0): plant my:Plant" in said


def test_nor_is_it_after_an_end_in_order() -> None:
    assert ended("sys.exit(7)")[0] == 7
