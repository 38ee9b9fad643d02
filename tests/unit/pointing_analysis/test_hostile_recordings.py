"""Recordings that lead out of their folder, or stand for more than they hold."""

from __future__ import annotations

import builtins
import io
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pointing_analysis.image.fits_files import read_pupil
from pointing_analysis.indices.synthetic import write_bag
from pointing_analysis.read.mcap.bag_files import bag_files
from pointing_analysis.read.mcap.records import BagError
from pointing_analysis.read.messages.ros_definitions import locate, located, parse_definition, vectors
from pointing_analysis.read.run import Run
from pointing_analysis.read.tables.los_table import read_table


def test_no_link_in_the_folder_of_a_bag_is_followed(tmp_path: Path) -> None:
    write_bag(tmp_path / "bag", {"truth/los": np.ones((200, 2))})
    write_bag(tmp_path / "other", {"truth/los": np.zeros((100, 2))})
    (tmp_path / "bag" / "metadata.yaml").unlink()
    (tmp_path / "bag" / "link_1.mcap").symlink_to(next((tmp_path / "other").glob("*.mcap")))
    assert len(Run.open(tmp_path / "bag")["truth/los"]) == 200
    assert any("links" in problem and "link_1.mcap" in problem for problem in bag_files(tmp_path / "bag").problems)
    for file in (tmp_path / "bag").glob("bag*.mcap"):
        file.unlink()
    with pytest.raises(BagError, match="got links to files only"):
        bag_files(tmp_path / "bag")


def definition(width: int, depth: int) -> str:
    parts = ["\n".join(f"m/A{level + 1} f{i}" for i in range(width)) for level in range(depth)]
    parts = [parts[0], *(f"MSG: m/A{level}\n{text}" for level, text in enumerate(parts[1:], 1))]
    return ("\n" + "=" * 80 + "\n").join([*parts, f"MSG: m/A{depth}\nfloat64 x\nfloat64 y\n"])


def test_a_definition_that_stands_for_too_many_fields_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(BagError, match="at most 20000 fields"):
        vectors("m/msg/R", parse_definition("m/msg/R", definition(4, 10)))
    monkeypatch.setattr("pointing_analysis.read.messages.ros_definitions.MESSAGE_ELEMENTS", 10_000)
    with pytest.raises(BagError, match="at most 10000 elements"):
        locate("m/msg/R", parse_definition("m/msg/R", definition(30, 5)), "none", b"\0\1\0\0")


def test_one_walk_finds_what_a_walk_for_each_field_finds() -> None:
    types = parse_definition("m/msg/R", definition(3, 3))
    payload = b"\0\1\0\0" + struct.pack("<54d", *range(54))
    paths = {vector.path for vector in vectors("m/msg/R", types)}
    assert len(paths) == 27 and located("m/msg/R", types, payload) == paths
    assert located("m/msg/R", types, payload[:-16]) == paths - {"f2.f2.f2"}
    assert locate("m/msg/R", types, "f1.f0.f2", payload).numbers == ((4 + 16 * 11, "f8"), (12 + 16 * 11, "f8"))


def test_a_picture_of_any_number_of_pixels_is_refused_before_it_is_unpacked() -> None:
    fits = pytest.importorskip("astropy.io.fits")
    file = io.BytesIO()
    fits.CompImageHDU(np.zeros((50, 50), "float32")).writeto(file)
    large = file.getvalue().replace(b"ZNAXIS1 =                   50", b"ZNAXIS1 =              9999999")
    assert large != file.getvalue()
    with pytest.raises(ValueError, match="pictures must have at most 32000000 pixels together"):
        read_pupil(large, 1e-6)


def test_a_package_that_cannot_be_loaded_is_not_one_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A limit of memory shows so: the advice to install the package would be false."""
    (tmp_path / "x.h5").write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(100))
    real = builtins.__import__

    def fail(name: str, *arguments: Any, **keywords: Any) -> Any:
        if name == "h5py":
            raise ImportError("h5py.so: failed to map segment from shared object")
        return real(name, *arguments, **keywords)

    monkeypatch.setattr(builtins, "__import__", fail)
    with pytest.raises(ImportError, match="failed to map segment"):
        read_table(tmp_path / "x.h5")
