"""What a test cannot judge on this machine is said and counted, not passed by another bound."""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Iterable


class UnjudgedWarning(UserWarning):
    """A part of a test that was not judged; ``tests/conftest.py`` counts them at the end of a run."""


REMEDIES = {
    "the loop does not keep pace": "run the tests of the nodes alone: pytest -m 'ros and not slow' tests",
    "samples were lost": "run the tests of the nodes alone: pytest -m 'ros and not slow' tests",
    "real time is not permitted": "run as root or allow SCHED_FIFO (CAP_SYS_NICE, or rtprio in limits.conf)",
}
"""Beginning of a reason, and what to do about it."""


def judged(possible: bool, what: str, reason: str) -> bool:
    """Whether a part of a test can be judged; if not, it is counted as unjudged.

    Parameters
    ----------
    possible : bool
        Whether what is needed for it is there.
    what : str
        What is judged.
    reason : str
        Why it cannot be, one of :data:`REMEDIES`.

    Examples
    --------
    >>> judged(True, "the order of commands", "samples were lost")
    True
    """
    if reason not in REMEDIES:
        raise ValueError(f"reason must be one of {', '.join(REMEDIES)}, got {reason!r}")
    if not possible:
        warnings.warn(f"{reason}: {what}", UnjudgedWarning, stacklevel=2)
    return possible


def unjudged_lines(told: Iterable[str]) -> list[str]:
    """One line for each part that was not judged, most frequent first, with the remedy.

    Examples
    --------
    >>> unjudged_lines(["samples were lost: the replay"])[0].split(" -> ")[0]
    '1 x not judged, samples were lost: the replay'
    """
    return [
        f"{count} x not judged, {text} -> {next(line for part, line in REMEDIES.items() if text.startswith(part))}"
        for text, count in Counter(told).most_common()
    ]
