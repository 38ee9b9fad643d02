"""Memory of a run: the need of its processes, and signs of too little."""

from __future__ import annotations

import resource

from lftkit.errors import InputError

ADDRESS_SPACE = 1_150_000_000
"""Need of a node of the telescope [bytes]; measured 1.065e9, most of it code and stacks of the middleware."""

ADDRESS_SPACE_LIVE = 1_300_000_000
"""The node that serves viewers; measured 1.18e9."""

ADDRESS_SPACE_COMMAND = 600_000 * 1024
"""Need of any command; with less, packages fail to load, and OpenBLAS retries allocations for ever."""

TOO_LITTLE_MEMORY = "too little memory"
WORDS = (
    *("MemoryError", "Cannot allocate memory", "std::bad_alloc", "can't start new thread", "failed to map segment"),
    *("cannot allocate memory", "Unable to allocate", "malloc of size", "realloc of size"),
)


def names_memory(errors: str) -> bool:
    """Whether an error output says that there was too little memory.

    Examples
    --------
    >>> names_memory("_ArrayMemoryError: Unable to allocate 30.7 MiB"), names_memory("ValueError")
    (True, False)
    """
    return any(word in errors for word in WORDS)


def _check(needed: int, purpose: str, advice: str) -> None:
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit != resource.RLIM_INFINITY and limit < needed:
        raise InputError(
            f"memory of a process (ulimit -v) must be at least {needed // 1024} kB for {purpose}, "
            f"got {limit // 1024}: {TOO_LITTLE_MEMORY}{advice}"
        )


def check_address_space(live: bool) -> None:
    """Reject processes that would deadlock: a middleware without memory reports no error.

    Raises
    ------
    ValueError
        The limit of this process (``ulimit -v``) is too small.
    """
    _check(ADDRESS_SPACE_LIVE if live else ADDRESS_SPACE, "a run with nodes", "; or use --mode inprocess")


def check_command() -> None:
    """Refuse any command where its packages cannot be loaded; raises as :func:`check_address_space`."""
    _check(ADDRESS_SPACE_COMMAND, "a command", "")
