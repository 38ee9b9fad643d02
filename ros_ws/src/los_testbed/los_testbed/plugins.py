"""Plants of the user by name: ``my.module:Plant``, or an entry point of an installed package."""

from __future__ import annotations

import inspect
import sys
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from los_testbed.config import RunConfig

GROUP = "los_testbed.plants"
"""Group of entry points: a package that names its plant here makes it known by a short name."""


def load(text: str) -> Any:
    """Object of ``MODULE:NAME``, or of the entry point of this name; modules of the working folder are found.

    Raises
    ------
    ValueError
        No such module, object or entry point, or a module that cannot be imported.

    Examples
    --------
    >>> load("math:tau") > 6
    True
    >>> load("math:no_such")
    Traceback (most recent call last):
        ...
    ValueError: plant must be MODULE:NAME or an entry point of los_testbed.plants, got 'math:no_such' (AttributeError: \
module 'math' has no attribute 'no_such')
    """
    folder = str(Path.cwd())
    added = folder not in sys.path
    if added:
        sys.path.insert(0, folder)
    try:
        module, sign, name = text.partition(":")
        if sign:
            found: Any = import_module(module)
            for part in name.split("."):
                found = getattr(found, part)
            return found
        known = {point.name: point for point in entry_points(group=GROUP)}
        if text not in known:
            raise LookupError(f"known are {', '.join(sorted(known)) or 'none'}")
        return known[text].load()
    except Exception as error:
        what = f"{type(error).__name__}: {' '.join(str(error).split())}"
        raise ValueError(f"plant must be MODULE:NAME or an entry point of {GROUP}, got {text!r} ({what})") from error
    finally:
        if added:
            sys.path.remove(folder)


def make_plant(config: RunConfig) -> Any:
    """Plant that `config` names: its class or function is called, with the configuration if it has a parameter for it.

    Raises
    ------
    ValueError
        It cannot be loaded or called.
    """
    made = load(config.plant)
    if not callable(made):
        raise ValueError(f"plant must be a class or a function that makes one, got {type(made).__name__}")
    try:
        wants = "config" in inspect.signature(made).parameters
        plant = made(config=config) if wants else made()
        plant.reset()
    except Exception as error:
        what = f"{type(error).__name__}: {' '.join(str(error).split())}"
        raise ValueError(f"plant {config.plant} must be made without arguments or with config, got {what}") from error
    return plant
