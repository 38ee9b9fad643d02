"""Settings and keys of tables with description, unit and bounds, checked when they are made; a mistake is one line.

A class of settings is a frozen pydantic dataclass that inherits from :class:`CheckedTable`; its fields are made by
:func:`setting`. Checks and messages are made from them, so that a key is described in one place. What is absent is
``None``.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import wraps
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar, get_args, get_origin

from pydantic import ConfigDict, Field, ValidationError, ValidationInfo, field_validator
from pydantic.dataclasses import dataclass as pydantic_dataclass
from pydantic.fields import FieldInfo

from lftkit.errors import InputError

if TYPE_CHECKING:
    from typing_extensions import Self

T = TypeVar("T")

PLAIN_ABSENT: Mapping[type, Any] = MappingProxyType({str: "", float: 0.0, int: -1, tuple: (), dict: {}})
"""Representation of an absent value without ``None``, by the type of the setting."""

KINDS = MappingProxyType({bool: "true or false", int: "a whole number", float: "a number", str: "a text"})

ANY, ANY_OR_NONE = -1, -2
"""Length of a list of any length, 1 or more; also none."""

STRICT = ConfigDict(strict=True, allow_inf_nan=False)
"""Checks of a class of settings: neither a truth value nor a text is a number, and numbers are finite."""


class Excluded(float):
    """A bound that a number itself must not have."""


POSITIVE = Excluded(0.0)


class Named(dict[str, Any]):
    """Values by name in an object of a class of settings: a mapping with a hash, which nothing changes."""

    def __hash__(self) -> int:  # type: ignore[override]
        return hash(frozenset(self.items()))


class Refused(InputError):
    """A key and what is wrong with its value, from which the reader of a file makes a message with file and line.

    The key is empty for a mistake of a whole table. Of unknown keys, one or `more`, the names that are `known` are
    given in place of the problem.
    """

    def __init__(self, key: str, problem: str = "", known: Iterable[str] = (), more: Iterable[str] = ()) -> None:
        super().__init__(key, problem)
        self.key, self.problem, self.known, self.more = key, problem, tuple(known), tuple(more)

    def __str__(self) -> str:
        if not self.known:
            return f"{self.key or 'table'} {self.problem}"
        return "; ".join(unknown(key, self.known) for key in (self.key, *self.more))

    def within(self, outer: str) -> Refused:
        """The same of a table in another one, or of a list in a table."""
        more = [f"{outer}.{key}" for key in self.more]
        return Refused(f"{outer}.{self.key}" if self.key else outer, self.problem, self.known, more)


class Missing(Refused):
    """No value of a key that must be given."""


def setting(
    default: Any,
    description: str,
    unit: str = "",
    low: float | None = None,
    high: float | None = None,
    *,
    absent: str = "",
    choices: tuple[str, ...] = (),
    length: int | tuple[int, ...] | None = None,
) -> Any:
    """Field of a class of settings.

    Parameters
    ----------
    default : object
        ``...`` for a key that must be given, ``None`` for a setting that may be absent.
    description, unit : str
        For the user; the unit is empty for a number without one.
    low, high : float, optional
        Bounds of a number, and of each number of a list; inclusive unless they are `Excluded`.
    absent : str
        What holds where the setting is absent.
    choices : tuple of str
        All values that a text may have; empty for any text.
    length : int or tuple of int, optional
        How many numbers a list holds, or how many lists, and how many numbers each of them; `ANY` for 1 or more.
        Default: of any length, also empty.
    """
    lengths = (length,) if isinstance(length, int) else length or ()
    extra: Any = {"unit": unit, "low": low, "high": high, "absent": absent}
    extra |= {"choices": choices, "lengths": lengths, "group": ""}
    return Field(default=default, description=description, json_schema_extra=extra)


def grouped(group: str, field: Any) -> Any:
    """A field of :func:`setting` under a heading of the help page; the others are those that a first run needs."""
    field.json_schema_extra["group"] = group
    return field


@dataclass(frozen=True)
class Setting:
    """Field of a class of settings: arguments of :func:`setting`, its name, and its type.

    `kind` is ``bool``, ``int``, ``float``, ``str``, ``tuple``, a mapping by names or the class of a table, `item` that
    of the items of a list or mapping; `optional` says whether it may be absent.
    """

    name: str
    kind: type
    item: Any
    optional: bool
    default: Any
    description: str
    unit: str
    low: float | None
    high: float | None
    absent: str
    choices: tuple[str, ...]
    lengths: tuple[int, ...]
    group: str
    depth: int

    @classmethod
    def of(cls, name: str, field: FieldInfo) -> Setting:
        """Of a field of a class of settings."""
        optional = type(None) in get_args(field.annotation)
        annotation: Any = get_args(field.annotation)[0] if optional else field.annotation
        item, depth = annotation, 0
        while origin := get_origin(item):
            item, depth = get_args(item)[origin is not tuple], depth + (origin is tuple)
        arguments: Any = field.json_schema_extra or setting(..., "").json_schema_extra
        kind = get_origin(annotation) or annotation
        return cls(name, kind, item, optional, field.default, field.description or "", depth=depth, **arguments)

    @property
    def text(self) -> str:
        """Description with the unit."""
        return self.description + (f" [{self.unit}]" if self.unit else "")

    @property
    def range(self) -> str:
        """Bounds or choices in words; empty where there are none."""
        if self.choices:
            return f"one of {', '.join(self.choices)}"
        unit = f" {self.unit}" if self.unit else ""
        low_open, high_open = isinstance(self.low, Excluded), isinstance(self.high, Excluded)
        if self.low is not None and self.high is not None and not (low_open or high_open):
            return f"between {self.low:g} and {self.high:g}{unit}"
        ends = (("above" if low_open else "at least", self.low), ("below" if high_open else "at most", self.high))
        found = [f"{word} {end:.12g}" for word, end in ends if end is not None]
        return " and ".join(found) + unit if found else ""

    def plain(self, value: Any) -> Any:
        """The value without ``None`` and tuples."""
        value = PLAIN_ABSENT[self.kind] if value is None else value
        return list(value) if isinstance(value, tuple) else dict(value) if isinstance(value, dict) else value

    def read(self, value: Any) -> Any:
        """The value in the type of the setting where that is the same value."""
        if isinstance(self.item, type) and issubclass(self.item, CheckedTable):
            return None if value is None else self._tables(value, self.name, self.kind is not self.item)
        if isinstance(value, (list, tuple)):
            return tuple(map(self.read, value))
        if isinstance(value, Mapping):
            return {name: self.read(entry) for name, entry in value.items()}
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            return value
        if self.item is float and isinstance(value, int):
            return _as_float(value)
        return int(value) if self.item is int and isinstance(value, float) and value.is_integer() else value

    def _tables(self, value: Any, place: str, many: bool = False) -> Any:
        """Objects of a table, of a list of tables or, by their names, of tables in a table."""
        if many and self.kind is tuple and isinstance(value, (list, tuple)):
            return tuple(self._tables(table, f"{place}[{i}]") for i, table in enumerate(value))
        if many and self.kind is not tuple and isinstance(value, Mapping):
            return {name: self._tables(table, f"{place}.{name}") for name, table in value.items()}
        if many or not isinstance(value, (Mapping, self.item)):
            raise Refused(place, f"must be {'tables' if many else 'a table'}, got {value!r}")
        try:
            return self.item.of_table(value) if isinstance(value, Mapping) else value
        except Refused as error:
            raise error.within(place) from None

    def check(self, value: Any, name: str = "", depth: int = 0) -> None:
        """Refuse a value out of its range, also in a list, and a list of another length."""
        name = name or self.name
        if isinstance(value, tuple):
            length = self._length(depth)
            if length not in (ANY_OR_NONE, len(value)) and not (length == ANY and value):
                raise Refused(name, f"must hold {self._list(depth)}, got {len(value)}")
            for i, item in enumerate(value):
                self.check(item, f"{name}[{i}]", depth + 1)
        elif isinstance(value, Mapping):
            for key, item in value.items():
                self.check(item, f"{name}.{key}", depth)
        elif self.choices and value is not None and value not in self.choices:
            raise Refused(name, f"must be {self.range}, got {value!r}")
        elif isinstance(value, (int, float)) and not self._holds(value):
            raise Refused(name, f"must be {self.range or 'a number'}, got {written(value)}")

    def _holds(self, value: float) -> bool:
        """Whether a number is within the bounds."""
        low = self.low is None or value > self.low or (value == self.low and not isinstance(self.low, Excluded))
        high = self.high is None or value < self.high or (value == self.high and not isinstance(self.high, Excluded))
        return low and high

    def _list(self, depth: int) -> str:
        """What a list holds, in words."""
        count = self._length(depth)
        inner = f" of {self._list(depth + 1)}" if depth + 1 < self.depth else ""
        item = "list" if inner else "number" if self.item in (int, float) else "text"
        if count == ANY:
            return f"1 {item}{inner} or more"
        items = item if count == 1 else f"{item}s"
        return items + inner if count == ANY_OR_NONE else f"{count} {items}{inner}"

    def _length(self, depth: int) -> int:
        """Length of a list in so many others."""
        return self.lengths[depth] if depth < len(self.lengths) else ANY_OR_NONE

    def mistake(self, place: tuple[int | str, ...], kind: str, value: Any) -> Refused:
        """What is wrong with a value at a place of the field; `kind` is what pydantic calls the mistake."""
        name = self.name + "".join(f"[{i}]" if isinstance(i, int) else f".{i}" for i in place)
        if kind == "finite_number":
            both = self.low is not None and self.high is not None
            return Refused(
                name, f"must be {self.range if both else self._needed('a finite number')}, got {_as_float(value):g}"
            )
        depth = len([i for i in place if isinstance(i, int)])
        if depth < self.depth:
            needed = f"a list of {self._list(depth)}"
        elif self.kind is dict and not place:
            needed = "names with numbers"
        else:
            needed = self._needed(KINDS[self.item])
        return Refused(name, f"must be {self.range if self.choices else needed}, got {written(value)}")

    def _needed(self, kind: str) -> str:
        """A kind of value and its range, of a text what it is for."""
        more = f"({self.description})" if self.item is str and self.description else self.range
        return f"{kind} {more}".rstrip()


def written(value: Any) -> str:
    """A value of a key as it is written in a file: :meth:`Setting.read` makes lists tuples, integers floats."""
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(written, value))}]"
    return f"{value:.12g}" if isinstance(value, float) else repr(value)


def _as_float(value: float) -> float:
    """Number as a float; infinite where it is a whole number of more than 308 digits."""
    try:
        return float(value)
    except OverflowError:
        return math.inf


def proposal(name: str, known: Iterable[str]) -> str:
    """End of a sentence about a name that is not known: the nearest one that is, else all of them.

    Examples
    --------
    >>> proposal("durtion", ["duration", "seed"]), proposal("colour", ["duration", "seed"])
    (': did you mean duration?', ', expected one of: duration, seed')
    """
    names = tuple(known)
    near = nearest(name, names)
    return f": did you mean {near}?" if near else f", expected one of: {', '.join(names) or '(none)'}"


def nearest(name: str, known: Iterable[str]) -> str:
    """The known name that is most like one that is not; empty where none is like it."""
    return "".join(difflib.get_close_matches(name, known, 1))


def unknown(key: str, known: Iterable[str]) -> str:
    """Message about a key that is not known, of its last part in a table of tables."""
    return f"unknown parameter {key!r}{proposal(key.rpartition('.')[2], known)}"


def refuse_unknown(table: Iterable[str], known: Iterable[str], outer: str = "") -> None:
    """Refuse the keys of a table that are not known; `outer` is the name of the table.

    Raises
    ------
    Refused
        There is one.
    """
    names = tuple(known)
    if keys := [f"{outer}.{key}" if outer else key for key in table if key not in names]:
        raise Refused(keys[0], known=names, more=keys[1:])


def settings_class(kind: type[T]) -> type[T]:
    """Complete a class of settings: its table, and every mistake in its values a ``ValueError`` of one line."""
    made: Any = kind
    table: Mapping[str, FieldInfo] = {k: v for k, v in made.__pydantic_fields__.items() if not v.exclude}
    own_first = sorted(table, key=lambda name: name not in made.__annotations__)
    known = made.SETTINGS = MappingProxyType({name: Setting.of(name, table[name]) for name in own_first})
    check: Callable[..., None] = made.__init__

    @wraps(check)
    def __init__(self: Any, *in_order: Any, **values: Any) -> None:  # noqa: N807 (it replaces the one of the class)
        for name in values:
            if name not in made.__pydantic_fields__:
                raise InputError(unknown(name, known))
        try:
            check(self, *in_order, **values)
        except ValidationError as error:
            mistakes = error.errors(include_url=False)
            first = min(mistakes, key=lambda one: one["type"] == "missing")
            if first["type"] == "missing":
                names = [repr(known[str(one["loc"][0])].name) for one in mistakes]
                raise Missing("", f"has no {' and '.join(filter(None, (', '.join(names[:-1]), names[-1])))}") from None
            if first["type"] == "value_error":  # of a check of the class
                raise first["ctx"]["error"] from None
            raise known[str(first["loc"][0])].mistake(first["loc"][1:], first["type"], first["input"]) from None

    made.__init__ = __init__
    return kind


@settings_class
@pydantic_dataclass(frozen=True, kw_only=True, config=STRICT)
class CheckedTable:
    """Base of the classes of settings and of tables."""

    SETTINGS: ClassVar[Mapping[str, Setting]]
    """The settings by name, those that a class adds before those that it inherits."""

    def __post_init__(self) -> None:
        """Refuse values that do not fit together."""

    @field_validator("*", mode="before")
    @classmethod
    def _read(cls, value: Any, info: ValidationInfo) -> Any:
        own = cls.SETTINGS.get(str(info.field_name))
        return value if own is None else own.read(value)

    @field_validator("*", mode="after")
    @classmethod
    def _check(cls, value: Any, info: ValidationInfo) -> Any:
        if own := cls.SETTINGS.get(str(info.field_name)):
            own.check(value)
        return Named(value) if isinstance(value, dict) else value

    @classmethod
    def of_table(cls, table: Mapping[str, Any], **parts: Any) -> Self:
        """Make the object of a table, of which `parts` replace values.

        Raises
        ------
        Refused
            A key that is unknown or missing, a value that does not fit.
        """
        refuse_unknown(table, cls.SETTINGS)
        return cls.of_part(table, **parts)

    @classmethod
    def of_part(cls, table: Mapping[str, Any], **parts: Any) -> Self:
        """The same of a table with further keys, which others read."""
        return cls(**{**{key: value for key, value in table.items() if key in cls.SETTINGS}, **parts})

    @classmethod
    def missing(cls, table: Mapping[str, Any]) -> list[str]:
        """Keys that the table lacks, but for those whose default is none or empty."""
        return [name for name, one in cls.SETTINGS.items() if one.default not in (None, "", ()) and name not in table]

    @classmethod
    def check_given(cls, table: Mapping[str, Any]) -> None:
        """Refuse an unknown key or a value that does not fit; what is missing comes from elsewhere."""
        with suppress(Missing):
            cls.of_table(table)

    def to_mapping(self) -> dict[str, Any]:
        """Names and values; an absent one is ``None``, a list of numbers a list."""
        values = {name: getattr(self, name) for name in self.SETTINGS}
        return {name: list(value) if isinstance(value, tuple) else value for name, value in values.items()}
