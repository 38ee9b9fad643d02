"""A file that names two units or two rates of the same samples is refused; so is a rate that its times contradict."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pointing_analysis.indices.errors import RAD_PER_MAS
from pointing_analysis.read.los_source import open_los
from pointing_analysis.read.series import series

N = 4000


def noise(n: int = N) -> np.ndarray[Any, Any]:
    return np.random.default_rng(5).standard_normal((n, 2))


def csv(path: Path, comments: str, names: str) -> Path:
    rows = "\n".join(f"{k / 1000:.3f},{x:.6f},{y:.6f}" for k, (x, y) in enumerate(noise()))
    path.write_text(f"{comments}{names}\n{rows}\n")
    return path


def test_two_units_of_an_array(tmp_path: Path) -> None:
    np.savez(tmp_path / "los.npz", los_mas=noise(), los_mas_unit="arcsec", fs=1000.0)
    with pytest.raises(ValueError, match="must be one, got arcsec and mas"):
        open_los(tmp_path / "los.npz", unit=None)


def test_the_unit_in_the_name_of_an_array_counts(tmp_path: Path) -> None:
    np.savez(tmp_path / "los.npz", los_mas=noise(), fs=1000.0)
    found = open_los(tmp_path / "los.npz", unit=None)
    assert found.parameters["unit_of_the_samples"] == "mas"


def test_two_units_of_a_dataset(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "los.h5", "w") as file:
        file["los"] = noise()
        file["los"].attrs.update({"unit": "mas", "units": "arcsec", "fs": 1000.0})
    with pytest.raises(ValueError, match=r"must be one, got mas and arcsec|must be one, got arcsec and mas"):
        open_los(tmp_path / "los.h5", unit=None)


def test_the_rate_of_another_dataset_is_not_that_of_the_line_of_sight(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "los.h5", "w") as file:
        file["a"], file["los"], file["z"] = noise(77), noise(), noise(88)
        for name, rate in (("a", 50.0), ("los", 1000.0), ("z", 4000.0)):
            file[name].attrs["fs"] = rate
    found = open_los(tmp_path / "los.h5", unit="mas", los="los")
    assert found.parameters["sampling_rate_hz"] == pytest.approx(1000.0)


@pytest.mark.parametrize("given", [None, 500.0])
def test_two_rates_of_the_samples_are_refused(tmp_path: Path, given: float | None) -> None:
    np.savez(tmp_path / "los.npz", los=noise(), fs=1000.0, dt=0.002)
    with pytest.raises(ValueError, match="must be one, got 500 and 1000 Hz"):
        open_los(tmp_path / "los.npz", unit="mas", rate=given)


def test_a_given_rate_against_that_of_the_file(tmp_path: Path) -> None:
    np.savez(tmp_path / "los.npz", los=noise(), fs=1000.0, Ts=0.001)
    with pytest.raises(ValueError, match="rate must be 1000 Hz, stated in the file"):
        open_los(tmp_path / "los.npz", unit="mas", rate=999.0)


def test_times_decide_over_the_rate_of_the_file_and_it_is_said(tmp_path: Path) -> None:
    np.savez(tmp_path / "los.npz", t=np.arange(N) / 1000, los=noise(), fs=500.0)
    found = open_los(tmp_path / "los.npz", unit="mas")
    assert found.parameters["sampling_rate_hz"] == pytest.approx(1000.0)
    assert any("the file states 500 Hz" in problem for problem in found.problems)


@pytest.mark.parametrize("rate", [995.0, 999.5, 1000.2, 1005.0])
@pytest.mark.parametrize("jitter", [0.0, 5e-5])
def test_a_rate_that_the_times_contradict_is_refused(rate: float, jitter: float) -> None:
    """Before, samples that fell on the same tick were left out and counted as none lost."""
    t = np.arange(N) / 1000 + jitter * np.random.default_rng(6).standard_normal(N)
    with pytest.raises(ValueError, match=r"rate must match the samples, \S+ Hz by their times"):
        series(t, noise(), unit="mas", rate=rate)


def test_a_rate_within_half_a_sample_of_the_times_loses_none() -> None:
    found = series(np.arange(N) / 1000, noise(), unit="mas", rate=1000.1)
    assert len(found.topic) == N and not found.losses and np.all(np.diff(found.topic.stamp) > 0)


def test_two_units_in_the_name_of_the_time(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"unit of time_ms \(s\) must be one, got s and ms"):
        open_los(csv(tmp_path / "los.csv", "", "time_ms (s),x,y"), unit="mas")


def test_packed_values_are_unpacked(tmp_path: Path) -> None:
    """By the conventions of netCDF: value = stored * scale_factor + add_offset; _FillValue is no value."""
    h5py = pytest.importorskip("h5py")
    stored = (100 * noise()).round().astype(np.int16)
    stored[7] = -32768
    with h5py.File(tmp_path / "los.h5", "w") as file:
        file["los"] = stored
        attributes = {
            "units": "mas",
            "fs": 1000.0,
            "scale_factor": 0.01,
            "add_offset": 3.0,
            "_FillValue": np.int16(-32768),
        }
        file["los"].attrs.update(attributes)
    values = open_los(tmp_path / "los.h5", unit=None)["truth/los"].values / RAD_PER_MAS
    assert np.isnan(values[7]).all()
    np.testing.assert_allclose(np.delete(values, 7, 0), np.delete(0.01 * stored + 3.0, 7, 0), rtol=1e-12)


def test_whole_stamps_of_such_a_file_keep_their_digits(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "los.h5", "w") as file:
        file["time_ns"] = 1_700_000_000_123_456_789 + 10**6 * np.arange(N)
        file["time_ns"].attrs["_FillValue"] = np.int64(-1)
        file["los"] = noise()
    stamps = open_los(tmp_path / "los.h5", unit="mas", los="los")["truth/los"].stamp
    assert (np.diff(stamps) == 10**6).all()
