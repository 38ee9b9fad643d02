"""Exclusive resources of a run on this machine: domain and namespace, an unused domain, the path of its bag."""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import platform
import socket
import tempfile
from collections.abc import Iterator
from pathlib import Path

from lftkit.errors import InputError

MAX_DOMAIN = 101
"""Above it the ports of a domain may be those that the system gives to any program."""

PORT_BASE, DOMAIN_GAIN, FIRST_PARTICIPANT, PARTICIPANT_GAIN = 7400, 250, 10, 2
"""Ports of DDS: base, step from domain to domain, the first participant's unicast discovery, step to the next one's."""

PARTICIPANTS = 32
"""Participants checked per domain: nodes may still run after the first one has ended."""

_NAMES_OF_THE_KERNEL = platform.system() == "Linux"
"""Elsewhere a lock of a file in the temporary folder, which the end of the process frees, too."""


@contextlib.contextmanager
def domain_lock(domain: int, namespace: str) -> Iterator[None]:
    """Hold a namespace of a domain for one run on this machine.

    Raises
    ------
    ValueError
        Another run holds it.
    """
    what = f"a ROS domain without another run in namespace {namespace} on this machine"
    with _held(f"domain_{domain}{namespace}", f"--domain must be {what}, got {domain}"):
        yield


@contextlib.contextmanager
def output_lock(bag: Path) -> Iterator[None]:
    """Hold the place of a bag for one run on this machine: it is made only when the first message comes.

    Raises
    ------
    ValueError
        Another run holds it.
    """
    place = hashlib.blake2b(str(bag.resolve()).encode(), digest_size=16).hexdigest()
    with _held(f"bag_{place}", f"--output must not be in use by another run, got {bag}"):
        yield


@contextlib.contextmanager
def _held(name: str, refusal: str) -> Iterator[None]:
    """Hold a name of the kernel, which frees it when the process ends, however it ends."""
    if not _NAMES_OF_THE_KERNEL:
        with open(Path(tempfile.gettempdir(), f"los_testbed_{name.replace('/', '_')}.lock"), "ab") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                raise InputError(refusal) from None
            yield
        return
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as held:
        try:
            held.bind(f"\0los_testbed_{name}")
        except OSError:
            raise InputError(refusal) from None
        yield


@contextlib.contextmanager
def free_domain(namespace: str) -> Iterator[int]:
    """Hold the smallest domain, 0 to 101, in which no participant of this machine listens and no run has the namespace.

    Raises
    ------
    ValueError
        All of them are in use.
    """
    with contextlib.ExitStack() as held:
        for domain in range(MAX_DOMAIN + 1):
            with contextlib.suppress(OSError, ValueError), contextlib.ExitStack() as tried:
                tried.enter_context(domain_lock(domain, namespace))
                _refuse_participants(domain)
                held.enter_context(tried.pop_all())
                break
        else:
            raise InputError(
                f"a ROS domain from 0 to {MAX_DOMAIN} must be free on this machine, got participants in all"
            )
        yield domain


def require_participants(domain: int, namespace: str) -> None:
    """Refuse a domain without a run on this machine: no participant listens, and no run holds the namespace.

    Raises
    ------
    ValueError
        There is neither.
    """
    try:
        _refuse_participants(domain)
        with domain_lock(domain, namespace):
            pass
    except (OSError, ValueError):
        return
    raise InputError(f"--domain must be a ROS domain with a run on this machine, got {domain} without any node")


def _refuse_participants(domain: int) -> None:
    """Raise OSError where a participant of this machine listens."""
    first = PORT_BASE + DOMAIN_GAIN * domain + FIRST_PARTICIPANT
    for participant in range(PARTICIPANTS):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("", first + PARTICIPANT_GAIN * participant))
