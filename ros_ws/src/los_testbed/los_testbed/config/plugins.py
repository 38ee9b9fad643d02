"""User code by name: ``my.module:Plant``, or an entry point of an installed package."""

from __future__ import annotations

import hashlib
import importlib
import inspect
import itertools
import os
import sys
import traceback
from collections.abc import Callable, Mapping
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path
from types import FrameType, MappingProxyType
from typing import Any

import los_testbed
import pointing_analysis
from lftkit.errors import InputError
from lftkit.support.input_files import read_bytes
from lftkit.support.input_limits import SYSTEM
from los_testbed.config.run_config import RunConfig, is_library

GROUPS: Mapping[str, str] = MappingProxyType(
    {
        "plant": "los_testbed.plants",
        "device": "los_testbed.devices",
        "disturbance_source": "los_testbed.disturbances",
        "k_fsm": "los_testbed.k_fsm",
        "k_pma": "los_testbed.k_pma",
    }
)
"""Groups of entry points by setting: a package that names its class there makes it known by a short name."""

RAISED = (Exception, SystemExit)
"""Exceptions of user code: `sys.exit` in it ends a run as any other exception does."""

CALLERS = (
    "<frozen importlib",
    *(f"{Path(str(one.__file__)).parent}{os.sep}" for one in (los_testbed, pointing_analysis, importlib)),
)
"""Folders of the files that import or call user code."""


def load(text: str, setting: str = "plant") -> Any:
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
    lftkit.errors.InputError: plant must be MODULE:NAME or an entry point of los_testbed.plants, got 'math:no_such' \
(AttributeError: module 'math' has no attribute 'no_such')
    """
    folder, group = str(Path.cwd()), GROUPS[setting]
    added = folder not in sys.path
    if added:
        sys.path.insert(0, folder)
    try:
        module, sign, name = text.partition(":")
        if sign:
            part_of_module: Any = import_module(module)
            for part in name.split("."):
                part_of_module = getattr(part_of_module, part)
            return part_of_module
        known = {point.name: point for point in entry_points(group=group)}
        if text not in known:
            if Path(text).is_dir():
                raise LookupError("it is a folder, not a file")
            raise LookupError(f"known are {', '.join(sorted(known)) or 'none'}")
        return known[text].load()
    except RAISED as error:
        file = "a file, " if setting.startswith("k_") else ""
        raise InputError(
            f"{setting} must be {file}MODULE:NAME or an entry point of {group}, got {text!r} ({in_one_line(error)})"
        ) from error
    finally:
        if added:
            sys.path.remove(folder)


def make(config: RunConfig, setting: str = "plant") -> Any:
    """Object that a setting of `config` names: its class or function is called, and the object reset.

    It gets the configuration if it has a parameter ``config``.

    Raises
    ------
    ValueError
        It cannot be loaded or called.
    """
    text = getattr(config, setting)
    made = load(text, setting)
    if not callable(made):
        raise InputError(f"{setting} must be a class or a function that makes one, got {type(made).__name__}")
    try:
        wants = "config" in inspect.signature(made).parameters
        return made(config=config) if wants else made()
    except RAISED as error:
        what = in_one_line(error)
        raise InputError(f"{setting} {text} must be made without arguments or with config, got {what}") from error


def made_by(build: Callable[[RunConfig], Any], config: RunConfig, what: str) -> Any:
    """Object that a user's function makes for a node.

    Raises
    ------
    ValueError
        The function raised an exception.
    """
    try:
        return build(config)
    except RAISED as error:
        raise InputError(f"{what} must be made from the configuration, got {in_one_line(error)}") from error


def source_hashes(code: Mapping[str, str]) -> dict[str, str]:
    """SHA-256 of the source file of each object of the user, by setting; empty text where there is no file.

    Parameters
    ----------
    code : mapping
        Setting to the name of its object, see :attr:`los_testbed.config.run_config.RunConfig.code_of_user`.

    Raises
    ------
    ValueError
        One of them cannot be loaded.
    """
    hashes = {}
    for setting, text in code.items():
        try:
            file = text if is_library(text) else inspect.getsourcefile(load(text, setting))
        except TypeError:  # built in, or an object without a file
            file = None
        hashes[setting] = hashlib.sha256(read_bytes(file, SYSTEM)).hexdigest() if file and Path(file).is_file() else ""
    return hashes


def in_one_line(error: BaseException) -> str:
    """Type and text of an exception; if user code raised it, also class and method, file and line.

    The method is the one that was called from here, the line the last one in its file.

    Examples
    --------
    >>> in_one_line(KeyError("a"))
    "KeyError: 'a'"
    """
    text = " ".join(str(error).split())
    return f"{type(error).__name__}{': ' if text else ''}{text}{_place(error)}"


def _place(error: BaseException) -> str:
    """Place of an exception in user code, `` (Law.step, my_module.py:12)``; empty if it came from elsewhere."""
    frames = list(traceback.walk_tb(error.__traceback__))
    users = list(itertools.dropwhile(lambda one: one[0].f_code.co_filename.startswith(CALLERS), frames))
    if not users:
        return ""
    called = users[0][0]
    file = called.f_code.co_filename
    line = [line for frame, line in users if frame.f_code.co_filename == file][-1]
    folder = Path.cwd()
    shown = Path(file).relative_to(folder) if Path(file).is_relative_to(folder) else file
    return f" ({_method(called)}{shown}:{line})"


def _method(frame: FrameType) -> str:
    """Class and name of a called method, with a comma; the class is that of the object, which may inherit it."""
    code, name = frame.f_code, frame.f_code.co_name
    if name == "<module>":
        return ""
    first = frame.f_locals.get(code.co_varnames[0]) if code.co_argcount else None
    owner = f"{type(first).__name__}." if hasattr(type(first), name) else ""
    return f"{owner}{name}, "
