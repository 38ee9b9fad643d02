"""Arrays of any length in bounded memory: long ones are files without a name that are mapped into memory.

They are ordinary arrays. What bounds the memory is that long ones are gone through in parts (`parts`), and that the
pages of the part that is done are given back to the system, which has them in its file cache.
"""

from __future__ import annotations

import contextlib
import ctypes
import itertools
import math
import mmap
import os
import tempfile
import weakref
from collections.abc import Callable, Iterator
from typing import IO, Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from pointing_analysis.arrays import FloatArray, IntArray

IN_MEMORY = 1 << 20
"""Largest array that is kept in memory [byte]."""
PART = 1 << 17
"""Rows that are worked on at a time."""
RUN = 1 << 20
"""Values that are sorted at a time."""
FOLDERS = ("/var/tmp",)
"""Folder of the files if TMPDIR names none; /tmp may itself be in memory."""

_malloc_trim = getattr(ctypes.CDLL(None), "malloc_trim", None) if os.name == "posix" else None
_mapped: weakref.WeakSet[mmap.mmap] = weakref.WeakSet()


def _file() -> IO[bytes]:
    for folder in () if "TMPDIR" in os.environ else FOLDERS:
        with contextlib.suppress(OSError):
            return tempfile.TemporaryFile(dir=folder)
    return tempfile.TemporaryFile()


def _no_space(error: OSError) -> OSError:
    return OSError(error.errno, f"{error.strerror}: TMPDIR must have space for the samples of a long run")


def _map(file: IO[bytes], shape: tuple[int, ...], dtype: np.dtype[Any], access: int) -> NDArray[Any]:
    mapped = mmap.mmap(file.fileno(), 0, access=access)
    _mapped.add(mapped)
    return np.frombuffer(mapped, dtype).reshape(shape)


def release() -> None:
    """Give the pages of all mapped arrays back, whose content stays, and those of the heap that hold nothing."""
    for mapped in list(_mapped):
        mapped.madvise(mmap.MADV_DONTNEED)
    trim()


def trim() -> None:
    """Give free pages of the heap back to the system.

    Buffers of many sizes leave holes between what lives longer: without this, the memory of a pass over a long
    recording grows by 13 MB a minute though nothing is kept. Only the C library of GNU can be asked for it.
    """
    if _malloc_trim is not None:
        _malloc_trim(0)


def parts(rows: int) -> Iterator[slice]:
    """Slices of at most `PART` rows, in order; the pages of the mapped arrays are given back behind each.

    Examples
    --------
    >>> [(part.start, part.stop) for part in parts(PART + 2)]
    [(0, 131072), (131072, 131074)]
    """
    for begin in range(0, rows, PART):
        yield slice(begin, min(begin + PART, rows))
        if _mapped:
            release()


def empty(shape: int | tuple[int, ...], dtype: DTypeLike = np.float64) -> NDArray[Any]:
    """A new array, in memory or mapped, of zeros if it is mapped.

    Raises
    ------
    OSError
        No space for its file.
    """
    shape = (shape,) if isinstance(shape, int) else shape
    kind = np.dtype(dtype)
    size = int(np.prod(shape, dtype=np.int64)) * kind.itemsize
    if size <= IN_MEMORY:
        return np.empty(shape, kind)
    with _file() as file:
        try:
            os.posix_fallocate(file.fileno(), 0, size)
        except OSError as error:
            raise _no_space(error) from None
        return _map(file, shape, kind, mmap.ACCESS_WRITE)


def by_parts(function: Callable[..., ArrayLike], *arrays: NDArray[Any], dtype: DTypeLike = np.float64) -> NDArray[Any]:
    """A function that works row by row, applied part by part: the same as ``function(*arrays)``.

    Parameters
    ----------
    function : gives as many rows as it gets
    arrays : of equal length
    dtype : of the result

    Examples
    --------
    >>> by_parts(np.square, np.arange(3.0))
    array([0., 1., 4.])
    """
    rows = len(arrays[0])
    if rows <= PART:
        return np.asarray(function(*arrays))
    result: NDArray[Any] | None = None
    for part in parts(rows):
        piece = np.asarray(function(*(array[part] for array in arrays)))
        if result is None:
            result = empty((rows, *piece.shape[1:]), dtype)
        result[part] = piece
    assert result is not None
    return result


def rows_made(rows: int, function: Callable[[IntArray], ArrayLike]) -> FloatArray:
    """An array from the numbers of its rows, made part by part.

    Examples
    --------
    >>> rows_made(3, lambda row: 0.5 * row)
    array([0. , 0.5, 1. ])
    """
    made = empty(rows)
    for part in parts(rows):
        made[part] = function(np.arange(part.start, part.stop))
    return made


def present(values: FloatArray) -> FloatArray:
    """Values (n,) without the NaN."""
    kept = GrowingArray(None)
    for part in parts(len(values)):
        kept.append(values[part][~np.isnan(values[part])])
    return kept.array()


def common_rows(first: IntArray, second: IntArray) -> Iterator[tuple[IntArray, IntArray]]:
    """Rows of equal entries of two strictly ascending arrays, part by part.

    Examples
    --------
    >>> [(a.tolist(), b.tolist()) for a, b in common_rows(np.array([1, 3, 5]), np.array([0, 1, 2, 5]))]
    [([0, 2], [1, 3])]
    """
    for part in parts(len(first)):
        low, high = np.searchsorted(second, (first[part.start], first[part.stop - 1] + 1))
        _, rows, columns = np.intersect1d(first[part], second[low:high], assume_unique=True, return_indices=True)
        yield rows + part.start, columns + low


class GrowingArray:
    """Rows that are appended; the array at the end is in memory or mapped.

    Parameters
    ----------
    columns : of each row; None for an array of one dimension
    dtype : of the values

    Raises
    ------
    OSError
        No space for its file, from `append`.
    """

    def __init__(self, columns: int | None, dtype: DTypeLike = np.float64) -> None:
        self.columns, self.dtype, self.size = columns, np.dtype(dtype), 0
        self._memory = np.empty(self._shape(0), self.dtype)
        self._file: IO[bytes] | None = None

    def _shape(self, rows: int) -> tuple[int, ...]:
        return (rows,) if self.columns is None else (rows, self.columns)

    @property
    def nbytes(self) -> int:
        """Size of what was appended [byte]."""
        return self.size * self.dtype.itemsize * (1 if self.columns is None else self.columns)

    def append(self, rows: NDArray[Any]) -> None:
        """Append rows of the same width."""
        end = self.size + len(rows)
        if self._file is None and end > len(self._memory):
            larger = np.empty(self._shape(max(end, 2 * len(self._memory))), self.dtype)
            if larger.nbytes > 2 * IN_MEMORY:
                self._file = _file()
                self._write(self._memory[: self.size])
                self._memory = np.empty(self._shape(0), self.dtype)  # a slice would keep all of it
            else:
                larger[: self.size] = self._memory[: self.size]
                self._memory = larger
        if self._file is None:
            self._memory[self.size : end] = rows
        else:
            self._write(rows)
        self.size = end

    def _write(self, rows: NDArray[Any]) -> None:
        assert self._file is not None
        try:
            self._file.write(np.ascontiguousarray(rows, self.dtype).data)
        except OSError as error:
            raise _no_space(error) from None

    def array(self) -> NDArray[Any]:
        """The appended values; no more can be appended."""
        if self._file is None:
            return self._memory[: self.size]
        with self._file as file:
            file.flush()
            return _map(file, self._shape(self.size), self.dtype, mmap.ACCESS_READ)


class SortedValues:
    """Values in ascending order, reached by their ranks; NaN are left out.

    Long series are sorted in runs, and a rank is found by bisection over all of them: exactly the value that one sorted
    array has there.

    Parameters
    ----------
    values : (n,)

    Examples
    --------
    >>> found = SortedValues(np.array([3.0, np.nan, 1.0, 2.0]))
    >>> found.size, found.at([0, 2])
    (3, array([1., 3.]))
    >>> found.quantile(0.5), found.quantile(0.7)
    (2.0, 3.0)
    """

    def __init__(self, values: FloatArray) -> None:
        kept, runs = GrowingArray(None), [0]
        for begin in range(0, len(values), RUN):
            piece = np.sort(values[begin : begin + RUN])
            piece = piece[: piece.size - int(np.isnan(piece).sum())]
            kept.append(piece)
            runs.append(runs[-1] + piece.size)
            if _mapped:
                release()
        values = kept.array()
        self.size = kept.size
        self._runs = [values[a:b] for a, b in itertools.pairwise(runs) if b > a]

    def at(self, ranks: ArrayLike) -> FloatArray:
        """Values at ranks from 0 to size - 1."""
        wanted = np.atleast_1d(np.asarray(ranks, dtype=np.int64))
        if len(self._runs) == 1:
            return np.asarray(self._runs[0][wanted])
        # Bisection over the floating-point numbers themselves, whose order is that of their keys.
        low = np.full(wanted.shape, _keys(np.array([min(run[0] for run in self._runs)]))[0])
        high = np.full(wanted.shape, _keys(np.array([max(run[-1] for run in self._runs)]))[0])
        while np.any(low < high):
            middle = low + (high - low) // np.uint64(2)
            not_above = np.zeros(wanted.shape, np.int64)
            for run in self._runs:
                not_above += np.searchsorted(run, _values(middle), side="right")
            enough = not_above > wanted
            low, high = np.where(enough, low, middle + np.uint64(1)), np.where(enough, middle, high)
        return _values(low)

    def quantile(self, probability: float) -> float:
        """Smallest value that at least this share of the values does not exceed; NaN without values.

        No interpolation: a limit between two values is kept by as many values as the smaller one, so that only the
        values themselves agree with a verdict that counts.
        """
        return float(self.at(self.rank(probability))[0]) if self.size else float("nan")

    def rank(self, probability: float) -> int:
        """Rank of the quantile."""
        return min(max(math.ceil(probability * self.size - 1e-9) - 1, 0), self.size - 1)


_TOP = np.uint64(1 << 63)


def _keys(values: FloatArray) -> NDArray[np.uint64]:
    """Integers in the order of the values."""
    bits = np.asarray(values + 0.0).view(np.uint64)  # no negative zero
    return np.where(bits & _TOP, ~bits, bits | _TOP)


def _values(keys: NDArray[np.uint64]) -> FloatArray:
    return np.asarray(np.where(keys & _TOP, keys ^ _TOP, ~keys).astype(np.uint64)).view(np.float64)
