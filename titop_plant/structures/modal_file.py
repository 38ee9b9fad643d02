"""Modal data in a text file: user-defined bodies of the telescope.

The format is TOML, SI units, one table per mode::

    format = "los-testbed/modal-data"
    version = 1
    name = "payload"                     # used in every error message
    parent = "I_p"                       # the clamped point P
    parent_position = [0.0, 0.0, 0.0]    # m, body frame

    mass_matrix = [[...], ...]           # 6 x 6 at P: kg, kg m, kg m2
    # or, instead of mass_matrix:
    # mass = 59.0                        # kg
    # inertia_at_cg = [[...], [...], [...]]   # kg m2, tensor at the centre of mass
    # cg = [0.007, -5.517, 0.0]          # m, from P to the centre of mass

    [[child]]
    name = "M1"
    position = [0.0, 0.0, 0.62]          # m, body frame

    [[mode]]                             # clamped at P, mass-normalised
    frequency = 333.7                    # rad/s
    damping = 0.003                      # damping ratio
    participation = [0.1, 0.0, 3.2, -1.0, 0.0, 0.2]   # row of L: sqrt(kg), sqrt(kg) m

    [mode.shapes]                        # displacement of each child for eta = 1
    M1 = [0.01, 0.0, 0.2, 0.0, 0.1, 0.0]              # 1/sqrt(kg), 1/(sqrt(kg) m)

**Sign convention: eta'' + 2 zeta w eta' + w^2 eta = -L accel_P.** A row of ``L`` and the shapes of the
same mode have a common sign: changing the sign of one alone is an error that no check can detect.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from lftkit.support.input_files import read_text
from lftkit.support.structured_text import parse
from pointing_analysis.files.settings import unknown
from titop_plant.structures.kinematics import read_only
from titop_plant.structures.modal_data import ChildPort, ModalData, from_inertia
from titop_plant.structures.residual_mass import check_residual_mass

if sys.version_info >= (3, 11):
    import tomllib
else:  # pragma: no cover
    import tomli as tomllib  # type: ignore[import-not-found]

FORMAT = "los-testbed/modal-data"
VERSION = 1
_TOP = {"format", "version", "name", "parent", "parent_position", "child", "mode"}
_MASS = {"mass_matrix", "mass", "inertia_at_cg", "cg"}
_MODE = {"frequency", "damping", "participation", "shapes"}


def read_modal_data(path: str | Path, *, check_residual: bool = True) -> ModalData:
    """Read a body from a modal data file.

    Parameters
    ----------
    path : path
        A file of the format above.
    check_residual : bool
        Reject data whose residual mass is not positive semidefinite. False: accept such data, for
        :func:`~titop_plant.structures.repair_residual_mass`.

    Returns
    -------
    ModalData

    Raises
    ------
    ValueError
        Invalid file; the message names the file, the line (where it is known), the body and the key.
    FileNotFoundError
        No such file.
    """
    try:
        text = read_text(path)
        table = parse(text, "file", "TOML", tomllib.loads)
    except UnicodeDecodeError:
        raise InputError(f"{path}: file must be TOML, got text that is not UTF-8") from None
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    reader = _Reader(str(path), text, table)
    data = reader.read()
    if check_residual:
        try:
            check_residual_mass(data)
        except ValueError as error:
            raise InputError(f"{path}: {error}") from None
    return data


def write_modal_data(data: ModalData, path: str | Path, comment: str = "") -> None:
    """Write a body to a modal data file; reading it back gives the same numbers, bit for bit.

    Parameters
    ----------
    data : ModalData
    path : path
        Must not exist.
    comment : str
        Written at the top: where the data come from.

    Raises
    ------
    FileExistsError
        The file is there already.
    """
    lines = [f"# {line}".rstrip() for line in comment.splitlines()]
    lines += [
        f'format = "{FORMAT}"',
        f"version = {VERSION}",
        f"name = {_quoted(data.name)}",
        f"parent = {_quoted(data.parent)}",
        f"parent_position = {_row(data.parent_position)}  # m",
        "mass_matrix = [  # at the parent point: kg, kg m, kg m2",
        *(f"    {_row(row)}," for row in data.mass_matrix),
        "]",
    ]
    for child in data.children:
        lines += ["", "[[child]]", f"name = {_quoted(child.name)}", f"position = {_row(child.position)}  # m"]
    for k in range(data.n_modes):
        lines += [
            "",
            "[[mode]]",
            f"frequency = {float(data.frequencies[k])!r}  # rad/s",
            f"damping = {float(data.damping[k])!r}",
            f"participation = {_row(data.participation[k])}",
        ]
        lines += ["[mode.shapes]"] if data.children else []
        lines += [f"{_quoted(child.name)} = {_row(child.shapes[:, k])}" for child in data.children]
    with open(path, "x", encoding="utf-8") as stream:
        stream.write("\n".join(lines) + "\n")


def _row(values: ArrayLike) -> str:
    return "[" + ", ".join(repr(float(v)) for v in np.asarray(values)) + "]"


def _quoted(name: str) -> str:
    return '"' + name.replace("\\", "\\\\").replace('"', '\\"') + '"'


class _Reader:
    """Reader of one file; error messages name the line of a key."""

    def __init__(self, path: str, text: str, table: Mapping[str, Any]) -> None:
        self.path, self.lines, self.table = path, text.splitlines(), table
        self.body = str(table.get("name", "body without a name"))

    def read(self) -> ModalData:
        if self.table.get("format") != FORMAT or self.table.get("version") != VERSION:
            raise self.error(
                f'format and version must be "{FORMAT}" and version = {VERSION}, '
                f"got {self.table.get('format')!r} and {self.table.get('version')!r}",
                "format",
            )
        self.refuse_unknown(self.table, _TOP | _MASS)
        children = [self.child(k) for k in range(self.count("child"))]
        modes = [self.mode(k, [name for name, _ in children]) for k in range(self.count("mode"))]
        shapes = np.array([mode["shapes"] for mode in modes]).reshape(len(modes), len(children), 6)
        name, parent = self.text("name"), self.text("parent")
        position, mass_matrix = self.numbers("parent_position", (3,)), self.mass_matrix()
        try:
            return ModalData(
                name,
                parent,
                position,
                mass_matrix,
                np.array([mode["frequency"] for mode in modes]),
                np.array([mode["damping"] for mode in modes]),
                np.array([mode["participation"] for mode in modes]).reshape(len(modes), 6),
                tuple(ChildPort(child, xyz, shapes[:, i].T) for i, (child, xyz) in enumerate(children)),
            )
        except ValueError as error:
            raise InputError(f"{self.path}: {error}") from None

    def mass_matrix(self) -> FloatArray:
        if "mass_matrix" in self.table:
            extra = sorted(_MASS & set(self.table) - {"mass_matrix"})
            if extra:
                raise self.error(f"mass must be given by mass_matrix or {extra[0]}, got both", extra[0])
            return self.numbers("mass_matrix", (6, 6))
        mass = float(self.numbers("mass", ()))
        inertia, cg = self.numbers("inertia_at_cg", (3, 3)), self.numbers("cg", (3,))
        try:
            return from_inertia(mass, inertia, cg)
        except ValueError as error:
            raise self.error(str(error), str(error).split()[0]) from None

    def child(self, k: int) -> tuple[str, FloatArray]:
        self.refuse_unknown(self.table["child"][k], {"name", "position"}, "child", k)
        return self.text("name", "child", k), self.numbers("position", (3,), "child", k)

    def mode(self, k: int, children: list[str]) -> dict[str, Any]:
        table = self.table["mode"][k]
        self.refuse_unknown(table, _MODE, "mode", k)
        shapes = table.get("shapes", {})
        if not isinstance(shapes, Mapping) or set(shapes) != set(children):
            got = sorted(shapes) if isinstance(shapes, Mapping) else shapes
            raise self.error(f"shapes must have one row per child {sorted(children)}, got {got}", "shapes", "mode", k)
        rows = [self.check(shapes[name], (6,), f"shapes of {name!r}", name, "mode", k) for name in children]
        values: dict[str, Any] = {key: float(self.numbers(key, (), "mode", k)) for key in ("frequency", "damping")}
        return {**values, "participation": self.numbers("participation", (6,), "mode", k), "shapes": rows}

    def count(self, key: str) -> int:
        tables = self.table.get(key, [])
        if not isinstance(tables, list) or not all(isinstance(t, Mapping) for t in tables):
            raise self.error(f"{key} must be tables [[{key}]], got {tables!r}", key)
        return len(tables)

    def value(self, key: str, table: str = "", k: int = 0) -> Any:
        holder = self.table[table][k] if table else self.table
        if key not in holder:
            raise self.error(f"{key} must be given, got nothing", "", table, k)
        return holder[key]

    def text(self, key: str, table: str = "", k: int = 0) -> str:
        value = self.value(key, table, k)
        if not isinstance(value, str) or not value:
            raise self.error(f"{key} must be a name in quotes, got {value!r}", key, table, k)
        return value

    def numbers(self, key: str, shape: tuple[int, ...], table: str = "", k: int = 0) -> FloatArray:
        return self.check(self.value(key, table, k), shape, key, key, table, k)

    def check(
        self, value: object, shape: tuple[int, ...], what: str, key: str, table: str = "", k: int = 0
    ) -> FloatArray:
        try:
            return read_only(value, shape, what)  # type: ignore[arg-type]
        except ValueError as error:
            raise self.error(str(error), key, table, k) from None

    def refuse_unknown(self, table: Mapping[str, Any], known: set[str], name: str = "", k: int = 0) -> None:
        for key in sorted(set(table) - known):
            raise self.error(unknown(key, sorted(known)), key, name, k)

    def error(self, message: str, key: str, table: str = "", k: int = 0) -> InputError:
        line = self.line_of(key, table, k)
        where = f", line {line}" if line else ""
        which = f"{table} {k + 1}: " if table else ""
        return InputError(f"{self.path}{where}: {self.body}: {which}{message}")

    def line_of(self, key: str, table: str, k: int) -> int:
        """Line of a key (or of its table if the key is not there), 0 if neither is found."""
        start = 0
        if table:
            heads = [i for i, line in enumerate(self.lines) if re.match(rf"\s*\[\[\s*{table}\s*\]\]", line)]
            if k >= len(heads):
                return 0
            start = heads[k]
        for i in range(start, len(self.lines)):
            if i > start and re.match(r"\s*\[\[", self.lines[i]):
                break
            if key and re.match(rf"\s*\[?(mode\.)?[\"']?{re.escape(key)}[\"']?\s*[\]=]", self.lines[i]):
                return i + 1
        return start + 1 if table else 0
