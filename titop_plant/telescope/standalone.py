"""Tables of a telescope as text that stands alone: all values of a parameter file, none taken from a base."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from lftkit.errors import InputError
from lftkit.support.input_files import read_text
from pointing_analysis.files.settings import proposal
from titop_plant.telescope.load import REFERENCE, load_telescope
from titop_plant.telescope.named_files import map_files
from titop_plant.telescope.requirements import LIMITS


def standalone(path: str | Path | None = None, names: Sequence[str] = ()) -> str:
    """Tables of a parameter file as TOML.

    Parameters
    ----------
    path : str or Path, optional
        Default: the reference, as it is written, with the sources of its values.
    names : sequence of str
        Of tables; default: all.

    Raises
    ------
    ValueError
        A file that cannot be read, a table that it does not have.

    Examples
    --------
    >>> print(*standalone(names=["attitude_control"]).split())
    [attitude_control] bandwidth = 0.06 # rad/s, paper damping = 0.7 # paper
    """
    if path is None:
        blocks = _blocks(read_text(REFERENCE))
        kept = _known(names, [name for name, _ in blocks])
        return "".join(text for name, text in blocks if name in kept)
    import tomli_w

    tables = map_files(load_telescope(path).to_mapping(), lambda file: str(file.absolute()))
    tables["weights"] = {key: value for key, value in tables["weights"].items() if key not in LIMITS}
    kept = _known(names, list(tables))
    return tomli_w.dumps({name: table for name, table in tables.items() if name in kept})


def _known(names: Sequence[str], known: Sequence[str]) -> Sequence[str]:
    """The names that are asked for; all without any."""
    for name in names:
        if name not in known:
            raise InputError(f"unknown table {name!r}{proposal(name, dict.fromkeys(filter(None, known)))}")
    return names or known


def _blocks(text: str) -> list[tuple[str, str]]:
    """Stretches of a file by the table that they are of, with the comments before each; the head has no name."""
    blocks, name, lines = list[tuple[str, str]](), "", list[str]()
    comments: list[str] = []
    for line in text.splitlines(keepends=True):
        head = re.match(r"\[\[?(\w+)", line)
        if head and head[1] != name:
            blocks.append((name, "".join(lines)))
            name, lines = head[1], [*comments, line]
            comments = []
        elif line.startswith("#"):
            comments.append(line)
        else:
            lines += [*comments, line]
            comments = []
    return [*blocks, (name, "".join([*lines, *comments]))]
