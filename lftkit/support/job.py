"""Long work in parts that are kept on disk, so that the same work continues after an interrupt.

A :class:`Job` names all that a result depends on. Its record, a JSON file, says whose parts lie beside it: parts of
another job are never taken over. Parts are written whole or not at all (:mod:`lftkit.support.atomic_output`).
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import IO, Any

import numpy as np

from lftkit.errors import InputError
from lftkit.support.atomic_output import leftovers, write_text
from lftkit.support.input_files import read_text
from lftkit.support.structured_text import load_json

KIND, STATE = "kind", "state"
"""Entries of a record beside what the result depends on."""


@dataclass(frozen=True)
class Job:
    """Work whose finished parts are kept.

    Parameters
    ----------
    kind : str
        Noun for messages, such as ``campaign``.
    depends : mapping
        All that the result depends on: versions, settings, digests of files. Values as of JSON; an array counts by its
        type, shape and content.
    record : Path
        File that says whose parts lie beside it.
    what : str
        Name of its folder in messages.

    Examples
    --------
    >>> one, other = (Job("sum", {"terms": n}, Path("job.json")) for n in (3, 4))
    >>> one.difference(other.content)
    'terms must be 4 as there, got 3'
    """

    kind: str
    depends: Mapping[str, Any]
    record: Path = Path("job.json")
    what: str = "--output"

    @cached_property
    def content(self) -> dict[str, Any]:
        """Kind and all that the result depends on, as they come back from JSON."""
        text = json.dumps({KIND: self.kind, **self.depends}, default=_plain)
        return dict(json.loads(text))

    @cached_property
    def digest(self) -> str:
        """SHA-256 of :attr:`content` as hexadecimal digits."""
        return hashlib.sha256(json.dumps(self.content, sort_keys=True).encode()).hexdigest()

    def difference(self, there: Mapping[str, Any]) -> str:
        """First entry in which the content of a record differs from this job; empty if it is of the same job."""
        for key in dict.fromkeys([*self.content, *there]):
            here, other = self.content.get(key), there.get(key)
            if key == STATE or here == other:
                continue
            while isinstance(here, dict) and isinstance(other, dict):  # of a table, the first entry that differs
                key = next(name for name in (*here, *other) if here.get(name) != other.get(name))
                here, other = here.get(key), other.get(key)
            return f"{key} must be {_short(other)} as there, got {_short(here)}"
        return ""

    def begin(self) -> bool:
        """Make the folder of the parts and the record in it, if there are none; True where the job continues.

        Raises
        ------
        ValueError
            A folder of something else, or of another job.
        """
        folder = self.record.parent
        if folder.exists() and any(folder.iterdir()):
            if not self.record.exists():
                raise InputError(f"{self.what} must be a new folder or one of the same {self.kind}, got {folder}")
            self.require_same(load_json(read_text(self.record), self.record))
            return True
        folder.mkdir(parents=True, exist_ok=True)
        self._write({})
        return False

    def require_same(self, there: Any) -> None:
        """Refuse the content of the record of another job.

        Raises
        ------
        ValueError
        """
        difference = self.difference(there) if isinstance(there, dict) else f"{self.record.name} must be an object"
        if difference:
            raise InputError(
                f"{self.what} must be a new folder or one of the same {self.kind}, got {self.record.parent}, "
                f"which holds another: {difference}"
            )

    def state(self) -> dict[str, Any] | None:
        """State that :meth:`save` kept; None where the record is missing, damaged, of another job, or has none."""
        try:
            there = load_json(read_text(self.record), self.record)
        except (OSError, ValueError):
            return None
        same = isinstance(there, dict) and not self.difference(there)
        return there.get(STATE) if same and isinstance(there.get(STATE), dict) else None

    def save(self, state: Mapping[str, Any]) -> None:
        """Keep a state of the work, JSON values, in the record."""
        self._write({STATE: state})

    def finish(self) -> None:
        """Remove the record: what is left is the result, and nothing to continue."""
        self.record.unlink(missing_ok=True)

    @contextlib.contextmanager
    def alone(self, parts: Path | None = None) -> Iterator[None]:
        """No other process writes parts during the block; what a killed process left half written is removed.

        Parameters
        ----------
        parts : Path, optional
            Their folder; default: that of the record.

        Raises
        ------
        ValueError
            Another process writes parts of this job.
        """
        with self.record.open("r+b") as file:
            lock(file, self.record.parent)
            for left in leftovers(parts or self.record.parent):
                left.unlink(missing_ok=True)
            yield

    def _write(self, further: Mapping[str, Any]) -> None:
        write_text(self.record, json.dumps({**self.content, **further}, indent=None if further else 1) + "\n", True)


def lock(file: IO[bytes], path: Path) -> None:
    """Hold an open file for this process, until it is closed; on file systems without locks there is none.

    Raises
    ------
    ValueError
        Another process holds it; `path` names it in the message.
    """
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise InputError(f"{path} must not be in use by another process, got one that is") from None
    except OSError as error:
        if error.errno not in (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP):
            raise


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        content = hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()
        return {"dtype": value.dtype.str, "shape": list(value.shape), "sha256": content}
    return value.item() if isinstance(value, np.generic) else repr(value)


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
