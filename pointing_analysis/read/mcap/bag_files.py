"""Files of a bag: the folder, its metadata.yaml, the MCAP files in their order."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lftkit.errors import InputError
from lftkit.support.atomic_output import MAX_NAME
from pointing_analysis.files.structured_text import load_yaml, read_text
from pointing_analysis.read.mcap.records import SQLITE, BagError

_FILE = re.compile(r"\.mcap(\.zst|\.zstd)?$")
LISTED = 200
"""Characters of names in a message."""
NAME_ORDER = "files read in name order"


@dataclass(frozen=True)
class BagFiles:
    """Files of a bag.

    Attributes
    ----------
    files : MCAP files in the order of recording
    counts : messages of each topic by metadata.yaml, if stated
    problems : what is wrong with metadata.yaml
    message_count : all messages by metadata.yaml; None if not stated
    """

    files: tuple[Path, ...]
    counts: Mapping[str, int]
    problems: tuple[str, ...]
    message_count: int | None = None


def _natural(path: Path) -> list[tuple[int, str]]:
    return [(int(part), "") if part.isdigit() else (0, part) for part in re.split(r"(\d{1,18})", path.name)]


def is_single_file(path: Path) -> bool:
    """Whether a bag is one file; False if it is a folder.

    Raises
    ------
    BagError
        Neither, or a name that no file can have.
    """
    try:
        if not path.exists():
            raise BagError(f"{path}: no such file or folder")
    except OSError as error:
        raise BagError(f"{str(path)[:80]}: no such file or folder: {error.strerror}") from None
    if not (path.is_file() or path.is_dir()):
        raise BagError(f"{path}: a bag must be a folder or a file, got a device, a pipe or a socket")
    return path.is_file()


def bag_files(path: Path) -> BagFiles:
    """Files of a bag in order.

    Raises
    ------
    BagError
        No such bag, no MCAP file in it, sqlite3, or compressed otherwise than with zstd.
    """
    if is_single_file(path):
        return BagFiles((path,), {}, ())
    of_name = [f for f in path.iterdir() if _FILE.search(f.name)]
    on_disk = sorted((f for f in of_name if f.is_file() and not f.is_symlink()), key=_natural)
    info, problems = _description(path)
    named = _named(path, info, problems)
    missing = [f.name for f in named if not f.is_file()]
    if missing:
        problems.append(f"files named in metadata.yaml are missing: {', '.join(missing)}")
    files = [f for f in named if f.is_file()]
    if not files:
        files = on_disk
        if links := sorted(f.name for f in of_name if f.is_symlink()):
            problems.append(f"links in the bag folder are ignored: {', '.join(links)[:LISTED]}")
    if any(".db3" in f.name for f in files or path.iterdir()):
        raise BagError(f"{path}: the bag must be MCAP, got {SQLITE}")
    compression = info.get("compression_format") or "zstd"
    if compression != "zstd":
        raise BagError(f"{path}: compression_format of the bag must be zstd, got {compression!r}")
    if not files:
        got = "links to files only" if any(f.is_symlink() for f in of_name) else "none"
        raise BagError(f"{path}: a rosbag2 folder must hold .mcap files, got {got}")
    rows = info.get("topics_with_message_count", [])
    counts = {}
    for row in rows if isinstance(rows, list) else []:
        about = row.get("topic_metadata") if isinstance(row, dict) else None
        name = about.get("name") if isinstance(about, dict) else None
        count = _count(row.get("message_count")) if isinstance(row, dict) else None
        if isinstance(name, str) and count is not None:
            counts[name] = count
    return BagFiles(tuple(files), counts, tuple(problems), _count(info.get("message_count")))


def files_digest(files: Sequence[Path]) -> str:
    """SHA-256 of the contents of files, one after another, hexadecimal."""
    total = hashlib.sha256()
    for file in files:
        with file.open("rb") as stream:
            while block := stream.read(1 << 20):
                total.update(block)
    return total.hexdigest()


def _description(path: Path) -> tuple[dict[str, Any], list[str]]:
    """Content of metadata.yaml, and what is wrong with it."""
    file = path / "metadata.yaml"
    if not file.is_file():
        return {}, [f"no metadata.yaml: {NAME_ORDER}"]
    try:
        content = load_yaml(read_text(file), "metadata.yaml")
    except InputError as error:
        return {}, [f"metadata.yaml cannot be read ({error}): {NAME_ORDER}"]
    info = content.get("rosbag2_bagfile_information") if isinstance(content, dict) else None
    if not isinstance(info, dict):
        return {}, [f"metadata.yaml must hold a table rosbag2_bagfile_information, got another content: {NAME_ORDER}"]
    return info, []


def _named(path: Path, info: Mapping[str, Any], problems: list[str]) -> list[Path]:
    """The files that metadata.yaml names, as far as they lie in the folder of the bag."""
    names = info.get("relative_file_paths", [])
    if not isinstance(names, list) or not all(isinstance(name, str) and name and "\0" not in name for name in names):
        problems.append(f"metadata.yaml: relative_file_paths must be a list of file names: {NAME_ORDER}")
        return []
    unique = list(dict.fromkeys(names))
    if len(unique) < len(names):
        problems.append("metadata.yaml names a file more than once: it is read once")
    possible = [name for name in unique if len(name.encode(errors="replace")) <= MAX_NAME and name.isprintable()]
    if len(possible) < len(unique):
        problems.append("metadata.yaml has invalid file names: they are ignored")
    inside = [name for name in possible if Path(name).name == name and not (path / name).is_symlink()]
    if len(inside) < len(possible):
        problems.append("metadata.yaml names files outside the bag folder: they are ignored")
    return [path / name for name in inside if not (path / name).is_dir()]


def _count(value: object) -> int | None:
    """A number of messages; None for anything else."""
    return value if isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 1 << 48 else None
