"""What viewers cost the loop: missed ticks with and without two viewers, by turns in one run.

    python benchmarks/viewers.py --seconds 120 --json

One viewer reads all channels by Foxglove's protocol, the other one the page's data. They are connected for ten seconds
and away for ten seconds; the plant's reports, one a second, are counted to the turn that they lie in.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

from los_testbed.bags.diagnostics import read_diagnostics
from los_testbed.config.run_config import RunConfig
from los_testbed.run.processes.viewers import Live
from los_testbed.run.runner import Runner
from mcap.reader import make_reader
from tornado.websocket import websocket_connect

TURN_S = 10.0
MARGIN_NS = 1_500_000_000
"""Reports this soon after a change of turns are left out: they are about the second before."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=120.0, help="length of the run (default 120)")
    parser.add_argument("--domain", type=int, default=87, help="ROS domain (default 87)")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    args = parser.parse_args()
    load = os.getloadavg()[0]
    with tempfile.TemporaryDirectory(prefix="los_testbed_bench_") as folder:
        viewers = Viewers()
        config = RunConfig(duration=args.seconds, output=f"{folder}/bag", domain=args.domain, wait_for_recorder=True)
        results = Runner(config, live=Live(port=0, tell=viewers.start)).run()
        viewers.over = True
        assert results.bag is not None
        result = {**shares(results.bag, viewers.turns), "received": viewers.received, "load_before": load}
    print(json.dumps(result) if args.json else sentence(result))


class Viewers:
    """Two viewers that come and go, in a thread of their own."""

    def __init__(self) -> None:
        self.turns: list[tuple[int, bool]] = []
        self.received = 0
        self.over = False

    def start(self, foxglove: str, page: str) -> None:
        """Begin; called with the addresses of the server."""
        data = page.split("#")[0].replace("http", "ws") + "data"
        threading.Thread(target=lambda: asyncio.run(self._take_turns(foxglove, data)), daemon=True).start()

    async def _take_turns(self, foxglove: str, data: str) -> None:
        watching = False
        while not self.over:
            self.turns.append((time.time_ns(), watching))
            tasks = [asyncio.create_task(f) for f in (self._foxglove(foxglove), self._page(data))] if watching else []
            await asyncio.sleep(TURN_S)
            for task in tasks:
                task.cancel()
            watching = not watching

    async def _page(self, address: str) -> None:
        connection = await websocket_connect(address)
        try:
            while await connection.read_message() is not None:
                self.received += 1
        finally:
            connection.close()

    async def _foxglove(self, address: str) -> None:
        connection = await websocket_connect(address, subprotocols=["foxglove.sdk.v1"])
        try:
            while (message := await connection.read_message()) is not None:
                self.received += 1
                if isinstance(message, str) and (content := json.loads(message))["op"] == "advertise":
                    chosen = [{"id": c["id"], "channelId": c["id"]} for c in content["channels"]]
                    await connection.write_message(json.dumps({"op": "subscribe", "subscriptions": chosen}))
        finally:
            connection.close()


def shares(bag: Path, turns: list[tuple[int, bool]]) -> dict[str, Any]:
    """Missed ticks and periods of both kinds of turns."""
    counts = {True: [0, 0], False: [0, 0]}
    last: tuple[int, int] | None = None
    with next(bag.glob("*.mcap")).open("rb") as stream:
        for _, _, message in make_reader(stream).iter_messages(topics=["/diagnostics"]):
            for status in read_diagnostics(message.data)[1]:
                if not status.name.endswith(": plant") or "ticks" not in status.values:
                    continue
                now = (int(status.values["ticks"]), int(status.values["missed_ticks"]))
                earlier = [turn for turn in turns if turn[0] < message.log_time]
                if last is not None and earlier and message.log_time - earlier[-1][0] > MARGIN_NS:
                    counts[earlier[-1][1]][0] += now[1] - last[1]
                    counts[earlier[-1][1]][1] += now[0] - last[0]
                last = now
    result = {
        name: {"missed_ticks": counts[kind][0], "periods": counts[kind][1]}
        for name, kind in (("with_viewers", True), ("without", False))
    }
    rates = [result[name]["missed_ticks"] / max(result[name]["periods"], 1) for name in ("with_viewers", "without")]
    return {**result, "difference_points": 100 * (rates[0] - rates[1])}


def sentence(result: dict[str, Any]) -> str:
    """The result in words."""
    with_viewers, without = (result[name] for name in ("with_viewers", "without"))
    return (
        f"missed ticks with two viewers {with_viewers['missed_ticks']} of {with_viewers['periods']}, without "
        f"{without['missed_ticks']} of {without['periods']}: {result['difference_points']:+.3f} percentage points; "
        f"load average before {result['load_before']:.1f}"
    )


if __name__ == "__main__":
    main()
