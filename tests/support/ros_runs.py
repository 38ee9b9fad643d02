"""Real runs with processes for tests: a private domain, the small telescope as plant."""

from __future__ import annotations

import hashlib
import os
import sys
from pathlib import Path

from los_testbed.config import RunConfig
from mcap.reader import make_reader
from simple_telescope import write_controllers

PLANT = [sys.executable, str(Path(__file__).with_name("simple_telescope.py"))]


def private_domain() -> int:
    """Domain that another test session on this machine hardly uses; above 101 ports may be taken."""
    return 10 + os.getpid() % 90


def config_for(folder: Path, **values: object) -> RunConfig:
    """Configuration of a run with the small telescope that writes to `folder`/bag."""
    base = {
        "duration": 2.0,
        "mode": "realtime",
        "output": str(folder / "bag"),
        "domain": private_domain(),
        "wait_for_recorder": True,
        "start_timeout": 20.0,
        **write_controllers(folder),
    }
    return RunConfig.from_mapping({**base, **values})


def topic_hashes(bag: Path) -> dict[str, tuple[int, str]]:
    """Number of messages and hash of all their bytes, topic by topic."""
    hashes: dict[str, tuple[int, hashlib._Hash]] = {}
    with next(bag.glob("*.mcap")).open("rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages(log_time_order=False):
            count, digest = hashes.get(channel.topic, (0, hashlib.sha256()))
            digest.update(message.data)
            hashes[channel.topic] = (count + 1, digest)
    return {topic: (count, digest.hexdigest()) for topic, (count, digest) in sorted(hashes.items())}
