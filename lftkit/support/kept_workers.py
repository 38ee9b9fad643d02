"""Workers whose results are kept in a file as they come, so that interrupted work goes on with them."""

from __future__ import annotations

import io
import pickle
import struct
import zlib
from collections.abc import Callable, Iterator, Sequence
from typing import Any, BinaryIO, TypeVar

from lftkit.errors import InputError
from lftkit.support.job import Job, lock
from lftkit.support.workers import Workers

Item = TypeVar("Item")
Result = TypeVar("Result")

MAGIC = b"kept results 1\n"
_HEAD = struct.Struct("<QI")  # length and CRC-32 of a record
_OF_NUMPY = frozenset(
    {
        ("numpy", "ndarray"),
        ("numpy", "dtype"),
        *((f"numpy.{core}.multiarray", name) for core in ("core", "_core") for name in ("_reconstruct", "scalar")),
        *((f"numpy.{core}.numeric", "_frombuffer") for core in ("core", "_core")),
    }
)


class KeptWorkers(Workers):
    """Workers that keep each result in a file, and take from it those of an earlier start of the same job.

    The job must make the same calls in the same order: a result is known by the number of its call and its place
    among the items.

    Parameters
    ----------
    workers : Workers
        Who computes what is not there; they are not ended here.
    job : Job
        Its record is the file. One of another job is begun anew; what an interrupt cut off at its end is left out.
    types : sequence of type
        Classes that the results consist of, besides arrays, numbers, texts, lists, tuples and dicts. No other class
        is ever loaded from the file.

    Raises
    ------
    ValueError
        The file is another one, in use by another process, or cannot be written.
    """

    def __init__(self, workers: Workers, job: Job, types: Sequence[type]) -> None:
        super().__init__(workers.count)
        path = job.record
        self._workers, self._path, self._calls = workers, path, 0
        self._types = frozenset((one.__module__, one.__qualname__) for one in types)
        self._known: dict[tuple[int, int], bytes] = {}
        self._added = 0
        try:
            self._file: BinaryIO = path.open("a+b")
        except OSError as error:
            raise InputError(f"{path} must be a file that can be written, got {error.strerror}") from None
        try:
            lock(self._file, path)
            self._begin(job.digest.encode())
        except BaseException:
            self._file.close()
            raise

    @property
    def known(self) -> int:
        """Number of results in the file."""
        return len(self._known)

    def each(self, function: Callable[[Item], Result], items: Sequence[Item]) -> Iterator[Result]:
        """Results of :meth:`map`, one by one."""
        self._calls += 1
        call = self._calls
        missing = [k for k in range(len(items)) if (call, k) not in self._known]
        return self._merged(call, len(items), self._workers.each(function, [items[k] for k in missing]))

    def _merged(self, call: int, count: int, fresh: Iterator[Result]) -> Iterator[Result]:
        for k in range(count):
            known = self._known.get((call, k))
            if known is not None:
                yield _Reader(io.BytesIO(known), self._types).load()[2]
                continue
            result = next(fresh)
            self._add(pickle.dumps((call, k, result), protocol=5))
            self._added += 1
            yield result

    def close(self, done: bool) -> None:
        """Let go of the file, and remove it where the job is done, or no result is in it."""
        if done or not (self._known or self._added):
            self._path.unlink(missing_ok=True)
        self._file.close()

    def _begin(self, job: bytes) -> None:
        """Read what is there of the same job, and cut off or replace the rest."""
        self._file.seek(0)
        content = self._file.read()
        if content and not content.startswith(MAGIC):
            raise InputError(f"{self._path} must be a file of kept results, got {content[: len(MAGIC)]!r}")
        whole = list(_records(content))
        if whole and whole[0][1] == job:
            for _, record in whole[1:]:
                call, k, _ = _Reader(io.BytesIO(record), self._types).load()
                self._known[call, k] = record
            self._file.truncate(whole[-1][0])
            return
        self._file.truncate(0)
        self._file.write(MAGIC)
        self._add(job)

    def _add(self, record: bytes) -> None:
        self._file.write(_HEAD.pack(len(record), zlib.crc32(record)) + record)
        self._file.flush()


def _records(content: bytes) -> Iterator[tuple[int, bytes]]:
    """Whole records of a file's content, each with the place of its end."""
    at = len(MAGIC)
    while at + _HEAD.size <= len(content):
        length, check = _HEAD.unpack_from(content, at)
        at += _HEAD.size + length
        record = content[at - length : at]
        if at > len(content) or zlib.crc32(record) != check:
            return
        yield at, record


class _Reader(pickle.Unpickler):
    """Loads arrays and the given classes, and nothing else."""

    def __init__(self, stream: BinaryIO, types: frozenset[tuple[str, str]]) -> None:
        super().__init__(stream)
        self._types = types | _OF_NUMPY

    def find_class(self, module: str, name: str) -> Any:
        """The class, if results may consist of it."""
        if (module, name) not in self._types:
            raise InputError(f"kept results must consist of arrays and known classes, got {module}.{name}")
        return super().find_class(module, name)
