"""The one reader of files and of .mat files: kinds, sizes and structures that are refused before they are read."""

from __future__ import annotations

import os
import socket
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import scipy.io.matlab
from scipy import io, sparse

from lftkit import read_mat
from lftkit.errors import InputError
from lftkit.support.input_files import InputFileError, check_file, read_bytes, read_text
from lftkit.support.input_limits import DEPTH, KINDS
from lftkit.support.mat_structure import check_mat
from lftkit.support.structured_text import load_json

READERS: list[Callable[[Path], object]] = [read_bytes, read_text, lambda path: check_file(path, 1000)]


@pytest.mark.timeout(60)
@pytest.mark.parametrize("reader", READERS)
def test_a_device_a_pipe_and_a_socket_are_refused_at_once(tmp_path: Path, reader: Callable[[Path], object]) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to("/dev/zero")
    with socket.socket(socket.AF_UNIX) as made:
        made.bind(str(tmp_path / "s"))
    for path in (Path("/dev/zero"), Path("/dev/null"), tmp_path / "pipe", tmp_path / "link", tmp_path / "s"):
        with pytest.raises(InputFileError, match="not an ordinary file"):
            reader(path)


@pytest.mark.parametrize("reader", READERS)
def test_a_folder_and_a_missing_file_are_the_errors_of_the_system(
    tmp_path: Path, reader: Callable[[Path], object]
) -> None:
    with pytest.raises(IsADirectoryError):
        reader(tmp_path)
    with pytest.raises(FileNotFoundError):
        reader(tmp_path / "none")


@pytest.mark.parametrize("reader", READERS)
def test_a_file_of_any_size_takes_no_memory(tmp_path: Path, reader: Callable[[Path], object]) -> None:
    with (tmp_path / "x").open("wb") as file:
        file.truncate(1 << 40)
    with pytest.raises(ValueError, match=r"cannot read .*x: larger than"):
        reader(tmp_path / "x")


def test_a_file_that_does_not_say_its_size_is_read_up_to_its_limit(tmp_path: Path) -> None:
    assert read_text("/proc/self/status").startswith("Name:")
    with pytest.raises(InputFileError, match="larger than 1e-05 MB"):
        read_bytes("/proc/self/status", 10)


def test_content_is_that_of_the_file(tmp_path: Path) -> None:
    for content in (b"", b"a\r\nb\rc\n", "µ\n".encode(), bytes(range(256)) * 9000):
        (tmp_path / "x").write_bytes(content)
        assert read_bytes(tmp_path / "x") == content
        if len(content) < 100:
            assert read_text(tmp_path / "x") == (tmp_path / "x").read_text("utf-8")
    with pytest.raises(UnicodeDecodeError):
        read_text(tmp_path / "x")


def test_json_of_any_depth_or_number_is_told() -> None:
    deep = "[" * 100_000
    for text in (deep + "]" * 100_000, deep, "[" * (DEPTH + 2) + "]" * (DEPTH + 2)):
        with pytest.raises(InputError, match=f"x must be nested at most {DEPTH} levels deep|must be JSON"):
            load_json(text, "x")
    assert load_json("[" * DEPTH + "]" * DEPTH, "x")
    with pytest.raises(InputError, match="at most 4000000 values"):
        load_json("[" + "0," * KINDS["JSON"].values + "0]", "x")
    with pytest.raises(InputError, match="integers of at most 300 digits"):
        load_json("[" + "9" * 400 + "]", "x")


DATA = Path(scipy.io.matlab.__file__).parent / "tests" / "data"
HEAD = b"MATLAB 5.0 MAT-file".ljust(124, b" ") + struct.pack("<H", 0x0100) + b"IM"


def element(kind: int, data: bytes) -> bytes:
    return struct.pack("<II", kind, len(data)) + data + bytes(-len(data) % 8)


def matrix(kind: int, shape: tuple[int, ...], *parts: bytes) -> bytes:
    flags = element(6, struct.pack("<II", kind, 0))
    inside = flags + element(5, struct.pack(f"<{len(shape)}i", *shape)) + element(1, b"x") + b"".join(parts)
    return element(14, inside)


@pytest.mark.parametrize("packed", [False, True])
def test_what_scipy_writes_passes(tmp_path: Path, packed: bool) -> None:
    cells = np.empty((2, 2), object)
    cells[0, 0], cells[0, 1], cells[1, 0], cells[1, 1] = np.eye(2), "text", {"a": 1.0}, np.zeros((0, 3))
    content = {
        "real": np.ones((2, 3, 4)),
        "complex": 1j * np.ones(3),
        "integers": np.arange(5, dtype=np.int8),
        "logical": np.array([True, False]),
        "texts": np.array(["a", "bcd"]),
        "unicode": "µrad",
        "cells": cells,
        "struct": {"a": 1, "b": {"c": [1, 2], "d": "x"}},
        "sparse": sparse.random(20, 30, 0.1, format="csc", random_state=1),
        "spc": sparse.csc_matrix(1j * np.eye(3)),
        "spb": sparse.csc_matrix(np.eye(3, dtype=bool)),
    }
    io.savemat(tmp_path / "x.mat", content, do_compression=packed)
    check_mat(tmp_path / "x.mat")
    io.savemat(tmp_path / "x4.mat", {"A": np.eye(3), "z": 1j * np.eye(2), "s": "text"}, format="4")
    check_mat(tmp_path / "x4.mat")


def test_whatever_scipy_reads_of_its_test_files_passes() -> None:
    for file in sorted(DATA.glob("*.mat")):
        try:
            io.loadmat(file)
        except Exception:
            continue
        check_mat(file)


def nested(depth: int) -> bytes:
    inner = matrix(6, (1, 1), element(9, struct.pack("<d", 1.0)))
    for _ in range(depth):
        inner = matrix(1, (1, 1), inner)
    return inner


def sparse_matrix(rows: list[int], starts: list[int], shape: tuple[int, int] = (2, 2)) -> bytes:
    parts = [element(5, struct.pack(f"<{len(values)}i", *values)) for values in (rows, starts)]
    return matrix(5, shape, *parts, element(9, struct.pack("<2d", 1.0, 2.0)))


BAD = {
    "an unknown data type": (matrix(6, (1, 1), element(8, bytes(8))), "data type must be one of .* got 8"),
    "a data type beyond all": (matrix(6, (1, 1), element(200, bytes(8))), "data type must be one of .* got 200"),
    "a class beyond all": (matrix(99, (1, 1)), "class of a matrix must be one that is known, got 99"),
    "cells in cells": (nested(5000), "nested at most 32 levels deep"),
    "too few numbers": (matrix(6, (1 << 20, 1 << 10), element(9, bytes(8))), "a matrix of 1073741824 numbers"),
    "a row beyond the matrix": (sparse_matrix([0, 9], [0, 1, 2]), "rows of a sparse matrix must be of 2"),
    "columns beyond the values": (sparse_matrix([0, 1], [0, 1, 90]), "columns of a sparse matrix must begin in order"),
    "cells without number": (matrix(1, (1 << 20, 1 << 20)), "at most 1000000 cells"),
    "elements without fields": (
        matrix(2, (1 << 20, 1 << 20), element(5, struct.pack("<i", 8)), element(1, b"")),
        "at most 1000000 cells",
    ),
    "names of no length": (
        matrix(2, (1, 1), element(5, struct.pack("<i", 0)), element(1, b"ab")),
        "names of fields must have one length",
    ),
    "negative sizes": (matrix(6, (-1, 1), element(9, bytes(8))), "two or more dimensions of 0 or more"),
    "a cut": (nested(2)[:-20], "cut short|at most"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_ends_scipy_is_told(tmp_path: Path, name: str) -> None:
    content, message = BAD[name]
    (tmp_path / "x.mat").write_bytes(HEAD + content)
    with pytest.raises(InputError, match=message):
        check_mat(tmp_path / "x.mat")
    with pytest.raises(ValueError, match=r"must be a \.mat file of version 7.2 or older, got"):
        read_mat(tmp_path / "x.mat")
    whole = nested(3)
    (tmp_path / "x.mat").write_bytes(HEAD + whole)
    check_mat(tmp_path / "x.mat")
    io.loadmat(tmp_path / "x.mat")


def test_a_sparse_system_that_is_too_large_in_full_is_told(tmp_path: Path) -> None:
    A = sparse.csc_matrix((10**6, 10**6))
    content = {"A": A, "B": np.ones((1, 1)), "C": np.ones((1, 1)), "D": np.ones((1, 1)), "Ts": 1.0}
    io.savemat(tmp_path / "x.mat", content)
    with pytest.raises(ValueError, match="a sparse matrix must have at most 25000000 entries in full"):
        read_mat(tmp_path / "x.mat")


def test_a_name_that_no_file_can_have_is_a_mistake_of_who_gave_it() -> None:
    with pytest.raises(InputFileError, match="a name must have no null byte"):
        read_bytes("a\0b")
