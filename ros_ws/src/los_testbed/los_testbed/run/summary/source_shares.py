"""Contribution of each part of a run's disturbances to the line of sight (:mod:`los_testbed.run.loop.source_alone`).

**Shares.** The lines of sight of the parts add up to that of the run. The share of a part in the relative error is its
covariance with the whole in the windows of the relative error, over the variance of the whole, both axes: for
independent parts its part of the sum of squares, and for any parts the shares add up to 1. The remainder, by
limited commands or other nonlinearities, has its own row.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict

import numpy as np

from lftkit.arrays import FloatArray
from los_testbed.run.loop.source_alone import parts_of
from los_testbed.run.summary.ran_loop import RanLoop
from pointing_analysis.indices.errors import ErrorSeries, default_transient, performance_error
from pointing_analysis.indices.metrics import samples_or_one
from pointing_analysis.indices.window_rows import ROUNDING, windows_of
from pointing_analysis.read.run import Run
from pointing_analysis.report.source_share import SourceShare
from pointing_analysis.requirements.conditions import ACTING
from pointing_analysis.requirements.exposure import probabilities_of
from pointing_analysis.requirements.settling import is_settled
from pointing_analysis.requirements.summary import Performance, exposure_of_run, requirements_of
from pointing_analysis.spectra.tone_budget import named_tones
from titop_plant.interface import DT

LONGEST = 20.0
"""Seconds of a run, from its start, that are simulated for each part and taken of the record."""
TOGETHER, REST = "together", "not linear"
"""Names of the row of the record, and of the remainder."""
SMALL = 1e-3
"""Largest relative remainder, rms in windows, without a row."""
CANCELLED = 1e-9
"""The same over the largest part: what is left of parts that cancel is rounding."""
NONE = np.zeros((0, 2))
LATE = 100
"""Ticks that may be missing at the end of a record."""


def source_shares(loop: RanLoop | None) -> tuple[SourceShare, ...]:
    """Rows of all that acted in a run with sources, or a disturbance, of the user, and of the whole; else empty.

    Raises
    ------
    ValueError
        The loop is not known to be the one that ran; code of the user that cannot be loaded.
    """
    if loop is None:
        return ()
    run = loop.run
    acting = run.parameters.get(ACTING)
    named = acting is not None and any(entry.get("kind") != "scenario" for entry in acting)
    if not (named or "disturbances" in run.parameters):
        return ()
    parts = loop.known
    config = parts.config
    ticks, window = min(config.ticks, round(LONGEST / DT)), exposure_of_run(run)
    first = round(default_transient(ticks * DT) / DT)
    by_part = [(part, part.los(ticks)[first:]) for part in parts_of(parts)]
    whole = np.sum([los for _, los in by_part], axis=0)
    record = _record(run, config.ticks, first, len(whole))
    rows = [(part.name, part.kind, part.place, los) for part, los in by_part]
    least = CANCELLED * max((_rms(los, window) for _, los in by_part), default=0.0)
    if record is not None:
        rest = record - whole
        if _rms(rest, window) > max(SMALL * _rms(record, window), least):
            rows.append((REST, "", "", rest))
        whole = record
    power = _covariance(whole, whole, window) if _rms(whole, window) > least else 0.0
    shares = [_covariance(los, whole, window) / power if power else 0.0 for *_, los in rows]
    rows.append((TOGETHER, "", f"{first * DT:g} to {ticks * DT:g} s" if first else f"{ticks * DT:g} s", whole))
    tones, probabilities = named_tones(run), probabilities_of(requirements_of(run) or ())

    def row(name: str, kind: str, place: str, los: FloatArray, share: float) -> SourceShare:
        error = Performance.of(los, DT, window, probabilities)
        settled = is_settled(ErrorSeries(los, DT, first * DT, 0), window, tones)
        return SourceShare(name, kind, place, error.ape_quantile, error.rpe_rms, share, probabilities.ape, settled)

    return tuple(row(*one, share) for one, share in zip(rows, [*shares, sum(shares)]))


def _record(run: Run, ticks: int, first: int, count: int) -> FloatArray | None:
    """The same ticks of the record, NaN where a sample is missing; None where it does not begin with the run."""
    truth = run["truth/los"]
    if truth.lost_before or len(truth) + truth.integrity.missing + truth.lost_after < ticks - LATE:
        return None
    values = performance_error(run, first * DT).values[:count]
    return values if len(values) == count else None


def _covariance(a: FloatArray, b: FloatArray, window: float) -> float:
    """Mean over disjoint windows of the covariance in a window, both axes; windows with NaN are left out."""
    n = samples_or_one(window, DT)
    starts = n * np.arange(int(len(a) / n + ROUNDING), dtype=float)
    both, apart = (np.vstack([NONE, *(square for _, square in windows_of(x, starts, n))]) for x in (a + b, a - b))
    products = 0.25 * (both - apart).sum(axis=1)
    return float(np.mean(products[np.isfinite(products)])) if np.isfinite(products).any() else 0.0


def _rms(a: FloatArray, window: float) -> float:
    """Root mean square in the windows, norm of both axes."""
    return float(np.sqrt(max(_covariance(a, a, window), 0.0)))


def as_rows(shares: Sequence[SourceShare]) -> list[dict[str, str | float]]:
    """Rows for JSON, six digits."""
    return [{k: float(f"{v:.6g}") if isinstance(v, float) else v for k, v in asdict(s).items()} for s in shares]
