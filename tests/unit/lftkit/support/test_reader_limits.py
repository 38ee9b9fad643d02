"""The one reader of files: ordinary files of a limited size; texts with structure of limited depth and number."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable
from pathlib import Path

import pytest

from lftkit.errors import InputError
from lftkit.support.input_files import InputFileError, check_file, read_bytes, read_text
from lftkit.support.input_limits import DEPTH, KINDS
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
