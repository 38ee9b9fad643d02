"""Format of a file by its content; the file name counts only if the content does not decide."""

from __future__ import annotations

import zipfile
from enum import Enum
from pathlib import Path

from lftkit.errors import InputError
from lftkit.support.file_kind import kind_of_file
from pointing_analysis.read.mcap.records import BagError

HEAD = 512
"""First bytes of a file that identify its format."""
TEXT_LOOKED_THROUGH = 1_000_000
"""Largest text that is searched for a digit [byte]; a table without numbers is refused by its reader if larger."""
HDF5 = b"\x89HDF\r\n\x1a\n"
HDF5_OFFSETS = (0, 512, 1024, 2048, 4096)
"""Places of the signature of HDF5 in a file that begins with something else, as a MATLAB file of version 7.3 does."""
BAGS = (
    b"\x89MCAP",
    b"SQLite format 3",  # refused by name where the bag is read, as the next one
    b"#ROSBAG",
    b"\x28\xb5\x2f\xfd",  # zstd, lz4: an MCAP file that is compressed as a whole
    b"\x04\x22\x4d\x18",
)
TEXT_ENCODINGS = (
    (b"\xff\xfe\0\0", "utf-32"),
    (b"\0\0\xfe\xff", "utf-32"),
    (b"\xff\xfe", "utf-16"),
    (b"\xfe\xff", "utf-16"),
)


class Format(Enum):
    """Format of a file."""

    BAG = "bag"
    CSV = "CSV"
    PARQUET = "Parquet"
    NUMPY = "NumPy"
    MATLAB = "MATLAB"
    HDF5 = "HDF5"


FORMATS = (
    "bag (rosbag2 folder or MCAP file), CSV or other text, Parquet, MATLAB .mat (up to 7.2, and 7.3), HDF5, "
    "NumPy .npy or .npz"
)
"""The formats that are read, in words."""
CONVERSIONS = {
    "a TDMS file": 'pip install npTDMS pandas; python -c "from nptdms import TdmsFile; '
    "TdmsFile.read('FILE').as_dataframe(time_index=True).to_csv('NEW.csv', index_label='time')\"",
    "a FITS file": 'pip install astropy; python -c "from astropy.table import Table; '
    "Table.read('FILE').write('NEW.csv')\"",
    "a LabVIEW measurement": "python -c \"t = open('FILE').read().split('***End_of_Header***')[-1]; "
    "open('NEW.txt', 'w').write(t.split(chr(10), 1)[1])\"",
    "a universal file": 'pip install pyuff; python -c "import numpy as n, pyuff; u = [d for d in '
    "pyuff.UFF('FILE').read_sets() if d['type'] == 58]; "
    "n.savetxt('NEW.csv', n.c_[u[0]['x'], u[0]['data'], u[1]['data']], delimiter=',')\"",
    "a netCDF file": "nccopy -k nc4 FILE NEW.nc",
    "a WAV": "python -c \"from scipy.io import savemat, wavfile; fs, x = wavfile.read('FILE'); "
    "savemat('NEW.mat', {'fs': float(fs), 'los': x})\"",
    "an MDF": 'pip install asammdf; python -c "from asammdf import MDF; '
    "MDF('FILE').export('csv', filename='NEW.csv')\"",
    "an Arrow": 'python -c "from pyarrow import feather, parquet; '
    "parquet.write_table(feather.read_table('FILE'), 'NEW.parquet')\"",
    "a ULog": "pip install pyulog; ulog2csv FILE",
    "a Python pickle": "python -c \"import pandas; pandas.read_pickle('FILE').to_csv('NEW.csv')\"",
}
"""How to convert files of other kinds, by the beginning of the name of their kind."""
OF_SUFFIX = {".mcap": Format.BAG, ".csv": Format.CSV, ".txt": Format.CSV, ".mat": Format.MATLAB}
"""Formats that have no mark of their own, or whose mark may be damaged, by the end of the name."""


def format_of(path: Path) -> Format:
    """Format of a file or folder.

    Parameters
    ----------
    path : file or folder

    Raises
    ------
    InputError
        No such file, or none of the formats that are read; the message lists them.
    BagError
        No such file, where the name is that of no table.
    """
    if path.is_dir():
        # A bag, if anything in the folder is of one; the reader reports a bag with missing files
        names = [entry.name for entry in path.iterdir()]
        if not any(name == "metadata.yaml" or ".mcap" in name or ".db3" in name for name in names):
            raise InputError(f"{path}: recording must be one of {FORMATS}; got a folder without metadata.yaml or .mcap")
        return Format.BAG
    if not path.is_file():
        if path.suffix.lower() in ("", ".mcap", ".db3", ".bag", ".zstd"):
            raise BagError(f"{path}: no such file or folder")
        raise InputError(f"{path}: no such file")
    try:
        with path.open("rb") as file:
            head = file.read(HEAD)
            marks = [head[: len(HDF5)], *(_at(file, offset) for offset in HDF5_OFFSETS[1:])]
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}") from None
    if (by_content := _by_mark(path, head, marks)) is not None:
        return by_content
    kind = kind_of_file(path)
    if kind is None:
        by_content = OF_SUFFIX.get(path.suffix.lower()) or (Format.CSV if _is_text(head) else None)
        if by_content is Format.CSV and _without_digits(path):
            kind = "a text without numbers"
    if by_content is None or kind is not None:
        kind = kind or f"a file that begins with {head[:8]!r}"
        how = next((how for name, how in CONVERSIONS.items() if kind.startswith(name)), "")
        advice = f"; to convert it: {how}" if how else ""
        raise InputError(f"{path}: file must be one of {FORMATS}; got {kind}{advice}")
    return by_content


def _without_digits(path: Path) -> bool:
    """Whether a file is small and no byte of it is a digit: then it is no table."""
    return path.stat().st_size <= TEXT_LOOKED_THROUGH and not any(48 <= byte <= 57 for byte in path.read_bytes())


def _at(file: object, offset: int) -> bytes:
    file.seek(offset)  # type: ignore[attr-defined]
    return bytes(file.read(len(HDF5)))  # type: ignore[attr-defined]


def _by_mark(path: Path, head: bytes, marks: list[bytes]) -> Format | None:
    if head.startswith(BAGS):
        return Format.BAG
    if head.startswith(b"PAR1"):
        return Format.PARQUET
    if head.startswith(b"\x93NUMPY") or (zipfile.is_zipfile(path) and _holds_arrays(path)):
        return Format.NUMPY
    if HDF5 in marks:  # a MATLAB file of version 7.3 is one
        return Format.HDF5
    return Format.MATLAB if head.startswith(b"MATLAB 5.0") else None


def _holds_arrays(path: Path) -> bool:
    """Whether a zip file is one of NumPy, or so damaged that only its reader can say."""
    try:
        with zipfile.ZipFile(path) as archive:
            names = archive.namelist()
    except (OSError, zipfile.BadZipFile):
        return True
    return not names or any(name.endswith(".npy") for name in names)


def text_encoding(head: bytes) -> str:
    """Encoding of a text by its first bytes: UTF-16 and UTF-32 where they are marked or have every other byte zero.

    Examples
    --------
    >>> text_encoding("t,x".encode("utf-16-be")), text_encoding("t,x".encode("utf-32")), text_encoding(b"t,x")
    ('utf-16-be', 'utf-32', 'utf-8-sig')
    """
    marked = next((name for mark, name in TEXT_ENCODINGS if head.startswith(mark)), None)
    if marked is None and len(head) >= 4:
        for first, name in ((0, "utf-16-be"), (1, "utf-16-le")):
            if not any(head[first:4:2]) and all(head[1 - first : 4 : 2]):
                return name
    return marked or "utf-8-sig"


def _is_text(head: bytes) -> bool:
    encoding = text_encoding(head)
    try:
        head.decode(encoding, errors="strict")
    except UnicodeDecodeError as error:
        if error.start < len(head) - 4:  # a character may be cut at the end
            return False
    return encoding != "utf-8-sig" or b"\0" not in head
