"""What a file holds that a program does not read, by its first bytes: for the message that refuses it."""

from __future__ import annotations

import os
import zipfile
from pathlib import Path

HEAD = 512
"""Bytes at the beginning of a file by which its kind is told."""
MARKS = (
    (b"%PDF-", "a PDF document"),
    (b"\x89PNG\r\n", "a PNG picture"),
    (b"\xff\xd8\xff", "a JPEG picture"),
    (b"\x1f\x8b", "a gzip file (unpack it first)"),
    (b"BZh", "a bzip2 file (unpack it first)"),
    (b"\xfd7zXZ", "an xz file (unpack it first)"),
    (b"7z\xbc\xaf", "a 7z archive (unpack it first)"),
    (b"\xd0\xcf\x11\xe0", "an old Office document, such as .xls or .doc"),
    (b"\x7fELF", "a program"),
    (b"PAR1", "a Parquet table"),
    (b"\x93NUMPY", "a NumPy array"),
    (b"MATLAB 5.0", "a MATLAB file"),
    (b"\x89HDF\r\n", "an HDF5 file"),
    (b"\x89MCAP", "an MCAP bag"),
)
OFFICE = {"xl": "an Excel workbook (save the sheet as CSV)", "word": "a Word document", "ppt": "a PowerPoint document"}
HTML = ("<!doctype html", "<html", "<head", "<body")


def kind_of_text(text: str) -> str | None:
    """Kind of a text by its beginning; None where it is not told.

    Examples
    --------
    >>> kind_of_text("<!DOCTYPE html><html>"), kind_of_text('{"a": 1}'), kind_of_text("time,x,y")
    ('an HTML page', 'JSON', None)
    """
    start = text[:HEAD].lstrip("\ufeff \t\r\n").lower()
    if start.startswith(HTML):
        return "an HTML page"
    if start.startswith(("<?xml", "<svg", "<!--")):
        return "an HTML page" if "<html" in start else "XML"
    inner = start[1:].lstrip()
    if (start[:1] == "{" and inner[:1] in ('"', "}")) or (start[:1] == "[" and inner[:1] in ("{", "[", '"')):
        return None if start.startswith("[[") and start[2:3].isalpha() else "JSON"  # a table of TOML
    return None


def kind_of_file(path: str | os.PathLike[str]) -> str | None:
    """Kind of a file or folder; None where it is not told, or the file cannot be read.

    Examples
    --------
    >>> kind_of_file("/"), kind_of_file("/dev/null")
    ('a folder', None)
    """
    file = Path(path)
    if file.is_dir():
        return "a folder"
    if not file.is_file():
        return None
    try:
        with file.open("rb") as opened:
            head = opened.read(HEAD)
        if not head:
            return "an empty file"
        if head.startswith(b"PK") and zipfile.is_zipfile(file):
            return _of_archive(file)
    except (OSError, zipfile.BadZipFile):
        return None
    known = next((kind for mark, kind in MARKS if head.startswith(mark)), None)
    return known or kind_of_text(head.decode("utf-8", "replace"))


def _of_archive(file: Path) -> str:
    with zipfile.ZipFile(file) as archive:
        names = archive.namelist()
    if names and all(name.endswith(".npy") for name in names):
        return "NumPy arrays (.npz)"
    office = (kind for folder, kind in OFFICE.items() if any(name.startswith(f"{folder}/") for name in names))
    return next(office, "a zip archive (unpack it first)")


__all__ = ["kind_of_file", "kind_of_text"]
