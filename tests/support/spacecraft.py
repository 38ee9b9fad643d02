"""Parameter files of spacecraft that tests describe by plain tables."""

from __future__ import annotations

from pathlib import Path
from typing import Any


def toml(value: Any) -> str:
    """A value as TOML."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {toml(entry)}" for key, entry in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    if isinstance(value, bool):
        return str(value).lower()
    return f'"{value}"' if isinstance(value, str) else repr(value)


def write(folder: Path, layout: dict[str, Any]) -> Path:
    path = folder / "mine.toml"
    path.write_text(
        "\n".join(f"{key} = {toml(value)}" for key, value in {"base": "reference", **layout}.items()) + "\n",
        encoding="utf-8",
    )
    return path
