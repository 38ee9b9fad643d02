"""Worst points that a search found (:mod:`los_design.search.worst_case_search`), and their file."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lftkit.arrays import ComplexArray
from lftkit.errors import InputError
from lftkit.support.atomic_output import write_text
from lftkit.support.input_files import read_text
from lftkit.support.structured_text import load_json
from los_design.files import WORST_POINTS
from titop_plant.telescope.telescope import Telescope

WHEEL_CHANNELS = ("force x", "force y", "force z", "torque x", "torque y")


@dataclass(frozen=True)
class WorstPoint:
    """Largest value found for one metric of one stage, in one band.

    Parameters
    ----------
    stage, requirement : str
    gamma : float
        Value over the limit, by the periodic solution; of a sensitivity by the frequency response.
    limit : float
        rad, N, or 1.
    omega : float
        rad/s.
    parameters : mapping of str to float
    disturbance : ndarray, complex
        Unit vector of the inputs: normalised disturbances (more than 8), or signals added to the commands.
    direction : ndarray, complex
        Unit vector of the outputs that they cause: **response = gamma limit direction**.
    """

    stage: str
    requirement: str
    gamma: float
    limit: float
    omega: float
    parameters: Mapping[str, float]
    disturbance: ComplexArray
    direction: ComplexArray

    def channel(self, telescope: Telescope) -> str:
        """Name of the input of a telescope with the largest part of the disturbance."""
        k = int(np.abs(self.disturbance).argmax())
        if len(self.disturbance) != telescope.channels or self.requirement.startswith("sensitivity"):
            return f"command {k + 1}"
        wheel, of_wheel = divmod(k, len(WHEEL_CHANNELS))
        wheels = telescope.turning_wheels
        if wheel >= len(wheels):
            return f"solar array drive {k - len(WHEEL_CHANNELS) * len(wheels) + 1}"
        return f"wheel {wheels[wheel] + 1}, {WHEEL_CHANNELS[of_wheel]}"

    def to_mapping(self) -> dict[str, Any]:
        """For JSON."""
        vectors = {"disturbance": self.disturbance, "direction": self.direction}
        return {
            "gamma": self.gamma,
            "limit": self.limit,
            "omega": self.omega,
            "parameters": dict(self.parameters),
            **{name: {"real": v.real.tolist(), "imag": v.imag.tolist()} for name, v in vectors.items()},
        }

    @classmethod
    def from_mapping(cls, stage: str, requirement: str, values: Mapping[str, Any]) -> WorstPoint:
        """As :meth:`to_mapping` makes it."""
        disturbance, direction = (
            np.array(values[name]["real"]) + 1j * np.array(values[name]["imag"])
            for name in ("disturbance", "direction")
        )
        gamma, limit, omega = (float(values[name]) for name in ("gamma", "limit", "omega"))
        return cls(stage, requirement, gamma, limit, omega, dict(values["parameters"]), disturbance, direction)


def worst_of(by_requirement: Mapping[str, Sequence[WorstPoint]]) -> dict[str, WorstPoint]:
    """The worst point of each metric; ``RPE`` is the worse of slow and fast tones."""
    worst = {name: points[0] for name, points in by_requirement.items() if points}
    tones = [worst[name] for name in ("slow", "fast") if name in worst]
    if tones:
        worst["RPE"] = max(tones, key=lambda p: p.gamma)
    return worst


def store_worst_points(
    path: Path, points: Iterable[WorstPoint], basis: Mapping[str, str], adversarial: Sequence[Mapping[str, float]] = ()
) -> None:
    """Write points as JSON by stage and metric; `basis` says for which parameters and controllers they hold.

    Parameters
    ----------
    adversarial : sequence of mapping
        Parameters at which a verification looks, too: worst points of all frequency bands.
    """
    stages: dict[str, dict[str, Any]] = {}
    for point in points:
        stages.setdefault(point.stage, {})[point.requirement] = point.to_mapping()
    content = {**basis, "stages": stages, "adversarial": [dict(values) for values in adversarial]}
    write_text(path, json.dumps(content, indent=1) + "\n")


def load_worst_points(folder: Path | None = None) -> dict[str, dict[str, WorstPoint]]:
    """Worst points by stage and metric: of a folder of designs, or of the stored designs.

    Raises
    ------
    ValueError
        The file is missing, or of another form.
    """
    with _named(folder) as content:
        return {
            stage: {name: WorstPoint.from_mapping(stage, name, values) for name, values in table.items()}
            for stage, table in content["stages"].items()
        }


def load_adversarial(folder: Path | None = None) -> list[dict[str, float]]:
    """Parameters at which a verification looks: of a folder of designs, or of the stored designs.

    Raises
    ------
    ValueError
        The file is missing, or of another form.
    """
    with _named(folder) as content:
        points = content.get("adversarial", [])
        return [{str(name): float(value) for name, value in values.items()} for values in points]


@contextmanager
def _named(folder: Path | None) -> Iterator[dict[str, Any]]:
    """Content of a file of worst points; whatever is wrong with it is told with its path."""
    path = (folder or Path(__file__).parent) / WORST_POINTS
    if not path.exists():
        raise InputError(f"{path} must exist: it is made by `los-testbed design all`")
    try:
        yield load_json(read_text(path), path)
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise InputError(f"{path} must hold worst points as made by `los-testbed design all`, got {error!r}") from None
