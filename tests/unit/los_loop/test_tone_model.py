"""Tones of one frequency are one in the model, also where rounding makes it two numbers."""

from __future__ import annotations

import numpy as np
import pytest
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.run_parts import RunParts


def model_of(speeds: tuple[float, ...]):  # type: ignore[no-untyped-def]
    base = RunConfig(mode="inprocess", loop="isolator", scenario="imbalance", wheel_speed=speeds, noise=False)
    return RunParts(base).tone_model()


def test_wheels_of_one_speed_but_for_rounding_have_the_tones_of_wheels_of_one_speed() -> None:
    """Phasors of one frequency add up; of tones of several frequencies the squares do."""
    speed = 200.0
    same = model_of((speed, speed, 250.0, -270.0))
    near = model_of((speed, np.nextafter(speed, np.inf), 250.0, -270.0))
    apart = model_of((speed, speed * 1.001, 250.0, -270.0))
    assert near.omega.size == same.omega.size < apart.omega.size
    np.testing.assert_allclose(near.omega, same.omega, rtol=1e-12)
    assert near.relative_error(0.02) == pytest.approx(same.relative_error(0.02), rel=1e-6)
    assert apart.relative_error(0.02) != pytest.approx(same.relative_error(0.02), rel=1e-4)
