"""Types of ROS messages from definitions in IDL (``ros2idl``), the second language in which bags carry them.

Read as far as the layout of the messages needs: modules, structures, type definitions, sequences, arrays, strings (OMG
IDL 4.2, as rosidl writes it). Annotations, comments and constants do not affect the layout.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

from lftkit.errors import InputError
from pointing_analysis.read.mcap.records import BagError
from pointing_analysis.read.messages.ros_definitions import BUILT_IN, Definitions, Field, short_name

PRIMITIVES = {
    "boolean": "bool",
    "octet": "uint8",
    "char": "uint8",
    "wchar": "uint16",
    "float": "float32",
    "double": "float64",
    "short": "int16",
    "long": "int32",
    "long long": "int64",
    "unsigned short": "uint16",
    "unsigned long": "uint32",
    "unsigned long long": "uint64",
}
"""Types of IDL and those of ROS with their layout; ``int8`` and so on are the same in both."""
_LEFT_OUT = re.compile(
    r"(?s:/\*.*?\*/)|//[^\n]*|^=+[^\n]*$|^IDL:[^\n]*$|^\#[^\n]*$"
    r"|@\w+(?:::\w+)*(?:\s*\((?:\"(?:\\.|[^\"\\])*\"|[^()\"])*\))?",
    re.MULTILINE,
)
"""Comments, annotations, and the lines between definitions."""
_TOKEN = re.compile(r"\"(?:\\.|[^\"\\])*\"|[\w:.+-]+|[{}<>\[\](),;=]")
_WORDS = ("unsigned", "long", "short")


def parse_idl(schema: str, text: str) -> Definitions:
    """Types of a definition by their short names.

    Raises
    ------
    BagError
        The text is not IDL, or has kinds of types that messages of ROS do not have.

    Examples
    --------
    >>> parse_idl("my/msg/Los", "module my { module msg { struct Los { double az; double el; }; }; };")["my/Los"][1]
    Field(type='float64', name='el', count=None)
    """
    types: dict[str, tuple[Field, ...]] = dict(BUILT_IN)
    try:
        reader = _Reader(_TOKEN.findall(_LEFT_OUT.sub(" ", text)), types)
        reader.members_of_modules(())
    except (StopIteration, RecursionError, ValueError) as error:
        raise BagError(f"the definition of {schema} must be IDL, got {error or 'a truncated one'}") from None
    if short_name(schema) not in types:
        raise BagError(
            f"the definition of {schema} must hold it, got {', '.join(set(types) - set(BUILT_IN)) or 'none'}"
        )
    return types


class _Reader:
    """Tokens of a definition, read from the left."""

    def __init__(self, tokens: list[str], types: dict[str, tuple[Field, ...]]) -> None:
        self._tokens: Iterator[str] = iter(tokens)
        self._next: str | None = next(self._tokens, None)
        self._types, self._aliases = types, dict[str, tuple[str, int | None]]()

    def _take(self, expected: str = "") -> str:
        token = self._next
        if token is None:
            raise InputError("a truncated one")
        if expected and token != expected:
            raise InputError(f"{token[:40]!r} instead of {expected!r}")
        self._next = next(self._tokens, None)
        return token

    def members_of_modules(self, scope: tuple[str, ...]) -> None:
        """All that a module holds, or the file."""
        while self._next not in (None, "}"):
            kind = self._take()
            if kind == "module":
                name = self._take()
                self._take("{")
                self.members_of_modules((*scope, name))
                self._take("}")
            elif kind == "struct":
                name, fields = self._take(), []
                self._take("{")
                while self._next != "}":
                    base, count = self._type()
                    member, size = self._declared()
                    self._take(";")
                    fields.append(Field(base, member, _in_all(count, size)))
                self._take("}")
                self._types[short_name("/".join((*scope, name)))] = tuple(fields)
            elif kind == "typedef":
                base, count = self._type()
                name, size = self._declared()
                self._aliases[name] = base, _in_all(count, size)
            elif kind == "const":
                while self._next not in (None, ";"):
                    self._take()
            else:
                raise InputError(f"{kind[:40]!r}, which messages of ROS do not have")
            self._take(";")

    def _declared(self) -> tuple[str, int | None]:
        """Name of a member, and its number of elements where it is an array."""
        name, size = self._take(), None
        while self._next == "[":
            self._take("[")
            size = (size or 1) * int(self._take())
            self._take("]")
        return name, size

    def _type(self) -> tuple[str, int | None]:
        """Type of a member, and its number of elements: None for a single one, 0 for a sequence."""
        name = self._take()
        while name.split(" ")[-1] in _WORDS and self._next in _WORDS:
            name += f" {self._take()}"
        if name == "sequence":
            self._take("<")
            kind, count = self._type()
            if count is not None:
                raise InputError("a sequence of sequences or arrays")
            self._bound()
            return kind, 0
        if name in ("string", "wstring"):
            if self._next == "<":
                self._take("<")
                self._bound()
            return name, None
        return self._aliases.get(name, (PRIMITIVES.get(name, short_name(name.replace("::", "/"))), None))

    def _bound(self) -> None:
        """The end of a type in brackets, with or without a bound."""
        if self._next == ",":
            self._take(",")
        if self._next != ">":
            self._take()
        self._take(">")


def _in_all(count: int | None, size: int | None) -> int | None:
    """Number of elements of an array of a type."""
    if size is None:
        return count
    if count == 0:
        raise InputError("an array of sequences")
    return (count or 1) * size
