"""Hint after an interrupt: the command line that resumes from the stored results."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

_words: list[str] = []


def remember_command(words: Sequence[str]) -> None:
    """Store the words of the command line."""
    _words[:] = words


def _has_content(path: Path) -> bool:
    return any(path.iterdir()) if path.is_dir() else path.exists()


@contextmanager
def resume_hint(
    kept: str, output: Path, further: Sequence[str] = (), without: Sequence[str] = (), state: Path | None = None
) -> Iterator[None]:
    """After an interrupt or a signal, write what is stored and the command that resumes from it.

    Parameters
    ----------
    kept : str
        What is stored, a plural noun.
    output : Path
        Folder of the results; the command line names it with ``--output`` even if the given one does not.
    state : Path, optional
        File of the results, instead of the output.
    further, without : sequence of str
        Options without a value that the command line must have, and must not have.
    """
    try:
        yield
    except BaseException as error:
        if not isinstance(error, Exception) and _has_content(state or output):
            words = [word for word in _words if word not in without]
            if not any(word.split("=")[0] == "--output" for word in words):
                words += ["--output", str(output)]
            words += [option for option in further if option not in words]
            sys.stderr.write(f"{kept} are stored; resume with: {shlex.join(['los-testbed', *words])}\n")
        raise
