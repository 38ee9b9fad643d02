"""Frames of the page: new data of a run for each viewer."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from los_testbed.bags.cdr import codec_for
from los_testbed.bags.diagnostics import Status
from los_testbed.config.run_config import RunConfig
from los_testbed.config.run_settings import with_scenario
from los_testbed.config.topics import IMAGE_NAME, image_topic
from los_testbed.live.history import URAD, History, indices
from pointing_analysis.requirements.requirement import Requirement

COMPUTED_S = 0.5
"""Time from one computation of indices and spectrum to the next."""

IMAGE_NS = 200_000_000
"""Time from one image of the camera to the next [ns]: 5 a second."""

CHANGING = {"loop": "controller", "noise": "plant", "disturbance": "plant", "camera_dropout": "plant"}
"""Settings that the page shows, and the node whose report names their changes."""


class ViewerFrames:
    """State of a run, and the next part for a viewer.

    Parameters
    ----------
    config : RunConfig
        The run.
    authority : sequence of float
        Largest mirror angle [rad] and force [N].
    requirements : sequence of Requirement
        Of the telescope.
    window : int
        Pixels along each axis of the camera's images; 0 without images.
    """

    def __init__(
        self,
        config: RunConfig,
        authority: Sequence[float],
        requirements: Sequence[Requirement] = (),
        window: int = 0,
    ) -> None:
        self._config = config
        self._limits = requirements
        self.history = History()
        self._window = window
        self._codec = codec_for(image_topic(window))
        self._counts, self._exposed = np.zeros(window**2), -1
        self.over = False
        self._run = 1
        self._nodes: dict[str, dict[str, Any]] = {}
        self._reports = 0
        self._computed = 0
        self._next = 0.0
        self._indices: list[dict[str, Any]] = []
        self._spectrum: dict[str, Any] = {}
        self._fixed = {
            "namespace": config.namespace,
            "mode": config.mode,
            "scenario": with_scenario(config).scenario,
            "duration": config.duration,
            "authority": {"fsm": authority[0] / URAD, "pma": authority[1]},
        }

    def clear(self) -> None:
        """Start of another run: the plant was reset or restarted."""
        self.history.clear()
        self._run += 1
        self._indices, self._spectrum, self._next = [], {}, 0.0
        self._exposed = -1

    def put(self, name: str, data: bytes) -> None:
        """Process a message of a topic by its relative name."""
        if name == IMAGE_NAME:
            self._exposed = self._codec.decode(data, self._counts)
        else:
            self.history.put(name, data)

    def note(self, name: str, status: Status) -> None:
        """Report of a node."""
        self._nodes[name] = {"level": status.level, "message": status.message, "values": status.values}
        self._reports += 1

    def settings(self) -> dict[str, Any]:
        """Settings in force: those of the start and the changes that the nodes report."""
        values = {name: getattr(self._config, name) for name in CHANGING}
        for name, node in CHANGING.items():
            changes = self._nodes.get(node, {}).get("values", {}).get("changes", "[]")
            for change in json.loads(changes):
                if change["name"] == name:
                    values[name] = change["value"]
        return values

    def next(self, seen: dict[str, int]) -> dict[str, Any]:
        """Frame of a viewer that has `seen` what this function noted in it; empty at first."""
        self._compute()
        settings = self.settings()
        if seen.get("run") != self._run:
            seen.update(run=self._run, tick=-1, computed=-1, image=-IMAGE_NS)
        frame: dict[str, Any] = {
            "run": self._run,
            "start": str(self.history.start),
            "tick": self.history.tick,
            "over": self.over,
            "stage": settings.pop("loop"),
            "settings": settings,
            "samples": self.history.samples(seen["tick"]),
        }
        seen["tick"] = self.history.tick
        if seen.get("computed") != self._computed:
            seen["computed"] = self._computed
            frame.update(indices=self._indices, spectrum=self._spectrum)
        if seen.get("reports") != self._reports:
            seen["reports"] = self._reports
            frame["nodes"] = self._nodes
        if self._exposed >= seen["image"] + IMAGE_NS:
            seen["image"] = self._exposed
            frame["image"] = {"window": self._window, "counts": self._counts.astype(int).tolist()}
        if "fixed" not in seen:
            seen["fixed"] = 1
            frame["fixed"] = self._fixed
        return frame

    def _compute(self) -> None:
        """Indices and spectrum, recomputed if a viewer requests a frame and the last ones are old."""
        now = time.monotonic()
        if now < self._next or self.history.tick < 0:
            return
        self._next = now + COMPUTED_S
        self._computed += 1
        self._indices = indices(self.history.recent(), str(self.settings()["loop"]), self._limits)
        self._spectrum = self.history.spectrum()
