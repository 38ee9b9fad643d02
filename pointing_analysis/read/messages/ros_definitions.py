"""Numbers in ROS messages of any type, by the definitions that a bag carries.

A definition (``ros2msg``) is text: one line a field, the types it contains after a separator. Here it is read as far as
two or three numbers of a message can be found in its bytes (plain CDR); nothing is generated or imported.
"""

from __future__ import annotations

import contextlib
import re
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from lftkit.support.input_limits import MESSAGE_DEPTH, MESSAGE_ELEMENTS, MESSAGE_FIELDS
from pointing_analysis.arrays import BoolArray, FloatArray
from pointing_analysis.read.mcap.records import BagError
from pointing_analysis.read.messages.cdr import Cursor, byte_order, column, same_order

SIZES = {
    "bool": 1,
    "byte": 1,
    "char": 1,
    "int8": 1,
    "uint8": 1,
    "int16": 2,
    "uint16": 2,
    "int32": 4,
    "uint32": 4,
    "int64": 8,
    "uint64": 8,
    "float32": 4,
    "float64": 8,
}
FLOATS = {"float32": "f4", "float64": "f8"}
_WORDS = {2: "two", 4: "four"}
STAMP = "builtin_interfaces/Time"
HEADER = "std_msgs/Header"
QUANTITIES: Mapping[tuple[str, str], str] = MappingProxyType(
    {
        ("geometry_msgs/Accel", "angular"): "an angular acceleration [rad/s2]",
        ("geometry_msgs/Accel", "linear"): "an acceleration [m/s2]",
        ("geometry_msgs/Inertia", "com"): "a position [m]",
        ("geometry_msgs/Pose", "position"): "a position [m]",
        ("geometry_msgs/Pose2D", ""): "a position [m] and a heading",
        ("geometry_msgs/Transform", "translation"): "a position [m]",
        ("geometry_msgs/Twist", "angular"): "an angular velocity [rad/s]",
        ("geometry_msgs/Twist", "linear"): "a velocity [m/s]",
        ("geometry_msgs/Wrench", "force"): "a force [N]",
        ("geometry_msgs/Wrench", "torque"): "a torque [Nm]",
        ("sensor_msgs/FluidPressure", ""): "a pressure [Pa] and its variance",
        ("sensor_msgs/Illuminance", ""): "an illuminance [lx] and its variance",
        ("sensor_msgs/Imu", "angular_velocity"): "an angular velocity [rad/s]",
        ("sensor_msgs/Imu", "linear_acceleration"): "an acceleration [m/s2]",
        ("sensor_msgs/JointState", "effort"): "forces or torques",
        ("sensor_msgs/JointState", "velocity"): "velocities",
        ("sensor_msgs/MagneticField", "magnetic_field"): "a magnetic field [T]",
        ("sensor_msgs/NavSatFix", ""): "a place on the Earth",
        ("sensor_msgs/RelativeHumidity", ""): "a humidity and its variance",
        ("sensor_msgs/Temperature", ""): "a temperature [K] and its variance",
    }
)
"""Quantities of fields of ROS types other than angles; an empty name: the message itself.

A vector, a point or an array may hold anything: there the unit that is given counts.
"""
_FIELD = re.compile(
    r"^(?P<type>[\w/]+(?:<=\d+)?)(?P<array>\[(?P<size>[<=\d]*)\])?\s+(?P<name>[A-Za-z]\w*)\s*(?P<rest>.*)$"
)


@dataclass(frozen=True)
class Field:
    """One field: type, name, number of elements (None: a single one, 0: counted in the message)."""

    type: str
    name: str
    count: int | None


Definitions = Mapping[str, tuple[Field, ...]]

BUILT_IN: Definitions = MappingProxyType(
    {
        name: (Field("int32", "sec", None), Field("uint32", "nanosec", None))
        for name in (STAMP, "builtin_interfaces/Duration")
    }
)
"""Types that definitions need not hold."""


QUATERNION = ("x", "y", "z", "w")
"""Names of the four numbers of an attitude, in any order."""


@dataclass(frozen=True)
class Vector:
    """Two or three floats in a message type, or the four of a quaternion.

    Attributes
    ----------
    path : field that holds them; empty if the message itself
    components : names of the numbers
    stamped : whether the message begins with a header
    quantity : what they are where that is no angle, with its article and unit; else empty
    axis : of a quaternion, the axis of the body that is the line of sight: ``x``, ``y`` or ``z``; else empty
    """

    path: str
    components: tuple[str, ...]
    stamped: bool
    quantity: str = ""
    axis: str = ""

    @property
    def name(self) -> str:
        """Field and axis, as ``orientation.z``; empty for the message itself."""
        return ".".join(filter(None, (self.path, self.axis)))


def short_name(schema: str) -> str:
    """Type name without ``msg``: ``geometry_msgs/msg/Point`` is ``geometry_msgs/Point``."""
    return schema.replace("/msg/", "/")


def parse_definition(schema: str, text: str) -> Definitions:
    r"""Types of a definition by their short names.

    Examples
    --------
    >>> parse_definition("my/msg/Los", "float64 az\nfloat64 el  # up")["my/Los"][1].name
    'el'
    """
    types: dict[str, tuple[Field, ...]] = dict(BUILT_IN)
    name = short_name(schema)
    parts = re.split(r"^=+\s*$", text, flags=re.MULTILINE)
    for part in parts:
        lines = part.strip().splitlines()
        if lines and lines[0].startswith("MSG:"):
            name = short_name(lines.pop(0).removeprefix("MSG:").strip())
        types[name] = tuple(_fields(lines, name.split("/")[0]))
    return types


def _fields(lines: list[str], package: str) -> Iterator[Field]:
    for line in lines:
        match = _FIELD.match(line.split("#")[0].strip())
        if match is None or match["rest"].startswith("="):  # a comment or a constant
            continue
        kind = match["type"].split("<=")[0]
        if kind == "Header":
            kind = HEADER
        elif kind not in SIZES and kind not in ("string", "wstring", "time", "duration") and "/" not in kind:
            kind = f"{package}/{kind}"
        kind = {"time": STAMP, "duration": "builtin_interfaces/Duration"}.get(kind, short_name(kind))
        size = match["size"] or ""
        yield Field(kind, match["name"], None if match["array"] is None else int(size) if size.isdigit() else 0)


def vectors(schema: str, types: Definitions) -> tuple[Vector, ...]:
    """All groups of two or three floats of a message type, the least nested first."""
    root = short_name(schema)
    if root not in types:
        return ()
    fields = types[root]
    stamped = bool(fields) and fields[0].type == HEADER
    groups: list[_Group] = []
    # some hundred bytes of definitions can stand for any number of paths
    for number, group in enumerate(_groups(root, types, "", 0)):
        if number > MESSAGE_FIELDS:
            raise BagError(f"message type must have at most {MESSAGE_FIELDS} fields, got more in {root}")
        if group is not None:
            groups.append(group)
    groups.sort(key=lambda group: group[0].count("."))
    return tuple(Vector(path, names, stamped, quantity, axis) for path, names, quantity, axis in groups)


_Group = tuple[str, tuple[str, ...], str, str]


def _groups(kind: str, types: Definitions, path: str, depth: int, quantity: str = "") -> Iterator[_Group | None]:
    """Path, names, quantity (it holds for all that is inside) and axis of attitude of each group, else None."""
    fields = types.get(kind, ())
    names = tuple(f.name for f in fields if f.type in FLOATS and f.count is None)
    if 2 <= len(names) <= 3:
        yield path, names, quantity or QUANTITIES.get((kind, ""), ""), ""
    if len(names) == len(fields) == 4 and sorted(names) == sorted(QUATERNION):
        for axis in "xyz":
            yield path, names, quantity, axis
    for f in fields:
        inner = f"{path}.{f.name}" if path else f.name
        what = quantity or QUANTITIES.get((kind, f.name), "")
        if f.type in FLOATS and f.count in (2, 3):
            yield inner, tuple(f"{f.name}[{i}]" for i in range(int(f.count))), what, ""
        elif f.type in FLOATS and f.count == 0:
            yield inner, (f"{f.name}[0]", f"{f.name}[1]"), what, ""
        else:
            yield None
        if f.count is None and f.type in types and f.type != HEADER and depth < MESSAGE_DEPTH:
            yield from _groups(f.type, types, inner, depth + 1, what)


class _Reader(Cursor):
    """Walks through a payload, remembering the length fields that fix its layout and the places of floats by field.

    With a `target` it ends behind the first numbers of this field, as many as are `wanted`.
    """

    def __init__(
        self, payload: bytes, types: Definitions, order: str, target: str | None = None, wanted: int = 2
    ) -> None:
        super().__init__(payload, order)
        self.types, self.target, self.wanted, self.passed = types, target, wanted, 0
        # Of a field the places of its numbers, and how many length fields are before them
        self.places: dict[str, tuple[list[tuple[int, str]], int]] = {}

    def message(self, kind: str, path: str | None, depth: int = 0) -> bool:
        """Walk through a message; True once the target is behind. Elements of an array of messages have no path."""
        if depth > MESSAGE_DEPTH:
            raise BagError(f"message type must have at most {MESSAGE_DEPTH} levels, got more in {kind}")
        for f in self.types[kind]:
            inner = None if path is None else f"{path}.{f.name}" if path else f.name
            count = 1 if f.count is None else f.count or self.length()
            self.passed += 1 if f.type in SIZES else count
            if max(count, self.passed) > MESSAGE_ELEMENTS:
                raise BagError(f"{f.name} of {kind} must have at most {MESSAGE_ELEMENTS} elements, got more")
            if f.type in SIZES:
                if count:
                    self.align(SIZES[f.type])
                if f.type in FLOATS:
                    self.note(path if f.count is None else inner, f.type, count)
                self.at += SIZES[f.type] * count
                if self.target in self.places and len(self.places[self.target][0]) >= self.wanted:
                    return True
                continue
            for _ in range(count):
                if f.type in ("string", "wstring"):
                    length = self.length()
                    self.at += length * (4 if f.type == "wstring" else 1)
                elif f.type not in self.types:
                    raise BagError(f"definition must contain the type {f.type} of the field {f.name}, got none")
                elif self.message(f.type, inner if f.count is None else None, depth + 1):
                    return True
        return False

    def note(self, owner: str | None, kind: str, count: int) -> None:
        """Floats of a field at this place."""
        if owner is None:
            return
        known, _ = self.places.get(owner, ([], 0))
        if len(known) < self.wanted:
            new = [(self.at + i * SIZES[kind], FLOATS[kind]) for i in range(min(count, max(3, self.wanted)))]
            self.places[owner] = known + new, len(self.lengths)


@dataclass(frozen=True)
class Places:
    """Positions of numbers in messages of one size.

    Attributes
    ----------
    numbers : offset and numpy type of each
    lengths : offset and value of the length fields before them; a message with others is laid out otherwise
    order : ``<`` or ``>``
    """

    numbers: tuple[tuple[int, str], ...]
    lengths: tuple[tuple[int, int], ...]
    order: str


def locate(schema: str, types: Definitions, path: str, payload: bytes, count: int = 2) -> Places:
    """Find the first two numbers of a field in one message, or the first `count`.

    Raises
    ------
    BagError
        Not plain CDR, a truncated message, or a field with fewer numbers.
    """
    reader = _Reader(payload, types, byte_order(schema, payload), path, count)
    try:
        reader.message(short_name(schema), "")
    except struct.error:
        raise BagError(f"{schema}: the payload of {len(payload)} bytes is truncated") from None
    places = _places(reader, path)
    if places is None:
        raise BagError(f"{schema}: {path or 'the message'} must have {_WORDS[count]} numbers, got fewer")
    return places


def located(schema: str, types: Definitions, payload: bytes) -> frozenset[str]:
    """Fields whose first two numbers :func:`locate` finds in one message, in one walk through it."""
    reader = _Reader(payload, types, byte_order(schema, payload))
    with contextlib.suppress(struct.error, BagError, KeyError):  # what comes before is there
        reader.message(short_name(schema), "")
    return frozenset(path for path in reader.places if _places(reader, path) is not None)


def _places(reader: _Reader, path: str) -> Places | None:
    places, lengths = reader.places.get(path, ([], 0))
    numbers = tuple(places[: reader.wanted])
    if len(numbers) < reader.wanted or any(at + int(kind[1]) > len(reader.payload) for at, kind in numbers):
        return None
    return Places(numbers, tuple(reader.lengths[:lengths]), reader.order)


def numbers(rows: NDArray[np.uint8], places: Places) -> tuple[FloatArray, BoolArray]:
    """Numbers (m, 2 or 4) of messages (m, size) of one size, and which of them have this layout."""
    fits = same_order(rows, places.order)
    for at, value in places.lengths:
        fits &= column(rows, at, places.order + "u4")[:, 0] == value
    columns = [column(rows, at, places.order + kind).astype(np.float64) for at, kind in places.numbers]
    return np.hstack(columns), fits
