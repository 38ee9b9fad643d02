"""Arguments of other types than those of the signature: one line, in place of an exception from inside.

A public function is tried with what came: what works, works, and costs nothing. Where it ends with a TypeError or the
like, its arguments are compared with the types of its signature, and the first one of another type is named. Where all
fit, integers beyond 64 bits, which are objects for numpy, are tried as floats; without such ones the exception is a
fault of the program and stays as it is.
"""

from __future__ import annotations

import builtins
import functools
import inspect
import operator
import os
import types
import typing
from collections.abc import Callable, Iterable, Iterator, Mapping, Sized
from typing import Any, TypeVar, Union

import numpy as np
from numpy.typing import ArrayLike

from lftkit.errors import InputError
from lftkit.support.scalars import LONGEST, fits_64_bits, is_number

F = TypeVar("F", bound=Callable[..., Any])
FAULTS = (TypeError, AttributeError, LookupError, OverflowError, ValueError)
"""What Python raises for values of other types, and numpy for sizes beyond those of an array."""
TAKEN = "System", "Port"
"""Types for which many functions take others: numbers and expressions, names and sizes."""
WORDS: dict[Any, tuple[str, str]] = {
    float: ("a number", "numbers"),
    complex: ("a number", "numbers"),
    int: ("an integer", "integers"),
    str: ("text", "names"),
    bool: ("True or False", "choices"),
    type(None): ("None", "nothing"),
}
"""A value of a type, and several."""


def checked(public: F) -> F:
    """The same function, or dataclass, that names an argument of another type.

    Examples
    --------
    >>> @checked
    ... def largest(values: dict[str, float], count: int = 1) -> list[float]:
    ...     return sorted(values.values())[-count:]
    >>> largest({"a": 1.0}, "b")
    Traceback (most recent call last):
    lftkit.errors.InputError: count must be an integer, got 'b'
    """
    if isinstance(public, type):
        public.__init__ = checked(public.__init__)  # type: ignore[misc]
        return public
    faults, misfit, refusal, as_floats = FAULTS, _misfit, InputError, _with_floats

    def call(*args: Any, **named: Any) -> Any:
        try:
            return public(*args, **named)
        except refusal:
            raise
        except faults as fault:
            text = misfit(public, args, named, fault)
            if text:
                raise refusal(text) from None
            again = as_floats(public, args, named)
            if again is None:
                raise
        return public(*again.args, **again.kwargs)

    # with the globals of its module: doctest passes over functions of others
    made = types.FunctionType(call.__code__, public.__globals__, public.__name__, None, call.__closure__)  # type: ignore[attr-defined]
    return typing.cast(F, functools.update_wrapper(made, public))


class _ModuleNames(dict[str, Any]):
    """Names of a module for its annotations; a name that it imports for types only is any type."""

    def __missing__(self, name: str) -> Any:
        return getattr(builtins, name, Any)


def _misfit(function: Callable[..., Any], args: tuple[Any, ...], named: Mapping[str, Any], fault: Exception) -> str:
    """The first argument of another type, in words; empty where all fit, or where there are too many or too few.

    A ValueError may be that of a function of the user, and say more than a doubt about what some functions take.
    """
    signature = inspect.signature(function)
    try:
        bound = signature.bind(*args, **named)
    except TypeError:
        return ""
    hints = _hints(function)
    arguments: list[tuple[str, Any, Any]] = []
    for name, value in bound.arguments.items():
        kind, hint = signature.parameters[name].kind, hints.get(name, Any)
        several = (
            {f"{name}[{k}]": one for k, one in enumerate(value)} if kind is inspect.Parameter.VAR_POSITIONAL else {}
        )
        each = value if kind is inspect.Parameter.VAR_KEYWORD else several or {name: value}
        arguments += [(what, one, hint) for what, one in each.items()]
    for strict in (False,) if isinstance(fault, ValueError) else (False, True):
        for what, value, hint in arguments:
            if not _fits(value, hint, strict):
                within = " within 64 bits" if hint is int and type(value) is int else ""
                return f"{what} must be {_words(hint)}{within}, got {value!r}"[:LONGEST]
    return ""


def _hints(function: Callable[..., Any]) -> dict[str, Any]:
    stated = types.SimpleNamespace(__annotations__={**function.__annotations__, "return": Any})
    return typing.get_type_hints(stated, {}, _ModuleNames(function.__globals__))  # type: ignore[attr-defined]


def _with_floats(
    function: Callable[..., Any], args: tuple[Any, ...], named: Mapping[str, Any]
) -> inspect.BoundArguments | None:
    """The arguments with floats for integers beyond 64 bits, where their types take floats; None without such ones."""
    try:
        bound = inspect.signature(function).bind(*args, **named)
    except TypeError:
        return None
    hints = _hints(function)
    large = {
        name: float(value)
        for name, value in bound.arguments.items()
        if isinstance(value, int) and not fits_64_bits(value) and _fits(0.5, hints.get(name, Any), True)
    }
    bound.arguments.update(large)
    return bound if large else None


def _fits(value: Any, hint: Any, strict: bool) -> bool:
    """Whether a value is of a type; `strict`: none that only some functions take for it, and none without content."""
    origin, parts = typing.get_origin(hint), typing.get_args(hint)
    if _is_array(hint):
        return type(None) in parts if value is None else _is_numbers(value, strict)
    if origin in (Union, types.UnionType):
        return any(_fits(value, part, strict) for part in parts)
    if origin is tuple and Ellipsis not in parts:
        ordered = isinstance(value, list | tuple | np.ndarray) and len(value) == len(parts)
        return ordered and all(_fits(one, part, strict) for one, part in zip(value, parts))
    kind = origin or hint
    if not isinstance(kind, type):
        return True
    if issubclass(kind, Mapping):
        keys, values = parts or (Any, Any)
        pairs = value.items() if isinstance(value, Mapping) else [(None, None)]
        return isinstance(value, Mapping) and all(
            _fits(key, keys, strict) and _fits(one, values, strict) for key, one in pairs
        )
    if parts and issubclass(kind, Iterable):
        if isinstance(value, Iterator) or (parts[0] is not Any and not strict and _fits(value, parts[0], strict)):
            return True
        some = isinstance(value, Iterable) and not (strict and isinstance(value, Sized) and len(value) == 0)
        return some and all(_fits(one, parts[0], strict) for one in value)
    if strict and (kind.__name__ in TAKEN or (kind is int and isinstance(value, bool))):
        return kind is not int and isinstance(value, kind)
    return _is_a(value, kind)


def _is_a(value: Any, kind: type) -> bool:
    """Whether a value is of a class, or one that the functions of the library take for it."""
    if kind is float:
        return is_number(value)
    if kind is complex:
        return isinstance(value, complex | np.number) or is_number(value)
    if kind is int:
        try:
            return fits_64_bits(operator.index(value))
        except TypeError:
            return False
    if kind is bool:
        return isinstance(value, bool | np.bool_)
    if kind.__name__ == TAKEN[0]:
        # Whether a value may be taken for a system: an object of the packages that have some, a number, a
        # matrix
        return type(value).__module__.partition(".")[0] in ("lftkit", "control", "scipy") or _is_numbers(value, False)
    if kind.__name__ == TAKEN[1] and isinstance(value, tuple | list | str):
        return isinstance(value, str) or (len(value) in (2, 3) and isinstance(value[0], str))
    if getattr(kind, "_is_protocol", False):
        return all(hasattr(value, name) for name in vars(kind) if not name.startswith("_"))
    try:
        return isinstance(value, kind)
    except TypeError:  # Any
        return True


def _is_array(hint: Any) -> bool:
    """Whether a type is that of an array, or of one or None."""
    origin = typing.get_origin(hint)
    return origin is np.ndarray or (origin is Union and set(typing.get_args(ArrayLike)) <= set(typing.get_args(hint)))


def _is_numbers(value: Any, strict: bool) -> bool:
    try:
        array = np.asarray(value)
    except ValueError:  # rows of different lengths
        return False
    if array.dtype.kind not in "biufc":
        return False
    return not strict or (array.dtype.kind != "c" and array.size > 0 and 1 <= array.ndim <= 2)


def _words(hint: Any, several: bool = False) -> str:
    """A type in words: one value of it, or several."""
    origin, parts = typing.get_origin(hint), typing.get_args(hint)
    if _is_array(hint):
        return "arrays of numbers" if several else "an array of numbers"
    if origin in (Union, types.UnionType):
        return " or ".join(dict.fromkeys(_words(part, several) for part in parts))
    kind = origin or hint
    if kind is Callable:
        return "functions" if several else "a function"
    if hint in WORDS:
        return WORDS[hint][several]
    if kind is os.PathLike:
        return "paths" if several else "a path"
    if origin is tuple and Ellipsis not in parts:
        return f"{'tuples' if several else 'a tuple'} of {', '.join(_words(part) for part in parts)}"
    if isinstance(kind, type) and issubclass(kind, Mapping) and parts:
        return f"{'mappings' if several else 'a mapping'} from {_words(parts[0], True)} to {_words(parts[1], True)}"
    if isinstance(kind, type) and issubclass(kind, Iterable) and parts:
        return f"{'sequences' if several else 'a sequence'} of {_words(parts[0], True)}"
    name = getattr(kind, "__name__", str(kind))
    return f"{name}s" if several else f"{'an' if name[0] in 'AEIOU' else 'a'} {name}"
