"""Texts with structure (JSON, TOML, YAML) of others: size, nesting and number of values are limited.

A parser that calls itself for each level would end in a RecursionError; names with dots in TOML stand for a table for
each dot, and some kilobytes of them take gigabytes; an integer of some hundred digits fits no number of the
computation.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from typing import Any

from lftkit.errors import InputError
from lftkit.support.file_kind import kind_of_text
from lftkit.support.input_limits import DEPTH, DIGITS, KINDS

_TOML_TOKENS = re.compile(r"\"\"\"|'''|[\"'#\n]")
_TOML_MARKS = re.compile(r"[=,\[\]{}\n]")


def parse(text: str, what: object, kind: str, parser: Callable[[str], Any]) -> Any:
    """Content of a text.

    Parameters
    ----------
    text : str
    what : object
        The file, for messages.
    kind : {"JSON", "TOML", "YAML"}
    parser : callable
        Makes the content of the text; ValueError where it cannot.

    Raises
    ------
    InputError
        The text is not of this kind, too large, nested too deep, or has an integer that is too long.

    Examples
    --------
    >>> parse("[[1, 2], 3]", "x.json", "JSON", json.loads)
    [[1, 2], 3]
    >>> parse("a" + 100 * ".a" + " = 1", "x.toml", "TOML", json.loads)
    Traceback (most recent call last):
    ...
    lftkit.errors.InputError: x.toml must be nested at most 50 levels deep, got more
    """
    limit = KINDS[kind]
    if len(text) > limit.size:
        raise InputError(f"{what} must be {kind} of at most {limit.size / 1e6:g} MB, got {len(text) / 1e6:g}")
    if kind == "TOML":
        # Refuse names of too many parts, and too many values, in a TOML text; every dot of a name is a table more
        bare = _without_strings(text).replace(" ", "").replace("\t", "")
        pieces = _TOML_MARKS.split(bare)
        if max(piece.count(".") for piece in pieces) >= DEPTH:
            raise too_deep(what)
        filled = sum(1 + piece.count(".") for piece in pieces if piece)
        check_count(filled + sum(map(bare.count, "[{")), what, "TOML")
    elif kind == "JSON":
        check_count(sum(map(text.count, ",[{")), what, kind)
    try:
        content = parser(text)
        # Depth and integers of a content; level by level, without recursion
        level, depth = [content], 0
        while level:
            if depth > DEPTH:
                raise too_deep(what)
            below: list[Any] = []
            for item in level:
                if isinstance(item, dict):
                    below += item.keys()
                    below += item.values()
                elif isinstance(item, (list, tuple)):
                    below += item
                elif isinstance(item, int) and item.bit_length() > 3.33 * DIGITS:
                    raise InputError(f"{what} must have integers of at most {DIGITS} digits, got a longer one")
            level, depth = below, depth + 1
    except InputError:
        raise
    except RecursionError:
        raise too_deep(what) from None
    except (ValueError, TypeError, OverflowError) as error:
        other = kind_of_text(text)
        if other is not None and other != kind:
            raise InputError(f"{what} must be {kind}, got {other}") from None
        first = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(f"{what} must be {kind}: {first}") from None
    return content


def load_json(text: str, what: object) -> Any:
    """Content of a JSON text that `what` names; raises as :func:`parse`."""
    return parse(text, what, "JSON", json.loads)


def check_count(values: int, what: object, kind: str) -> None:
    """Refuse more values than a text of this kind may have, before they are made."""
    if values > KINDS[kind].values:
        raise InputError(f"{what} must be {kind} with at most {KINDS[kind].values} values, got more")


def too_deep(what: object) -> InputError:
    """The error of a text that is nested too deep."""
    return InputError(f"{what} must be nested at most {DEPTH} levels deep, got more")


def _without_strings(text: str) -> str:
    """The text with a letter in place of each string, and without comments; what is not closed goes to the end."""
    parts, at = [], 0
    while (match := _TOML_TOKENS.search(text, at)) is not None:
        mark = match[0]
        parts.append(text[at : match.start()] + ("\n" if mark in "\n#" else "s"))
        at = match.end()
        if mark == "#":
            at = _end(text, "\n", at)
        elif mark != "\n":
            at = _end_of_string(text, mark, at)
    return "".join([*parts, text[at:]])


def _end_of_string(text: str, mark: str, at: int) -> int:
    if mark[0] == "'":
        return _end(text, mark, at)
    while (stop := text.find(mark, at)) >= 0:
        slashes = stop
        while slashes > at and text[slashes - 1] == "\\":
            slashes -= 1
        if (stop - slashes) % 2 == 0:
            return _after(text, mark, stop)
        at = stop + 1
    return len(text)


def _end(text: str, mark: str, at: int) -> int:
    stop = text.find(mark, at)
    return len(text) if stop < 0 else _after(text, mark, stop)


def _after(text: str, mark: str, stop: int) -> int:
    """Behind a closing mark; a text of several lines may end with two marks of its own before the closing one."""
    at = stop + len(mark)
    if len(mark) == 3:
        while at < min(stop + 5, len(text)) and text[at] == mark[0]:
            at += 1
    return at
