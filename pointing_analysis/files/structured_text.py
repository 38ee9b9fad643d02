"""Text files of others with structure: YAML, TOML and JSON, within the limits of :mod:`lftkit.support.input_limits`.

An alias in YAML could stand for a structure of any size: there are none.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any, TypeGuard

import yaml

from lftkit.errors import InputError
from lftkit.support import input_files
from lftkit.support.file_kind import kind_of_file
from lftkit.support.input_limits import DEPTH, TEXT
from lftkit.support.structured_text import check_count, load_json, parse, too_deep

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib  # type: ignore[import-not-found]

EXPLAINED = 100_000
"""Largest text that is parsed again for the message [character]."""
_EXPONENT = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)[eE][-+]?\d+\Z")


def _with_numbers(loader: Any) -> Any:
    """A loader that takes ``5e-3`` and ``1e1`` for numbers, as YAML 1.2 and TOML do; to YAML 1.1 they are texts."""
    with_numbers: Any = type(loader.__name__, (loader,), {})
    with_numbers.add_implicit_resolver("tag:yaml.org,2002:float", _EXPONENT, list("-+.0123456789"))
    return with_numbers


_LOADER = _with_numbers(yaml.SafeLoader)
_FAST_LOADER = _with_numbers(getattr(yaml, "CSafeLoader", yaml.SafeLoader))


def read_text(path: Path, limit: int = TEXT) -> str:
    """Text of a file in UTF-8.

    Raises
    ------
    InputError
        It cannot be read, is no ordinary file, is too large, or is not UTF-8.
    """
    try:
        return input_files.read_text(path, limit)
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}") from None
    except UnicodeDecodeError:
        content = kind_of_file(path) or "other bytes"
        raise InputError(f"{path} must be text in UTF-8, got {content}") from None


def is_number(value: Any) -> TypeGuard[float]:
    """Whether a value of a file is a number; true and false are none.

    Examples
    --------
    >>> [is_number(value) for value in (1, 2.5, True, "3")]
    [True, True, False, False]
    """
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def load_toml(text: str, what: object) -> Any:
    """Content of a TOML text that `what` names; raises as `load_json`."""
    return parse(text, what, "TOML", tomllib.loads)


def load_yaml(text: str, what: object) -> Any:
    """Content of a YAML text without aliases; raises as `load_json`.

    Examples
    --------
    >>> load_yaml("a: [1, 5e-3, 1e1, e1]", "settings")
    {'a': [1, 0.005, 10.0, 'e1']}
    >>> load_yaml("[" * 200, "settings")  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    ...
    lftkit.errors.InputError: settings must be nested at most 50 levels deep, got more
    """
    return parse(text, what, "YAML", lambda text: _safe_yaml(text, what))


def _safe_yaml(text: str, what: object) -> Any:
    """By the parser in C, ten times as fast, where PyYAML has it; PyYAML's own parser explains what it refuses."""
    try:
        try:
            return _yaml_by(_FAST_LOADER, text, what)
        except (yaml.YAMLError, UnicodeError):
            if len(text) > EXPLAINED:
                raise
            return _yaml_by(_LOADER, text, what)
    except yaml.YAMLError as error:
        raise ValueError(*str(error).splitlines()[:1]) from None


def _yaml_by(loader: Any, text: str, what: object) -> Any:
    depth = 0
    for number, event in enumerate(yaml.parse(text, Loader=loader)):
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1
        elif isinstance(event, yaml.AliasEvent):
            raise InputError(f"{what} must be YAML without aliases, got *{event.anchor}")
        if depth > DEPTH:
            raise too_deep(what)
        check_count(number, what, "YAML")
    return yaml.load(text, loader)


__all__ = ["is_number", "load_json", "load_toml", "load_yaml", "read_text"]
