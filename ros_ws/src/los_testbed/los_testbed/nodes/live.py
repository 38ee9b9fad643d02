"""Live node: the topics of a run for viewers, by Foxglove's protocol and as a page, with lower priority than the loop.

In real time its subscriptions are best effort: a slow viewer or node causes no retransmission.
"""

from __future__ import annotations

import argparse
import asyncio
import concurrent.futures
import contextlib
import os
import sys
import time
from collections.abc import Sequence
from typing import Any

from rclpy.node import Node

from lftkit.errors import InputError
from los_testbed.bags.cdr import stamp_of
from los_testbed.config.topics import DIAGNOSTICS, DIAGNOSTICS_TOPIC, OWN_DIAGNOSTICS
from los_testbed.live.access import certificate
from los_testbed.live.foxglove_controls import FoxgloveControls
from los_testbed.live.foxglove_server import FoxgloveServer
from los_testbed.live.frames import ViewerFrames
from los_testbed.live.page_server import PageServer
from los_testbed.nodes.remote_control import RemoteControl
from los_testbed.nodes.support.node_context import NodeContext, run_node
from los_testbed.nodes.support.track import merge, report_tracks, topic_tracks
from los_testbed.parts.run_parts import RunParts
from los_testbed.run.loop.scheduling import prefer
from los_testbed.run.processes.viewers import Live

DEPTH = 1000
PERIOD_S = 0.02
NICE = -10
"""Niceness: viewers precede other programs in the time that the loop leaves of two processors."""
SERVICE_S = 0.05
LOOK_NS = 20_000_000
LIFE_CYCLE = ("activate", "deactivate")
TRIGGERS = ("start", "stop", "reset")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the node; returns the exit code."""
    words = sys.argv[1:] if arguments is None else list(arguments)
    parser = argparse.ArgumentParser(prog="live", description=__doc__)
    parser.add_argument("--host", default="127.0.0.1", help="address to listen on")
    parser.add_argument(
        "--port", type=int, default=8765, help="port of Foxglove's protocol; the page has the next port"
    )
    parser.add_argument("--origin", action="append", default=[], help="origin whose pages may connect; repeatable")
    parser.add_argument(
        "--topic", action="append", default=[], help="topic served to viewers; repeatable; default: all"
    )
    parser.add_argument("--tls-cert", default="", help="certificate (PEM)")
    parser.add_argument("--tls-key", default="", help="its private key (PEM)")
    options, _ = parser.parse_known_args(words[: words.index("--ros-args")] if "--ros-args" in words else words)

    live = Live(
        options.host,
        options.port,
        origins=tuple(options.origin),
        topics=tuple(options.topic),
        tls_cert=options.tls_cert,
        tls_key=options.tls_key,
    )

    async def serve(context: NodeContext) -> int:
        return await LiveNode(context, live).run()

    return run_node("live", words, lambda context: asyncio.run(serve(context)))


class LiveNode:
    """Passes new messages to the servers every 20 ms; created inside the event loop.

    Parameters
    ----------
    context : NodeContext
        The node.
    live : Live
        Where to listen, whom to serve, with which topics.
    """

    def __init__(self, context: NodeContext, live: Live) -> None:
        config, node = context.config, context.node
        self.context = context
        if config.priority:
            prefer(NICE)
        parts = RunParts(config)
        self._topics = parts.topics
        self.tracks = topic_tracks(context, DEPTH, reliable=config.mode == "lockstep", topics=self._topics)
        self._served = set(live.topics) or {*(topic.name for topic in self._topics), OWN_DIAGNOSTICS}
        self._from_plant = [track for track, topic in zip(self.tracks, self._topics) if topic.publisher == "plant"]
        self.reports = report_tracks(context)
        self._simulated = config.mode == "lockstep"
        self._next_look = 0
        tls, host = certificate(live.tls_cert or None, live.tls_key or None), live.host
        named = zip(self.tracks, self._topics)
        channels = {t.path: topic.type_name for t, topic in named if topic.name in self._served}
        if OWN_DIAGNOSTICS in self._served:
            channels[DIAGNOSTICS_TOPIC] = DIAGNOSTICS
        window = parts.star_camera.camera.window if parts.star_camera is not None else 0
        self.frames = ViewerFrames(config, parts.basis.authority, parts.telescope.requirements, window)
        self.page = PageServer(host, live.page_port, self.frames.next, self._act, tls)
        controls = FoxgloveControls(config.namespace, self.frames.settings, self._act_and_wait, self.page.token)
        self.foxglove = FoxgloveServer(channels, host, live.port, live.origins, tls, controls)
        # one request at a time, by a node of its own: this one's executor answers requests to it
        self._user = Node(f"live_control_{os.getpid()}", context=node.context)
        self._remote = RemoteControl(self._user, config.namespace)
        self._worker = concurrent.futures.ThreadPoolExecutor(1)
        address, safe = f"[{host}]" if ":" in host else host, "s" if tls else ""
        context.event(
            "live",
            foxglove=f"ws{safe}://{address}:{self.foxglove.port}",
            page=f"http{safe}://{address}:{self.page.port}/#token={self.page.token}",
        )

    async def run(self) -> int:
        """Serve until a signal comes."""
        context, next_service = self.context, 0.0
        asyncio.get_running_loop().set_default_executor(self._worker)
        context.event("ready")
        while not context.stop:
            self._drain()
            if (now := time.monotonic()) >= next_service:
                next_service = now + SERVICE_S
                context.service()
            await asyncio.sleep(PERIOD_S)
        await asyncio.sleep(PERIOD_S)
        self._drain()
        self.frames.over = True
        await self.page.stop()
        self.foxglove.stop()
        self._worker.shutdown(wait=False, cancel_futures=True)
        self._user.destroy_node()
        lost = {track.path: str(track.lost(track.first, track.last)) for track in self.tracks if track.first}
        context.event("done", statistics={f"lost_{path}": count for path, count in lost.items()})
        return 0

    def _drain(self) -> None:
        """Take all waiting messages."""
        tracks, now = self.tracks, time.monotonic_ns()
        for track in (*tracks, *self.reports.values()):
            track.drain()
        if now >= self._next_look or any(track.waiting for track in tracks):
            self._next_look = now + LOOK_NS
            for track in tracks:
                track.subscription.decide(now)
        if any(track.first for track in tracks) and all(track.held for track in self._from_plant):
            for track in tracks:
                track.begin_again()
                track.data, track.received, track.sent = [], [], []
            self.frames.clear()
        for track, topic in zip(tracks, self._topics):
            shown = zip(track.data, track.received) if topic.name in self._served else ()
            for data, received in shown:
                self.foxglove.send(track.path, data, stamp_of(data) if self._simulated else received)
                self.frames.put(topic.name, data)
            track.data, track.received, track.sent = [], [], []
        self._take_reports()

    def _take_reports(self) -> None:
        statuses = {name: report.status for name, report in self.reports.items() if report.data}
        merged = merge(list(self.reports.values()))
        if OWN_DIAGNOSTICS not in self._served:
            return
        for data, received in zip(merged.data, merged.received):
            self.foxglove.send(DIAGNOSTICS_TOPIC, data, received)
        for name, status in statuses.items():
            if status is not None:
                self.frames.note(name, status)
        if statuses:
            self.foxglove.tell_changes()

    def _act_and_wait(self, name: str, value: Any) -> None:
        """An action of Foxglove's protocol, whose server has threads of its own; one action at a time."""
        try:
            self._worker.submit(self._act, name, value).result()
        except concurrent.futures.CancelledError:
            raise RuntimeError("the run is over") from None

    def _act(self, name: str, value: Any) -> None:
        """An action of the page; in the worker's thread."""
        if name in LIFE_CYCLE:
            if value not in ("estimator", "controller"):
                raise InputError(f"node must be estimator or controller, got {value!r}")
            self._remote.turn(str(value), name)
        elif name in TRIGGERS:
            self._remote.trigger(name)
        else:
            self._remote.change(name, value)


if __name__ == "__main__":
    with contextlib.suppress(KeyboardInterrupt):
        sys.exit(main())
