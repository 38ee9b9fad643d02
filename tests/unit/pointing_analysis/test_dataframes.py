"""Topics as pandas and xarray objects keep values, times and units."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pointing_analysis.indices.synthetic import write_bag
from pointing_analysis.read.dataframes import to_pandas, to_xarray
from pointing_analysis.read.run import Run
from pointing_analysis.read.topic import Topic


@pytest.fixture
def topic(tmp_path: Path) -> Topic:
    values = np.random.default_rng(0).standard_normal((50, 6))
    return Run.open(write_bag(tmp_path / "bag", {"m1/accel": values}))["m1/accel"]


def test_pandas(topic: Topic) -> None:
    pytest.importorskip("pandas")
    frame = to_pandas(topic)
    assert np.array_equal(frame.to_numpy(), topic.values)
    assert list(frame.columns)[3] == "angular.x"
    assert frame.attrs["unit"] == "m/s2, rad/s2"
    assert np.array_equal(frame.index.asi8, topic.stamp)


def test_xarray(topic: Topic) -> None:
    pytest.importorskip("xarray")
    array = to_xarray(topic)
    assert float(array.sel(component="linear.y")[7]) == topic.values[7, 1]
    assert np.allclose(array["time"], 1e-3 * np.arange(50))
    assert array.attrs["units"] == topic.unit
