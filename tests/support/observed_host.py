"""Two hosts for the test of who hears a run: one runs the loop and watches its network card, one has a stranger.

    python observed_host.py run CONFIG.json DEVICE FOLDER       runs the loop, with a server for viewers; prints
                                                                packets, sockets, statistics
    python observed_host.py campaign DEVICE FOLDER              a campaign of two workers; prints packets, sockets
    python observed_host.py stranger ADDRESS DOMAIN FOLDER S    an ordinary rclpy node; prints what it heard and sent;
                                                                for S seconds if it hears nothing

The files ``running`` and ``left`` in FOLDER tell the other side how far each is. Both print one JSON object.
"""

from __future__ import annotations

import collections
import json
import os
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

OUTGOING = 4
EVERY_PROTOCOL = 3
IPV4, UDP = 0x0800, 17
SENT = 200
NODES = {"plant", "estimator", "controller", "recorder"}


class OutgoingPackets:
    """Counts what leaves by a network device, by kind, in a thread."""

    def __init__(self, device: str) -> None:
        self.counts: collections.Counter[str] = collections.Counter()
        self._socket = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(EVERY_PROTOCOL))
        self._socket.bind((device, 0))
        threading.Thread(target=self._count, daemon=True).start()

    def _count(self) -> None:
        while True:
            data, address = self._socket.recvfrom(2048)
            if address[2] == OUTGOING:
                protocol = int.from_bytes(data[12:14], "big")
                self.counts["udp" if protocol == IPV4 and data[23] == UDP else f"{protocol:04x}"] += 1


def local_addresses(process: str = "self") -> set[str]:
    """Addresses that sockets of a process's network namespace are bound to, as the kernel writes them (hexadecimal)."""
    found = set()
    for protocol in ("udp", "tcp", "udp6", "tcp6"):
        path = Path("/proc", process, "net", protocol)
        lines = path.read_text().splitlines()[1:] if path.exists() else []
        found |= {line.split()[1].rpartition(":")[0] for line in lines}
    return found


def run(config: str, device: str, folder: str) -> dict[str, object]:
    """Run until the stranger has left."""
    from los_testbed.config.run_config import RunConfig
    from los_testbed.run.processes.viewers import Live
    from los_testbed.run.runner import Runner
    from ros_runs import PLANT

    packets = OutgoingPackets(device)
    found: dict[str, object] = {}

    def progress(ticks: int) -> None:
        if ticks > 300 and not found:
            found["sockets"] = sorted(local_addresses())
            found["alone"] = dict(packets.counts)
            Path(folder, "running").touch()
        if "left" not in found and Path(folder, "left").exists():
            found["left"] = True  # once: a second interrupt would end the run at once
            raise KeyboardInterrupt

    values = json.loads(Path(config).read_text())
    addresses: list[str] = []
    live = Live(port=0, tell=lambda foxglove, page: addresses.extend([foxglove, page]))
    results = Runner(RunConfig.from_mapping(values), progress, {"plant": PLANT}, live=live).run()
    found["served"] = len(addresses)
    return {**found, "with_stranger": dict(packets.counts), "plant": results.statistics["plant"]}


def campaign(device: str, folder: str) -> dict[str, object]:
    """A campaign that computes in a process of its own."""
    packets, output = OutgoingPackets(device), Path(folder, "campaign")
    options = ["--samples=2", "--duration=1.1", "--loop=isolator", "--scenario=imbalance", "--workers=1"]
    command = [sys.executable, "-m", "los_testbed.cli.app", "campaign", *options, f"--output={output}"]
    sockets: set[str] = set()
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as process:
        while process.poll() is None:
            sockets |= local_addresses()
            time.sleep(0.1)
        assert process.stderr is not None
        errors = process.stderr.read()
    assert process.returncode == 0, errors
    return {"packets": dict(packets.counts), "sockets": sorted(sockets)}


def stranger(address: str, domain: str, folder: str, seconds: str) -> dict[str, object]:
    """Listen to the truth, send mirror commands beyond the limit, look at the graph."""
    while not Path(folder, "running").exists():
        time.sleep(0.05)
    os.environ.update(ROS_AUTOMATIC_DISCOVERY_RANGE="SUBNET", ROS_STATIC_PEERS=address, ROS_DOMAIN_ID=domain)
    import rclpy
    from geometry_msgs.msg import Vector3Stamped

    rclpy.init()
    node = rclpy.create_node("stranger")
    heard: list[object] = []
    node.create_subscription(Vector3Stamped, "/telescope/truth/los", heard.append, 100)
    commands = node.create_publisher(Vector3Stamped, "/telescope/fsm/command", 100)
    message = Vector3Stamped()
    message.vector.x = 5.3e-2
    sent, start, limit = 0, time.monotonic(), float(seconds)
    nodes: set[str] = set()
    while sent < SENT or not ((heard and nodes >= NODES) or time.monotonic() > start + limit):
        rclpy.spin_once(node, timeout_sec=0.005)
        if sent < SENT and (heard or time.monotonic() > start + limit / 2):
            commands.publish(message)
            sent += 1
        if sent % 20 == 0:
            nodes = {name for name, _ in node.get_node_names_and_namespaces()} - {"stranger"}
    time.sleep(0.2)  # the last commands arrive
    Path(folder, "left").touch()
    return {"heard": len(heard), "sent": sent, "nodes": sorted(nodes)}


if __name__ == "__main__":
    json.dump({"run": run, "campaign": campaign, "stranger": stranger}[sys.argv[1]](*sys.argv[2:]), sys.stdout)
