"""Structure of a .mat file (version 4 to 7.2), looked through before scipy reads it.

scipy follows a file by what stands in it: an unknown data type or a deep nesting ends the process, a row index beyond a
sparse matrix writes beyond its memory, a structure without fields may have any number of elements. Here the elements
are gone through in the order in which scipy reads them; nothing is kept of them but sparse indices.

The format is MathWorks' "MAT-File Format": elements of a tag (data type, number of bytes) and data, padded to 8 bytes;
a matrix is an element of elements: flags, dimensions, name, and what its class has.
"""

from __future__ import annotations

import math
import os
import struct
import zlib
from dataclasses import dataclass, field
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from lftkit.errors import InputError
from lftkit.support.input_files import check_file
from lftkit.support.input_limits import MAT_DEPTH, MAT_ELEMENTS, TABLE, UNPACKED, most_unpacked

MATRIX, COMPRESSED = 14, 15
SIZES = {1: 1, 2: 1, 3: 2, 4: 2, 5: 4, 6: 4, 7: 4, 9: 8, 12: 8, 13: 8, 16: 1, 17: 2, 18: 4}
"""Bytes of an entry of each data type that is no matrix: integers, floats, characters."""
INT32, TEXTS = (5, 6), (1, 2, 16)
CELL, STRUCT, OBJECT, CHAR, SPARSE, FUNCTION, OPAQUE = 1, 2, 3, 4, 5, 16, 17
NUMBERS = range(6, 16)
"""Classes of matrices of numbers: double, single, integers."""
MOST_DIMENSIONS, LONGEST_NAME = 32, 4096
OLD_SIZES = {0: 8, 1: 4, 2: 4, 3: 2, 4: 2, 5: 1}
"""Bytes of an entry by the digit P of a matrix of version 4."""
_PIECE = 1 << 16


@dataclass
class _Stream:
    """Bytes of a file, or of a compressed element of it, in order."""

    file: BinaryIO
    left: int
    """Bytes of the file that belong to it."""
    unpacking: zlib._Decompress | None = None
    spare: bytes = b""

    def read(self, count: int) -> bytes:
        if self.unpacking is None:
            data = self.file.read(min(count, self.left))
            self.left -= len(data)
        else:
            parts = [self.spare]
            have = len(self.spare)
            while have < count and (more := self._unpacked()):
                parts.append(more)
                have += len(more)
            whole = b"".join(parts)
            data, self.spare = whole[:count], whole[count:]
        if len(data) < count:
            raise InputError("it is cut short")
        return data

    def skip(self, count: int) -> None:
        if self.unpacking is None:
            if count > self.left:
                raise InputError("it is cut short")
            self.file.seek(count, os.SEEK_CUR)
            self.left -= count
            return
        while count > len(self.spare):
            count -= len(self.spare)
            self.spare = self._unpacked()
            if not self.spare:
                raise InputError("it is cut short")
        self.spare = self.spare[count:]

    def _unpacked(self) -> bytes:
        """The next bytes, at most some 65000; none at the end."""
        assert self.unpacking is not None
        while True:
            packed = self.unpacking.unconsumed_tail or self.file.read(min(_PIECE, self.left))
            if not self.unpacking.unconsumed_tail:
                self.left -= len(packed)
            try:
                data = self.unpacking.decompress(packed, _PIECE)
            except zlib.error as error:
                raise InputError(f"a compressed variable is damaged ({error})") from None
            if data or not packed or self.unpacking.eof:
                return data


@dataclass
class _Walk:
    """The way through a file of version 5 to 7.2."""

    order: str
    most: int
    """Bytes that all variables may unpack to."""
    stream: _Stream = field(init=False)
    elements: int = 0
    unpacked: int = 0

    def variable(self, file: BinaryIO, left: int) -> int:
        """One variable at the place of the file; the bytes that it has."""
        head = file.read(8)
        if len(head) < 8:
            raise InputError("it is cut short")
        kind, size = map(int, struct.unpack(self.order + "II", head))
        if kind not in (MATRIX, COMPRESSED) or not 0 < size <= left - 8:
            raise InputError(f"a variable must be a matrix of at most {left - 8} bytes, got {kind} of {size}")
        self.stream = _Stream(file, size, zlib.decompressobj() if kind == COMPRESSED else None)
        if kind == COMPRESSED:
            inner, _ = struct.unpack(self.order + "II", self.stream.read(8))
            if inner != MATRIX:
                raise InputError(f"a compressed variable must be a matrix, got the data type {inner}")
        self.matrix(0)
        return 8 + size

    def matrix(self, depth: int) -> None:
        """Content of a matrix behind its tag."""
        if depth > MAT_DEPTH:
            raise InputError(f"cells and structures must be nested at most {MAT_DEPTH} levels deep, got more")
        flags, _ = struct.unpack(self.order + "II", self.stream.read(16)[8:])
        kind, is_complex = flags & 0xFF, bool(flags >> 11 & 1)
        if kind == OPAQUE:
            for _ in range(3):
                self.text()
            self.inner(1, depth)
            return
        shape = self.shape()
        self.text()
        count = math.prod(shape)
        if kind in NUMBERS:
            for _ in range(1 + is_complex):
                self.numbers(count)
        elif kind == CHAR:
            self.data()
        elif kind == SPARSE:
            self.sparse(shape, is_complex)
        elif kind == CELL:
            self.inner(count, depth)
        elif kind == FUNCTION:
            self.inner(1, depth)
        elif kind in (STRUCT, OBJECT):
            if kind == OBJECT:
                self.text()
            self.inner(count, depth, self.names())
        else:
            raise InputError(f"class of a matrix must be one that is known, got {kind}")

    def inner(self, count: int, depth: int, fields: int = 1) -> None:
        """Matrices in a matrix; an element without fields counts, too."""
        self.elements += count * max(fields, 1)
        if self.elements > MAT_ELEMENTS:
            raise InputError(f"it must have at most {MAT_ELEMENTS} cells and fields, got more")
        for _ in range(count * fields):
            kind, size = struct.unpack(self.order + "II", self.stream.read(8))
            if kind != MATRIX:
                raise InputError(f"a cell must be a matrix, got the data type {kind}")
            if size:
                self.matrix(depth + 1)

    def tag(self) -> tuple[int, int, bytes | None]:
        """Data type and number of bytes of an element; its data where they are in the tag."""
        head = self.stream.read(8)
        (kind,) = struct.unpack(self.order + "I", head[:4])
        if small := kind >> 16:
            if small > 4:
                raise InputError(f"a small element must have at most 4 bytes, got {small}")
            return self.known(kind & 0xFFFF), small, head[4 : 4 + small]
        size: int = struct.unpack(self.order + "I", head[4:])[0]
        self.unpacked += size
        if self.unpacked > self.most:
            raise InputError(f"it must unpack to at most {self.most / 1e6:.0f} MB, got more")
        return self.known(kind), size, None

    @staticmethod
    def known(kind: int) -> int:
        """The data type, if it is one of numbers or characters."""
        if kind not in SIZES:
            raise InputError(f"data type must be one of {', '.join(map(str, SIZES))}, got {kind}")
        return kind

    def data(self) -> tuple[int, int]:
        """Pass an element; its data type and number of bytes."""
        kind, size, inside = self.tag()
        if inside is None:
            self.stream.skip(size)
            self.pad(size)
        return kind, size

    def content(self, most: int) -> tuple[int, bytes]:
        """Data type and data of an element of at most so many bytes."""
        kind, size, inside = self.tag()
        if inside is not None:
            return kind, inside
        if size > most:
            raise InputError(f"an element must have at most {most} bytes, got {size}")
        data = self.stream.read(size)
        self.pad(size)
        return kind, data

    def pad(self, size: int) -> None:
        """To the next multiple of 8 bytes; at the end of a compressed variable there may be nothing."""
        rest = -size % 8
        if self.stream.unpacking is None:
            rest = min(rest, self.stream.left)
        try:
            self.stream.skip(rest)
        except InputError:
            if self.stream.unpacking is None:
                raise

    def numbers(self, count: int) -> None:
        """An element of so many numbers."""
        kind, size = self.data()
        if size != count * SIZES[kind]:
            raise InputError(f"a matrix of {count} numbers must have {count * SIZES[kind]} bytes, got {size}")

    def text(self) -> str:
        kind, data = self.content(LONGEST_NAME)
        if kind not in TEXTS:
            raise InputError(f"a name must be text, got the data type {kind}")
        return data.decode("latin-1")

    def integers(self, most: int) -> NDArray[np.int64]:
        """An element of integers of 4 bytes, of at most so many bytes."""
        kind, data = self.content(most)
        if kind not in INT32 or len(data) % 4:
            raise InputError(f"sizes and indices must be integers of 4 bytes, got the data type {kind}")
        return np.frombuffer(data, self.order + "i4").astype(np.int64)

    def shape(self) -> list[int]:
        sizes: list[int] = self.integers(4 * MOST_DIMENSIONS).tolist()
        if len(sizes) < 2 or min(sizes) < 0:
            raise InputError(f"a matrix must have two or more dimensions of 0 or more, got {sizes}")
        return sizes

    def names(self) -> int:
        """Pass the names of fields; how many there are."""
        length: list[int] = self.integers(4).tolist()
        kind, data = self.content(MAT_ELEMENTS)
        if len(length) != 1 or length[0] < 1 or len(data) % length[0] or kind not in TEXTS:
            raise InputError(f"names of fields must have one length, got {length} in {len(data)} bytes")
        return len(data) // length[0]

    def sparse(self, shape: list[int], is_complex: bool) -> None:
        """Row indices, starts of the columns, values."""
        if len(shape) != 2 or shape[1] >= self.most:
            raise InputError(f"a sparse matrix must have two dimensions, got {shape}")
        rows, starts = (self.integers(min(self.most, UNPACKED)) for _ in range(2))
        used = starts[: shape[1] + 1]
        if len(used) != shape[1] + 1 or used[0] != 0 or np.any(np.diff(used) < 0) or used[-1] > len(rows):
            raise InputError(f"columns of a sparse matrix must begin in order within {len(rows)} values")
        if np.any(rows[: used[-1]] < 0) or np.any(rows[: used[-1]] >= shape[0]):
            raise InputError(f"rows of a sparse matrix must be of {shape[0]}, got others")
        for _ in range(1 + is_complex):
            kind, size = self.data()
            if size < used[-1] * SIZES[kind] and size < used[-1]:  # of logical values a byte each
                raise InputError(f"a sparse matrix must have {used[-1]} values, got {size} bytes")


def check_mat(path: str | os.PathLike[str]) -> None:
    """Refuse a .mat file that scipy could not read safely.

    Raises
    ------
    OSError
        No ordinary file, or one that is too large.
    InputError
        Another structure than that of a .mat file of version 4 to 7.2.
    """
    size = check_file(path, TABLE)
    with open(path, "rb") as file:
        head = file.read(min(size, 128))
        if len(head) >= 4 and 0 in head[:4]:
            file.seek(0)
            _check_old(file, size)
            return
        mark = head[126:128]
        if len(head) < 128 or mark not in (b"IM", b"MI"):
            raise InputError("its head must be that of a MATLAB file of version 5 to 7.2")
        order = "<" if mark == b"IM" else ">"
        if struct.unpack(order + "H", head[124:126])[0] >> 8 != 1:
            raise InputError("its version must be 4 to 7.2, got another (HDF5 is read elsewhere)")
        walk, at = _Walk(order, most_unpacked(size)), 128
        while at < size:
            walk.elements += 1
            file.seek(at)
            at += walk.variable(file, size - at)


def _check_old(file: BinaryIO, size: int) -> None:
    """Version 4: matrices of a head of 20 bytes, a name and numbers."""
    at, count = 0, 0
    while at < size:
        count += 1
        head = file.read(20)
        if len(head) < 20 or count > MAT_ELEMENTS:
            raise InputError("it is cut short, or has too many matrices")
        order = "<" if 0 <= struct.unpack("<i", head[:4])[0] <= 5000 else ">"
        kind, rows, columns, is_complex, length = struct.unpack(order + "5i", head)
        precision = kind // 10 % 10
        if not 0 <= kind <= 5000 or precision not in OLD_SIZES or kind % 10 > 2 or kind // 100 % 10:
            raise InputError(f"the type of a matrix of version 4 must be one that is known, got {kind}")
        if rows < 0 or columns < 0 or not 0 < length <= LONGEST_NAME:
            raise InputError(f"sizes of a matrix must be 0 or more, got {rows}, {columns}, {length}")
        data = length + rows * columns * OLD_SIZES[precision] * (2 if is_complex else 1)
        if data > size - at - 20:
            raise InputError("it is cut short")
        at += 20 + data
        file.seek(at)
