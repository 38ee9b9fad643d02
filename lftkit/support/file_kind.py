"""What a file holds that a program does not read, by its first bytes: for the message that refuses it."""

from __future__ import annotations

import os
import re
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
    (b"TDSm", "a TDMS file of LabVIEW"),
    (b"SIMPLE  =", "a FITS file"),
    (b"CDF\x01", "a netCDF file of the classic format"),
    (b"CDF\x02", "a netCDF file of the classic format"),
    (b"\xcd\xf3\x00\x01", "a CDF file"),
    (b"\x7fROOT", "a ROOT file"),
    (b"root\0", "a ROOT file"),
    (b"RIFF", "a WAV or another RIFF file"),
    (b"MDF     ", "an MDF measurement file"),
    (b"ULog\x01\x12\x35", "a ULog file of PX4"),
    (b"ARROW1", "an Arrow or Feather file"),
    (b"\x80\x03", "a Python pickle"),
    (b"\x80\x04", "a Python pickle"),
    (b"\x80\x05", "a Python pickle"),
    (b"PAR1", "a Parquet table"),
    (b"\x93NUMPY", "a NumPy array"),
    (b"MATLAB 5.0", "a MATLAB file"),
    (b"\x89HDF\r\n", "an HDF5 file"),
    (b"\x89MCAP", "an MCAP bag"),
)
OFFICE = {"xl": "an Excel workbook (save the sheet as CSV)", "word": "a Word document", "ppt": "a PowerPoint document"}
TEXTS = (
    ("labview measurement", "a LabVIEW measurement file (.lvm)"),
    ("ccsds_", "an orbit or attitude message of CCSDS"),
    ("#beginglobalheader", "a DIAdem header file"),
    ("begin_mts", "an MTS file"),
    ("@relation", "an ARFF file"),
)
"""Beginnings of texts that are a format of their own, in small letters."""
UNIVERSAL_FILE = re.compile(r" {4}-1\s*\n\s{1,5}\d{1,4}[b ]?\s")
"""A universal file (UNV, UFF): a line with -1, then the number of the data set."""
HTML = ("<!doctype html", "<html", "<head", "<body")


def kind_of_text(text: str) -> str | None:
    r"""Kind of a text by its beginning; None where it is not told.

    Examples
    --------
    >>> kind_of_text("<!DOCTYPE html><html>"), kind_of_text('{"a": 1}'), kind_of_text("time,x,y")
    ('an HTML page', 'JSON', None)
    >>> kind_of_text("    -1\n    58\n")
    'a universal file (UNV, UFF)'
    """
    start = text[:HEAD].lstrip("\ufeff \t\r\n").lower()
    if start.startswith(HTML):
        return "an HTML page"
    if start.startswith(("<?xml", "<svg", "<!--")):
        return "an HTML page" if "<html" in start else "XML"
    if (known := next((kind for mark, kind in TEXTS if start.startswith(mark)), None)) is not None:
        return known
    if UNIVERSAL_FILE.match(text[:HEAD].replace("\r", "")):
        return "a universal file (UNV, UFF)"
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
            with zipfile.ZipFile(file) as archive:
                names = archive.namelist()
            if names and all(name.endswith(".npy") for name in names):
                return "NumPy arrays (.npz)"
            if "content.xml" in names:
                return "an OpenDocument file (save the sheet as CSV)"
            office = (kind for folder, kind in OFFICE.items() if any(name.startswith(f"{folder}/") for name in names))
            return next(office, "a zip archive (unpack it first)")
    except (OSError, zipfile.BadZipFile):
        return None
    known = next((kind for mark, kind in MARKS if head.startswith(mark)), None)
    return known or kind_of_text(head.decode("utf-8", "replace"))
