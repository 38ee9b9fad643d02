"""Names of a package that are loaded when they are first asked for."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from typing import Any


def names_on_demand(package: str, modules: Mapping[str, Sequence[str]]) -> Callable[[str], Any]:
    """The ``__getattr__`` of a package whose names are in modules below it.

    Parameters
    ----------
    package : str
        ``__name__`` of the package.
    modules : mapping of str to sequence of str
        Module, relative to the package or with its full name, and the names that it has.

    Examples
    --------
    >>> load = names_on_demand("lftkit", {"systems.ports": ("Port",)})
    >>> load("Port").__name__
    'Port'
    """
    module_of = {name: module for module, names in modules.items() for name in names}

    def load(name: str) -> Any:
        if name not in module_of:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        module = module_of[name]
        value = getattr(import_module(module if module.startswith("lftkit.") else f"{package}.{module}"), name)
        setattr(sys.modules[package], name, value)
        return value

    return load
