"""The packages of the product, as pyproject.toml lists them for the type checker."""

from __future__ import annotations

import ast
import gc
from functools import cache
from pathlib import Path

from pointing_analysis.files.structured_text import load_toml

ROOT = Path(__file__).parents[2]
ROS_PACKAGE = "ros_ws/src/los_testbed"
PROJECTS = "pyproject.toml", "lftkit/pyproject.toml", "pointing_analysis/pyproject.toml"
PROJECT, LIBRARY, ANALYSIS = (load_toml(path.read_text("utf-8"), path) for path in map(ROOT.joinpath, PROJECTS))
"""Of the three distributions."""
NAMES: tuple[str, ...] = tuple(PROJECT["tool"]["mypy"]["packages"])
LIBRARIES = tuple(name for name in NAMES if (ROOT / name).is_dir())
"""Those that lie at the top of the repository."""
FOLDERS = tuple(name if name in LIBRARIES else f"{ROS_PACKAGE}/{name}" for name in NAMES)
"""All of them, as paths from the repository's root."""


def files_of(folder: Path, pattern: str = "*.py") -> list[Path]:
    """Files of a package in order, without what ``pip install ./lftkit`` leaves in its folder ``build``."""
    return sorted(path for path in folder.rglob(pattern) if "build" not in path.relative_to(folder).parts)


@cache
def tree(path: Path) -> ast.Module:
    """Syntax tree of a file, which stays: looking for garbage in many of them takes longer than making them."""
    gc.disable()
    try:
        found = ast.parse(path.read_text("utf-8"), str(path))
        gc.freeze()
        return found
    finally:
        gc.enable()
