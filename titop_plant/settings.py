"""Settings with description, unit and bounds, checked when they are made; a mistake is an error of one line.

A class of settings is a frozen pydantic dataclass that inherits from :class:`Settings`; its fields are made by
:func:`setting`. What is absent is ``None``. ROS parameters and the metadata of bags have no word for that:
:meth:`Settings.to_plain` writes ``""``, ``0``, ``-1`` or an empty list in its place, and these are read as absent.
"""

from __future__ import annotations

import difflib
import json
import math
from collections.abc import Callable, Mapping
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

PLAIN_ABSENT: Mapping[type, Any] = MappingProxyType({str: "", float: 0.0, int: -1, tuple: ()})
"""Representation of an absent value without ``None``, by the type of the setting."""

KINDS = MappingProxyType(
    {bool: "true or false", int: "a whole number", float: "a number", str: "a text", tuple: "a list of numbers"}
)

ANY = -1
"""Length of a list of any length, 1 or more."""

STRICT = ConfigDict(strict=True, allow_inf_nan=False)
"""Checks of a class of settings: neither a truth value nor a text is a number, and numbers are finite."""


def setting(
    default: Any,
    description: str,
    unit: str = "",
    low: float | None = None,
    high: float | None = None,
    *,
    absent: str = "",
    choices: tuple[str, ...] = (),
    length: int | None = None,
) -> Any:
    """Field of a class of settings.

    Parameters
    ----------
    default : object
        ``None`` for a setting that may be absent.
    description, unit : str
        For the user; the unit is empty for a number without one.
    low, high : float, optional
        Inclusive bounds of a number.
    absent : str
        What holds where the setting is absent.
    choices : tuple of str
        All values that a text may have; empty for any text.
    length : int, optional
        How many numbers a list holds; `ANY` for any number of them.
    """
    extra: Any = {"unit": unit, "low": low, "high": high, "absent": absent, "choices": choices, "length": length}
    extra["group"] = ""
    limits = {"ge": low, "le": high} if length is None else {"min_length": length, "max_length": length}
    if length == ANY:
        limits = {"min_length": 1}
    bounds: dict[str, Any] = limits
    return Field(default=default, description=description, json_schema_extra=extra, **bounds)


def grouped(group: str, field: Any) -> Any:
    """A field of :func:`setting` under a heading of the help page; the others are those that a first run needs."""
    field.json_schema_extra["group"] = group
    return field


@dataclass(frozen=True)
class Setting:
    """Field of a class of settings: arguments of :func:`setting`, its name, and its type.

    `kind` is ``bool``, ``int``, ``float``, ``str`` or ``tuple`` (of numbers); `optional` says whether it may be absent.
    """

    name: str
    kind: type
    optional: bool
    default: Any
    description: str
    unit: str
    low: float | None
    high: float | None
    absent: str
    choices: tuple[str, ...]
    length: int | None
    group: str

    @classmethod
    def of(cls, name: str, field: FieldInfo) -> Setting:
        """Of a field of a class of settings."""
        kinds = [kind for kind in get_args(field.annotation) if kind is not type(None)]
        optional = len(kinds) < len(get_args(field.annotation))
        annotation: Any = kinds[0] if optional else field.annotation
        arguments: Any = field.json_schema_extra
        return cls(
            name, get_origin(annotation) or annotation, optional, field.default, str(field.description), **arguments
        )

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
        return "" if self.low is None else f"between {self.low:g} and {self.high:g}{unit}"

    def plain(self, value: Any) -> Any:
        """The value without ``None`` and tuples."""
        value = PLAIN_ABSENT[self.kind] if value is None else value
        return list(value) if isinstance(value, tuple) else value

    def read(self, value: Any) -> Any:
        """The value in the type of the setting where that is the same value; ``None`` if it means absent."""
        if isinstance(value, list):
            value = tuple(value)
        if isinstance(value, bool) or not isinstance(value, (str, int, float, tuple)):
            return value
        if self.optional and value == PLAIN_ABSENT[self.kind]:
            return None
        if self.kind is float and isinstance(value, int):
            return _as_float(value)
        return int(value) if self.kind is int and isinstance(value, float) and value.is_integer() else value

    def mistake(self, kind: str, value: Any) -> str:
        """One line about a value that does not fit; `kind` is what pydantic calls the mistake."""
        if self.choices:
            return f"{self.name} must be {self.range}, got {value!r}"
        if kind in ("too_short", "too_long"):
            number = "1 number or more" if self.length == ANY else f"{self.length} numbers"
            return f"{self.name} must hold {number}, got {len(value)}"
        if kind in ("greater_than_equal", "less_than_equal", "finite_number"):
            return f"{self.name} must be {self.range}, got {_as_float(value):g}"
        return f"{self.name} must be {KINDS[self.kind]}, got {value!r}"


def _as_float(value: float) -> float:
    """Number as a float; infinite where it is a whole number of more than 308 digits."""
    try:
        return float(value)
    except OverflowError:
        return math.inf


def unknown(name: str, known: Mapping[str, Any]) -> str:
    """Message about a name that is not a parameter."""
    near = difflib.get_close_matches(name, known, 1)
    hint = f"did you mean {near[0]}?" if near else f"expected one of {', '.join(known)}"
    return f"unknown parameter {name!r}: {hint}"


def settings_class(kind: type[T]) -> type[T]:
    """Complete a class of settings: its table, and every mistake in its values a ``ValueError`` of one line."""
    made: Any = kind
    table: Mapping[str, FieldInfo] = made.__pydantic_fields__
    own_first = sorted(table, key=lambda name: name not in made.__annotations__)
    known = made.SETTINGS = MappingProxyType({name: Setting.of(name, table[name]) for name in own_first})
    check: Callable[..., None] = made.__init__

    @wraps(check)
    def __init__(self: Any, **values: Any) -> None:  # noqa: N807 (it replaces the one of the class)
        for name in values:
            if name not in known:
                raise InputError(unknown(name, known))
        try:
            check(self, **values)
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            if first["type"] == "value_error":  # of a check of the class
                raise first["ctx"]["error"] from None
            raise InputError(known[str(first["loc"][0])].mistake(first["type"], first["input"])) from None

    made.__init__ = __init__
    return kind


@settings_class
@pydantic_dataclass(frozen=True, kw_only=True, config=STRICT)
class Settings:
    """Base of the classes of settings."""

    SETTINGS: ClassVar[Mapping[str, Setting]]
    """The settings by name, those that a class adds before those that it inherits."""

    @field_validator("*", mode="before")
    @classmethod
    def _read(cls, value: Any, info: ValidationInfo) -> Any:
        return cls.SETTINGS[str(info.field_name)].read(value)

    @field_validator("*", mode="after")
    @classmethod
    def _check(cls, value: Any, info: ValidationInfo) -> Any:
        own = cls.SETTINGS[str(info.field_name)]
        if own.choices and value is not None and value not in own.choices:
            raise InputError(own.mistake("", value))
        if own.length and value is not None and own.low is not None and own.high is not None:
            for outside in (number for number in value if not own.low <= number <= own.high):
                raise InputError(own.mistake("finite_number", outside))
        return value

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any]) -> Self:
        """Make settings from names and values.

        Raises
        ------
        ValueError
            No mapping, an unknown name (the nearest known one is proposed) or a value that does not fit.
        """
        if not isinstance(values, Mapping):
            raise InputError(f"settings must be names with values, got {type(values).__name__}")
        return cls(**{str(name): value for name, value in values.items()})

    def to_mapping(self) -> dict[str, Any]:
        """Names and values; an absent one is ``None``, a list of numbers a list."""
        values = {name: getattr(self, name) for name in self.SETTINGS}
        return {name: list(value) if isinstance(value, tuple) else value for name, value in values.items()}

    def to_plain(self) -> dict[str, Any]:
        """Names and values as files, ROS parameters and bags hold them, without ``None``."""
        return {name: own.plain(getattr(self, name)) for name, own in self.SETTINGS.items()}

    def to_strings(self) -> dict[str, str]:
        """The same as text, for the metadata of a bag."""
        return {name: v if isinstance(v, str) else json.dumps(v) for name, v in self.to_plain().items()}
