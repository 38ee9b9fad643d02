"""Random uncertain systems for the unit tests."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from lftkit import Port, RealParameter, System

MakeSystem = Callable[..., System]


def random_system(
    rng: np.random.Generator,
    states: int = 4,
    inputs: dict[str, int] | None = None,
    outputs: dict[str, int] | None = None,
    channels: tuple[str, ...] = ("k", "k", "m"),
) -> System:
    """Stable random LFT whose parameters have nominal values and lopsided ranges."""
    ins = tuple(Port(n, s) for n, s in (inputs or {"u": 2, "w": 1}).items())
    outs = tuple(Port(n, s) for n, s in (outputs or {"y": 2, "z": 1}).items())
    q, m, p = len(channels), sum(x.size for x in ins), sum(x.size for x in outs)
    A = rng.standard_normal((states, states)) - 4.0 * np.eye(states)
    B, C = rng.standard_normal((states, q + m)), rng.standard_normal((q + p, states))
    D = 0.2 * rng.standard_normal((q + p, q + m))
    parameters = tuple(RealParameter(n, 0.5, 0.2, 1.4) for n in dict.fromkeys(channels))
    return System(A, B, C, D, ins, outs, channels=channels, elements=parameters)


@pytest.fixture
def make() -> MakeSystem:
    return random_system
