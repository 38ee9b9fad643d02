"""Verdicts on any line of sight given as arrays.

Examples
--------
>>> import numpy as np
>>> t = np.arange(6000) / 512
>>> xy = 0.05 * np.random.default_rng(1).standard_normal((6000, 2))
>>> found = judge_series(t, xy, unit="arcsec", requirements="prob(|APE| < 1 arcsec) >= 0.9 at 90 % confidence")
>>> found.verdicts[0].status
'compliant'
"""

from __future__ import annotations

import os
from collections.abc import Sequence

from numpy.typing import ArrayLike

from pointing_analysis.read.series import series
from pointing_analysis.requirements.requirement import Requirement, load, parse
from pointing_analysis.requirements.summary import Summary, summarise


def judge_series(
    t: ArrayLike | None,
    xy: ArrayLike,
    *,
    unit: str,
    requirements: str | os.PathLike[str] | Sequence[Requirement | str] | None = None,
    rate: float | None = None,
    transient: float | None = None,
    name: str = "series",
) -> Summary:
    """Metrics of a line of sight and verdicts on it, as of a bag.

    Parameters
    ----------
    t, xy, unit, rate, name : see `series`
    requirements : requirements or their texts, or one text, or the path of a file; by default none: metrics only
    transient : seconds left out at the start; by default 5 s, of less than 10 s the first half

    Returns
    -------
    Summary, with one `Verdict` for each requirement in ``verdicts``.

    Raises
    ------
    ValueError
        Samples or requirements that cannot be read.
    """
    run = series(t, xy, unit=unit, rate=rate, name=name)
    return summarise(run, transient=transient, requirements=_requirements(requirements))


def _requirements(
    asked: str | os.PathLike[str] | Sequence[Requirement | str] | None,
) -> tuple[Requirement, ...] | None:
    if asked is None:
        return None
    if isinstance(asked, os.PathLike) or (isinstance(asked, str) and "prob" not in asked):
        return load(asked)
    entries = [asked] if isinstance(asked, str) else asked
    return tuple(parse(entry) if isinstance(entry, str) else entry for entry in entries)
