"""Text of a NASTRAN deck with the files that it includes.

The deck is read here and given to pyNastran as text: pyNastran would open any file that INCLUDE names, and follows
comments that name other formats, files to write, or cards to leave out.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lftkit.errors import InputError
from lftkit.support.input_files import read_bytes
from lftkit.support.input_limits import INCLUDES, SYSTEM

_INCLUDE = re.compile(r"^\s*include\b", re.IGNORECASE)
_CASE_PARAM = re.compile(r"^\s*param[\s,]+(\w+)[\s,]+([^\s,$]+)", re.IGNORECASE | re.MULTILINE)
_SUPER = re.compile(r"^\s*begin\s+(?:bulk\s+)?(super|auxmodel)\s*=?\s*(\w+)", re.IGNORECASE)
_SECTIONS = re.compile(r"^\s*(cend|begin\s+bulk)\b", re.IGNORECASE | re.MULTILINE)


@dataclass(frozen=True)
class Deck:
    """A deck as one text.

    Attributes
    ----------
    text : without comments for pyNastran, included files in their places
    punch : whether it has bulk data only
    """

    text: str
    punch: bool


def read_deck(path: Path) -> Deck:
    """Read a deck and what it includes.

    Raises
    ------
    OSError
        A file that cannot be read.
    ValueError
        A binary file; INCLUDE of a file outside the folder of the deck, in a circle, or of too many files; a deck
        without lines, or with several structures.
    """
    lines = _of_one_structure(_lines(path, path.resolve().parent, (), [0]), path)
    text = "\n".join(line for line in lines if not re.match(r"^\s*\$\s*pynastran", line, re.IGNORECASE)) + "\n"
    if not text.strip():
        raise InputError(f"{path}: BDF must have lines, got none")
    return Deck(text, _SECTIONS.search(text) is None)


def _of_one_structure(lines: list[str], path: Path) -> list[str]:
    """The lines without the BEGIN SUPER at the head of a punch file (EXTSEOUT with EXTBULK)."""
    parts = [(k, match) for k, line in enumerate(lines) if (match := _SUPER.match(line))]
    if not parts:
        return lines
    first, match = parts[0]
    if len(parts) > 1 or any(line.strip() and not line.lstrip().startswith("$") for line in lines[:first]):
        raise InputError(
            f"{path}: deck must be of one structure, got BEGIN {match[1].upper()} {match[2]} beside another: read its "
            "reduced matrices (EXTSEOUT(STIFFNESS,MASS,DMIGPCH), read_nastran_matrices), or a run without superelements"
        )
    return lines[:first] + lines[first + 1 :]


def _lines(path: Path, folder: Path, above: tuple[Path, ...], count: list[int]) -> list[str]:
    count[0] += 1
    if count[0] > INCLUDES:
        raise InputError(f"{path}: deck must include at most {INCLUDES} files, got more")
    data = read_bytes(path, SYSTEM)
    if b"\0" in data:
        raise InputError(
            f"{path}: bulk data and punch files must be text, got a binary file; reduced matrices of an OP2 are text "
            "with EXTSEOUT(STIFFNESS,MASS,DMIGPCH)"
        )
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError:
        text = data.decode("latin-1")  # of comments; cards are ASCII
    lines: list[str] = []
    waiting = iter(text.splitlines())
    for line in waiting:
        if not _INCLUDE.match(line):
            lines.append(line)
            continue
        name = _INCLUDE.sub("", line).split("$")[0].strip()
        mark = name[:1]
        while mark in ("'", '"') and (len(name) < 2 or not name.endswith(mark)):
            more = next(waiting, None)
            if more is None:
                raise InputError(f"{path}: INCLUDE must name a file in quotes, got {name[:80]}")
            name += more.strip()
        lines += _lines(_inside(name.strip("'\""), path, folder, above), folder, (*above, path.resolve()), count)
    return lines


def _inside(name: str, path: Path, folder: Path, above: tuple[Path, ...]) -> Path:
    """The included file, in the folder of the deck."""
    if not name or re.search(r"[:$%~\\\0]", name):
        raise InputError(f"{path}: INCLUDE must name a file by its path below the deck, got {name[:80]!r}")
    file = (path.resolve().parent / name).resolve()
    if not file.is_relative_to(folder):
        raise InputError(f"{path}: INCLUDE must name a file in the folder of the deck, got {name[:80]!r}")
    if file in (*above, path.resolve()):
        raise InputError(f"{path}: INCLUDE must not be recursive, got {name[:80]!r}")
    return file


def parameters_of(deck: Deck, model: Any, path: Path) -> dict[str, str]:
    """PARAM of the bulk data and the case control, as text by name.

    Raises
    ------
    ValueError
        A parameter with two values.
    """
    parameters = {name: str(card.values[0]) for name, card in model.params.items() if card.values}
    head = deck.text[: start.start()] if (start := re.search(r"^\s*begin\s+bulk", deck.text, re.I | re.M)) else ""
    for name, value in _CASE_PARAM.findall(head):
        if parameters.setdefault(name.upper(), value).upper() != value.upper():
            raise InputError(
                f"{path}: PARAM,{name.upper()} must have one value, got {parameters[name.upper()]}, {value}"
            )
    return parameters


def number_of(text: str) -> float:
    """Number of a field, "2.59-3" and "1.D0" too; NaN for another text."""
    try:
        return float(re.sub(r"(?<=[\d.])([+-]\d+)$", r"e\1", text.upper().replace("D", "E")))
    except ValueError:
        return float("nan")


def reduced_by(deck: Deck, model: Any) -> str:
    """What makes the modes of a run no eigenvectors of its matrices: residual vectors, or an analysis set; else ""."""
    asked = re.search(r"^\s*resvec\b[^=\n]*=\s*(\w+)", deck.text, re.IGNORECASE | re.MULTILINE)
    if asked and not asked[1].upper().startswith("NO"):
        return f"RESVEC = {asked[1].upper()}"
    if "RESVEC" in model.params and str(model.params["RESVEC"].values[0]).upper() != "NO":
        return "PARAM,RESVEC"
    sets = {"ASET": model.asets, "BSET": model.bsets, "CSET": model.csets, "QSET": model.qsets, "OMIT": model.omits}
    return next((name for name, cards in sets.items() if cards), "")


def is_coupled(deck: Deck, model: Any, path: Path) -> bool:
    """Whether ``PARAM,COUPMASS`` asks for coupled (consistent) mass matrices; NASTRAN's default is lumped ones."""
    return number_of(parameters_of(deck, model, path).get("COUPMASS", "-1")) > 0
