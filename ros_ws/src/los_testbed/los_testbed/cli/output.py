"""What the commands share: the option ``--json`` and its one line of output."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import typer

Json = Annotated[bool, typer.Option("--json", help="Last line of output is one JSON object.")]


def print_json(content: Mapping[str, Any] | Sequence[Any]) -> None:
    """Write one line of JSON to the standard output."""
    sys.stdout.write(json.dumps(content) + "\n")
    sys.stdout.flush()
