"""YAML, TOML and JSON from files of others: size and nesting are limited before anything is built of them.

A parser that calls itself for each level would end in a RecursionError, an alias in YAML could stand for a structure of
any size, and an integer of some hundred digits fits no number of the computation.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeGuard

import yaml

from pointing_analysis.files.file_kind import kind_of_file, kind_of_text

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib  # type: ignore[import-not-found]

MAX_SIZE = 16_000_000
"""Largest file [byte]."""
MAX_DEPTH = 50
"""Deepest nesting."""
MAX_DIGITS = 300
"""Longest integer; a float holds 308 digits."""


_FAST_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


class StructuredTextError(ValueError):
    """The text cannot be read; the message names the file and says what is wrong."""


def read_text(path: Path) -> str:
    """Text of a file in UTF-8.

    Raises
    ------
    StructuredTextError
        It cannot be read, is too large, or is not UTF-8.
    """
    try:
        if not path.is_file():
            raise StructuredTextError(f"cannot read {path}: {'not a file' if path.exists() else 'No such file'}")
        if path.stat().st_size > MAX_SIZE:
            raise StructuredTextError(f"{path} must have at most {MAX_SIZE} bytes, got {path.stat().st_size}")
        return path.read_text("utf-8")
    except OSError as error:
        raise StructuredTextError(f"cannot read {path}: {error.strerror}") from None
    except UnicodeDecodeError:
        found = kind_of_file(path) or "other bytes"
        raise StructuredTextError(f"{path} must be text in UTF-8, got {found}") from None


def is_number(value: Any) -> TypeGuard[float]:
    """Whether a value of a file is a number; true and false are none.

    Examples
    --------
    >>> [is_number(value) for value in (1, 2.5, True, "3")]
    [True, True, False, False]
    """
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _check(value: Any, what: object, depth: int = 0) -> None:
    if depth > MAX_DEPTH:
        raise StructuredTextError(f"{what} must be nested at most {MAX_DEPTH} levels deep, got more")
    if isinstance(value, int) and not isinstance(value, bool) and value.bit_length() > 3.3 * MAX_DIGITS:
        raise StructuredTextError(f"{what} must have integers of at most {MAX_DIGITS} digits, got a longer one")
    if isinstance(value, dict):
        for key, item in value.items():
            _check(key, what, depth + 1)
            _check(item, what, depth + 1)
    elif isinstance(value, (list, tuple)):
        for item in value:
            _check(item, what, depth + 1)


def _load(text: str, what: object, kind: str, parse: Callable[[str], Any]) -> Any:
    try:
        content = parse(text)
        _check(content, what)
    except StructuredTextError:
        raise
    except RecursionError:
        raise StructuredTextError(f"{what} must be nested at most {MAX_DEPTH} levels deep, got more") from None
    except (ValueError, TypeError, OverflowError, yaml.YAMLError) as error:
        found = kind_of_text(text)
        if found is not None and found != kind:
            raise StructuredTextError(f"{what} must be {kind}, got {found}") from None
        first = (str(error).splitlines() or [type(error).__name__])[0]
        raise StructuredTextError(f"{what} must be {kind}: {first}") from None
    return content


def load_json(text: str, what: object) -> Any:
    """Content of a JSON text that `what` names.

    Raises
    ------
    StructuredTextError
        Not JSON, nested too deep, an integer too long.
    """
    return _load(text, what, "JSON", json.loads)


def load_toml(text: str, what: object) -> Any:
    """Content of a TOML text; raises as `load_json`."""
    return _load(text, what, "TOML", tomllib.loads)


def load_yaml(text: str, what: object) -> Any:
    """Content of a YAML text without aliases; raises as `load_json`.

    Examples
    --------
    >>> load_yaml("a: [1, 2]", "settings")
    {'a': [1, 2]}
    >>> load_yaml("[" * 200, "settings")  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    ...
    pointing_analysis.files.structured_text.StructuredTextError: settings must be nested at most 50 levels deep, ...
    """
    return _load(text, what, "YAML", lambda text: _safe_yaml(text, what))


def _safe_yaml(text: str, what: object) -> Any:
    """By the parser in C, ten times as fast, where PyYAML has it; what it refuses, PyYAML's own parser explains."""
    try:
        return _yaml_by(_FAST_LOADER, text, what)
    except (yaml.YAMLError, UnicodeError):
        return _yaml_by(yaml.SafeLoader, text, what)


def _yaml_by(loader: Any, text: str, what: object) -> Any:
    depth = 0
    for event in yaml.parse(text, Loader=loader):
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1
        elif isinstance(event, yaml.AliasEvent):
            raise StructuredTextError(f"{what} must be YAML without aliases, got *{event.anchor}")
        if depth > MAX_DEPTH:
            raise StructuredTextError(f"{what} must be nested at most {MAX_DEPTH} levels deep, got more")
    return yaml.load(text, loader)
