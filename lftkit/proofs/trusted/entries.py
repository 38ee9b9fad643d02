"""The one reader of proofs: a header and arrays, exact types and shapes, nothing unknown, nothing twice.

A *form* is a function of a value and its name; it returns the value that the program uses, or refuses with a
:class:`ProofError`. A truth value is no number, a number no truth value, a whole number with a point no index; of all
types only an integer passes for another, for a number. Sequences become tuples, tables of numbers arrays.

Examples
--------
>>> claim = record({"level": number, "rows": each(index)}, {"note": text})
>>> claim({"level": 2, "rows": [0, 1]}, "proof")
{'level': 2.0, 'rows': (0, 1)}
>>> claim({"level": 2.0, "rows": [False, True]}, "proof")
Traceback (most recent call last):
...
lftkit.proofs.trusted.proof.ProofError: proof.rows[0] must be a whole number from zero on, got False
"""

from __future__ import annotations

import io
import json
import math
import zipfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lftkit.proofs.trusted.proof import ProofError, ProofFileError, require

FORMAT = "lftkit proof 2"
"""First entry of every header."""
Form = Callable[[Any, str], Any]
MOST_BYTES = 2**31
"""Of a file."""
UNPACKED, UNPACKED_RATIO = 200_000_000, 100
"""A compressed file may unpack to this many bytes, or to this many times its size, whichever is more."""
MOST_MEMBERS = 10_000
LONGEST_TEXT, MOST_ENTRIES, LARGEST_INDEX = 10_000, 10_000_000, 2**31
TYPES = ("<f8", "<c16", "<c8", "<i8", "|u1")
"""Of the numbers of an array."""


def refuse(where: str, wanted: str, got: Any) -> ProofError:
    """The error that says what an entry must be."""
    return ProofError(f"{where} must be {wanted}, got {repr(got)[:60]}")


def single(wanted: str, met: Callable[[Any], bool], made: Callable[[Any], Any]) -> Form:
    """A value of a type and with limits."""

    def read(value: Any, where: str) -> Any:
        if not met(value):
            raise refuse(where, wanted, value)
        return made(value)

    return read


number = single("a finite number", lambda v: type(v) in (int, float) and abs(v) < 1.8e308, float)
index = single("a whole number from zero on", lambda v: type(v) is int and 0 <= v < LARGEST_INDEX, int)
text = single("a text", lambda v: type(v) is str and len(v) <= LONGEST_TEXT, str)
truth = single("true or false", lambda v: type(v) is bool, bool)


def word(value: Any, where: str) -> Any:
    """A text or a number for people."""
    return (text if type(value) is str else number)(value, where)


def maybe(form: Form) -> Form:
    """What has a form, or null."""
    return lambda value, where: None if value is None else form(value, where)


def each(form: Form) -> Form:
    """A sequence whose entries have a form."""

    def read(value: Any, where: str) -> tuple[Any, ...]:
        if type(value) not in (list, tuple) or len(value) > MOST_ENTRIES:
            raise refuse(where, "a list", value)
        return tuple(form(entry, f"{where}[{k}]") for k, entry in enumerate(value))

    return read


def fixed(*forms: Form) -> Form:
    """A sequence with as many entries as forms."""

    def read(value: Any, where: str) -> tuple[Any, ...]:
        if type(value) not in (list, tuple) or len(value) != len(forms):
            raise refuse(where, f"a list of {len(forms)}", value)
        return tuple(form(entry, f"{where}[{k}]") for k, (form, entry) in enumerate(zip(forms, value)))

    return read


pair = fixed(number, number)


def mapping(form: Form) -> Form:
    """Texts as keys, and values of a form."""

    def read(value: Any, where: str) -> dict[str, Any]:
        if type(value) is not dict or len(value) > MOST_ENTRIES:
            raise refuse(where, "an object", value)
        return {text(key, f"a key of {where}"): form(entry, f"{where}.{key}"[:200]) for key, entry in value.items()}

    return read


def record(forms: Mapping[str, Form], optional: Mapping[str, Form] | None = None) -> Form:
    """Exactly these keys; the optional ones may be missing."""
    known = {**forms, **(optional or {})}

    def read(value: Any, where: str) -> dict[str, Any]:
        if type(value) is not dict:
            raise refuse(where, "an object", value)
        if not set(forms) <= set(value) <= set(known):
            wrong = set(forms) - set(value) or set(value) - set(known)
            raise refuse(where, f"an object with the keys {', '.join(known)}", sorted(map(str, wrong)))
        return {key: known[key](entry, f"{where}.{key}") for key, entry in value.items()}

    return read


def header_of(
    given: Any, kind: str, forms: Mapping[str, Form], optional: Mapping[str, Form] | None = None
) -> dict[str, Any]:
    """Header of a proof of a kind: the format, the kind, and entries of these forms."""
    kind_of = given.get("kind") if isinstance(given, dict) and given.get("format") == FORMAT else None
    if kind_of != kind:
        raise refuse("header", f"one of {FORMAT!r}, kind {kind!r}", kind_of)
    return dict(record({"format": text, "kind": text, **forms}, optional)(given, "header"))


def table(value: Any, where: str) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Rows of finite numbers, all of the same length."""
    rows: Any = value if type(value) in (list, tuple) else (None,)
    if not all(type(row) in (list, tuple) for row in rows) or len({len(row) for row in rows}) > 1:
        raise refuse(where, "a list of rows of the same length", value)
    if not {type(entry) for row in rows for entry in row} <= {int, float}:
        raise refuse(where, "rows of numbers", next(e for row in rows for e in row if type(e) not in (int, float)))
    found = np.array([list(map(float, row)) for row in rows], dtype=np.float64)
    if not np.isfinite(found).all():
        raise refuse(where, "rows of finite numbers", value)
    return found.reshape(len(rows), -1) if len(rows) else np.zeros((0, 0))


def array(types: str | Sequence[str], *shape: int | None) -> Form:
    """An array of finite numbers of one of some types, with a shape; None stands for any length."""
    wanted = (types,) if isinstance(types, str) else tuple(types)

    def read(value: Any, where: str) -> np.ndarray[Any, Any]:
        own = isinstance(value, np.ndarray) and value.dtype.name in wanted and value.ndim == len(shape)
        if not own or any(size not in (None, have) for size, have in zip(shape, value.shape)):
            got = f"{value.dtype.name} {value.shape}" if isinstance(value, np.ndarray) else value
            raise refuse(where, f"an array of type {' or '.join(wanted)} and shape {shape}", got)
        if value.dtype.kind in "fc" and not np.isfinite(value).all():
            raise refuse(where, "an array of finite numbers", "others")
        return np.asarray(value)

    return read


def parsed(content: bytes, where: str) -> Any:
    """What a text in JSON says: no key twice, no NaN, no infinite number."""

    def entries(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        found = dict(pairs)
        require(len(found) == len(pairs), f"{where} must have no key twice, got {[k[:60] for k, _ in pairs]}"[:300])
        return found

    def refused(name: str) -> Any:
        raise refuse(where, "JSON with finite numbers", name)

    def finite(digits: str) -> float:
        return float(number(float(digits), where))

    try:
        given = content.decode("utf-8")
        return json.loads(given, object_pairs_hook=entries, parse_constant=refused, parse_float=finite)
    except ProofError:
        raise
    except (ValueError, RecursionError) as error:
        raise ProofError(f"{where} must be JSON: {error}"[:300]) from None


def require_small(size: int, packed: int) -> None:
    """Refuse what unpacks to more bytes than a file of `packed` bytes may."""
    most = max(UNPACKED, UNPACKED_RATIO * packed)
    require(size <= most, f"the file must unpack to at most {most / 1e6:g} MB, got {size / 1e6:g} MB")


def zip_members(path: Path) -> dict[str, bytes]:
    """All members of a zip file, whose number and size are limited before they are unpacked.

    Raises
    ------
    ProofError
        More of them, or one twice.
    """
    with zipfile.ZipFile(path) as archive:
        infos = archive.infolist()
        require(len(infos) <= MOST_MEMBERS, f"the file must have at most {MOST_MEMBERS} members, got {len(infos)}")
        require_small(sum(info.file_size for info in infos), path.stat().st_size)
        found = {info.filename: archive.read(info) for info in infos}
        require(len(found) == len(infos), f"the file must have no member twice, got {sorted(found)}"[:300])
        return found


def file_content(path: Path) -> tuple[Any, dict[str, np.ndarray[Any, Any]]]:
    """Header and arrays of the file of a proof; one in JSON has no arrays.

    Raises
    ------
    ProofFileError
        No ordinary file of a limited size, a member twice, of another type or larger than it says, or no JSON.
    """
    try:
        require(path.is_file(), f"the proof must be an ordinary file, got {path}")
        size = path.stat().st_size
        require(size <= MOST_BYTES, f"the file must have at most {MOST_BYTES} bytes, got {size}")
        if not zipfile.is_zipfile(path):
            return parsed(path.read_bytes(), "the file"), {}
        members = zip_members(path)
        require("header.npy" in members, "the file must be a proof with a member header.npy, got none")
        arrays = {name.removesuffix(".npy"): member(data, name) for name, data in members.items()}
        return parsed(array("uint8", None)(arrays.pop("header"), "header").tobytes(), "header"), arrays
    except ProofError as error:
        raise ProofFileError(str(error)) from None
    except Exception as error:  # of damaged streams the decompressors raise errors of their own
        raise ProofFileError("the file must be a proof, got one that cannot be unpacked") from error


def member(data: bytes, name: str) -> np.ndarray[Any, Any]:
    """An array in numpy's format, of which nothing is made before its size is known to be that of the data."""
    stream = io.BytesIO(data)
    format_of: Any = np.lib.format
    version = format_of.read_magic(stream)
    read = format_of.read_array_header_1_0 if version == (1, 0) else format_of.read_array_header_2_0
    shape, by_columns, kind = read(stream)
    count, start = math.prod(shape), stream.tell()
    known = name.endswith(".npy") and version in ((1, 0), (2, 0)) and kind.str in TYPES
    sizes = all(type(size) is int and size >= 0 for size in shape)
    own = known and sizes and len(data) - start == count * kind.itemsize
    require(own, f"{name} must be an array of {', '.join(TYPES)} and of its size, got {kind.str} {shape}")
    values = np.frombuffer(data[start:], kind) if count else np.zeros(0, kind)
    return values.reshape(shape, order="F" if by_columns else "C").copy()
