"""Topics as pandas or xarray objects, for notebooks; neither package is needed for anything else."""

from __future__ import annotations

import importlib
from typing import Any

from lftkit.errors import InputError
from pointing_analysis.read.topic import Topic


def _package(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError:
        raise InputError(f"{name} must be installed: pip install 'los-testbed[dataframes]'") from None


def to_pandas(topic: Topic) -> Any:
    """Topic as a ``pandas.DataFrame`` indexed by its stamps (UTC); the unit is in ``attrs["unit"]``.

    Raises
    ------
    ValueError
        pandas is not installed.
    """
    pandas = _package("pandas")
    index = pandas.DatetimeIndex(topic.stamp.astype("datetime64[ns]"), name="stamp")
    frame = pandas.DataFrame(topic.values, index=index, columns=list(topic.columns), copy=True)
    frame.attrs = {"topic": topic.name, "unit": topic.unit}
    return frame


def to_xarray(topic: Topic) -> Any:
    """Topic as an ``xarray.DataArray`` over seconds and components; the unit is in ``attrs["units"]``.

    Raises
    ------
    ValueError
        xarray is not installed.
    """
    xarray = _package("xarray")
    return xarray.DataArray(
        topic.values.copy(),
        dims=("time", "component"),
        coords={"time": ("time", topic.time, {"units": "s"}), "component": list(topic.columns)},
        name=topic.name,
        attrs={"units": topic.unit},
    )
