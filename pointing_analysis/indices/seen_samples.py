"""Samples that the sensor of a record took of the motion, and what the record does not show of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pointing_analysis.arrays import BoolArray, FloatArray
from pointing_analysis.formatting.number_text import digits, percent
from pointing_analysis.indices.held_rows import Hold, hold_of, samples_behind
from pointing_analysis.indices.live_rows import coarse_quantum, filled_rows, interpolated_rows, stuck_rows
from pointing_analysis.indices.metrics import AXES
from pointing_analysis.indices.row_signs import SETTINGS, LiveRowSettings
from pointing_analysis.indices.saturation import saturated_rows
from pointing_analysis.read.mapped_arrays import by_parts, parts
from pointing_analysis.units import RAD_PER_MAS


@dataclass(frozen=True)
class Unseen:
    """What a record does not show of the motion.

    Attributes
    ----------
    shares : why samples show nothing, in words, with the share of these among all
    quantum : step to which the values are rounded, where it is larger than the motion [rad]; else 0
    remarks : what else the values say of the record, one sentence each
    """

    shares: tuple[tuple[str, float], ...] = ()
    quantum: float = 0.0
    remarks: tuple[str, ...] = ()

    def reason(self, allowed: float, limit: float, settings: LiveRowSettings = SETTINGS) -> str:
        """Why nothing can be said of a limit that a part of the samples may exceed; empty where it can.

        Parameters
        ----------
        allowed : part of the samples
        limit : [rad]; infinite where it is none of the motion, zero where there is none
        """
        for why, share in self.shares:
            if share > allowed:
                return why
        if self.quantum > settings.coarse * limit:
            beside = " and half of the limit" if limit else ""
            return f"the values have steps of {digits(self.quantum / RAD_PER_MAS)} mas, larger than the motion{beside}"
        return ""


ALL_SEEN = Unseen()


def seen_samples(
    record: FloatArray, rows: FloatArray, judged: Sequence[bool], dt: float
) -> tuple[FloatArray, float, Unseen]:
    """Samples behind the last rows of a record.

    Parameters
    ----------
    record : (n, 2) [rad], NaN where a sample is missing; all of it tells whether an axis came to a stop
    rows : (m, 2) the last rows of it, zero in an axis that is not judged
    judged : of each axis
    dt : period of the rows [s]

    Returns
    -------
    values : (k, 2) [rad], NaN where a sample is missing or shows nothing
    dt : from one to the next [s]
    unseen : what they do not show
    """
    first = len(record) - len(rows)
    shares: list[tuple[str, float]] = []
    remarks: list[str] = []
    moving, hold = rows, hold_of(rows)
    if isinstance(hold, Hold):
        rate = 1.0 / (hold.rows * dt)
        if hold.between_rows:
            shares.append((f"interpolated between samples of {rate:.4g} Hz that are not at its rows", 1.0))
            remarks.append(f"{shares[0][0]}: it does not show their values")
        else:
            rows = moving = samples_behind(rows, hold)
            dt *= hold.rows
            remarks.append(
                f"each sample is held or interpolated over {hold.rows:.4g} rows: a record of {rate:.4g} Hz, which "
                f"shows no motion above {rate / 2:.4g} Hz"
            )
    elif hold is not None:
        rates = " and ".join(f"{1.0 / (count * dt):.4g}" for count in hold)
        shares.append((f"the axes have samples at different rates, {rates} Hz", 1.0))
        remarks.append(f"{shares[0][0]}: requirements on one axis are judged by its samples, those on both are not")
        at_rest = np.array(hold) > 1.0  # an axis that is held is not stuck
        moving = by_parts(lambda part: np.where(at_rest, 0.0, part), rows)
    nothing: dict[str, BoolArray] = {
        "saturated": saturated_rows(rows),
        "filled with one value": filled_rows(moving),
        "stuck": stuck_rows(moving),
        **({} if shares else {"interpolated": interpolated_rows(moving)}),
    }
    counted = np.zeros(len(rows), bool)  # each row for its first reason
    for which in nothing.values():
        which &= ~counted
        counted |= which
    for column, name in enumerate(AXES):
        if judged[column] and _is_constant(rows[:, column]):
            remarks.append(f"{name} has the same value in all samples")
            if stuck_rows(record[:, column : column + 1])[first:].any():  # it came to a stop before
                nothing["stuck"][:] = True
    for why, which in nothing.items():
        if which.any():
            share = float(which.mean())
            shares.append((f"{why}: {percent(share)} of the samples", share))
            remarks.append(f"{shares[-1][0]}, which count as missing and are in no figure")
    if any(which.any() for which in nothing.values()):
        rows = np.where(np.any([*nothing.values()], axis=0)[:, None], np.nan, rows)
    if quantum := coarse_quantum(rows):
        step = digits(quantum / RAD_PER_MAS)
        remarks.append(f"the values have steps of {step} mas, larger than the motion: smaller figures are not known")
    return rows, dt, Unseen(tuple(shares), quantum, tuple(remarks))


def _is_constant(axis: FloatArray) -> bool:
    """Whether all samples (n,) that are there have one value."""
    values = [axis[part][~np.isnan(axis[part])] for part in parts(len(axis))]
    extremes = [(one.min(), one.max()) for one in values if one.size]
    return bool(min(low for low, _ in extremes) == max(high for _, high in extremes))
