"""What a command says where an interrupt ends it: the command line that goes on with what is kept."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

_words: list[str] = []


def remember_command(words: Sequence[str]) -> None:
    """Keep the words of the command line."""
    _words[:] = words


def _has_content(path: Path) -> bool:
    return any(path.iterdir()) if path.is_dir() else path.exists()


@contextmanager
def told_how_to_go_on(
    kept: str, output: Path, further: Sequence[str] = (), without: Sequence[str] = (), state: Path | None = None
) -> Iterator[None]:
    """After an interrupt or a signal: a line that says what is kept, and the command that goes on with it.

    Parameters
    ----------
    kept : str
        What is on disk, in the plural.
    output : Path
        Folder that has it, if there is one yet; the command line names it with ``--output`` even where the one that
        was given does not.
    state : Path, optional
        File that has it, in place of the output.
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
            sys.stderr.write(f"{kept} are kept; this goes on with them: {shlex.join(['los-testbed', *words])}\n")
        raise
