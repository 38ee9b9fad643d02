"""The unnamed lines of a whole record, found part by part, and what all lines leave.

A long record is searched in parts: a tone that drifts over an hour is steady for minutes, and the memory stays small.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pointing_analysis.arrays import FloatArray
from pointing_analysis.read.mapped_arrays import empty, parts, release
from pointing_analysis.spectra.line_search import find_lines
from pointing_analysis.spectra.sidebands import FoundLine
from pointing_analysis.spectra.spectra import SpectralLine, without_lines

LONGEST = 1 << 19
"""Samples of a part."""

LEAST = 1e-4
"""Of the record's standard deviation: what the named tones leave below it is no noise but the errors of their fit."""

NAMED = 2.0
"""Lines so close to a named tone, in 1 / T, are what its fit leaves of it."""


def unnamed_lines(
    error: FloatArray, dt: float, named: Sequence[SpectralLine] = ()
) -> tuple[tuple[FoundLine, ...], FloatArray]:
    """Lines of unknown frequencies, the lowest first, and the record without them and the named ones.

    Of a record that is searched in parts each line has its root mean square over the parts, and the bounds likewise.

    Parameters
    ----------
    error : (n, 2), NaN where a sample is missing
    dt : [s]
    named : lines of the tones that are named
    """
    rest = without_lines(error, dt, named) if named else error
    known = np.array([line.omega for line in named])
    step = max(1, len(error) // LONGEST)
    if named and np.nanstd(_thinned(rest, step)) <= LEAST * np.nanstd(_thinned(error, step)):
        return (), rest
    count = max(1, -(-len(rest) // LONGEST))
    edges = np.linspace(0, len(rest), count + 1).round().astype(int)
    of_parts: list[list[FoundLine]] = []
    cleaned: FloatArray | None = None
    for begin, end in zip(edges[:-1].tolist(), edges[1:].tolist()):
        part = np.array(rest[begin:end])
        apart = NAMED * 2.0 * math.pi / (dt * len(part)) if len(part) else 0.0
        lines = [line for line in find_lines(part, dt) if not np.any(np.abs(known - line.omega) < apart)]
        of_parts.append(lines)
        if lines:
            if cleaned is None:
                cleaned = empty(rest.shape)
                cleaned[:begin] = rest[:begin]
            time = (np.arange(len(part)) - 0.5 * (len(part) - 1)) * dt
            total = np.zeros((len(part), 2))
            for line in lines:
                total += (np.exp(1j * line.omega * time)[:, None] * line.phasor).real
            part -= total
        if cleaned is not None:
            cleaned[begin:end] = part
        release()
    width = 2.0 * math.pi * count / (dt * max(len(rest), 1))
    return _over_parts(of_parts, width), rest if cleaned is None else cleaned


def _thinned(values: FloatArray, step: int) -> FloatArray:
    """``values[::step]``, gathered part by part: a stride over a long record has all of its pages in memory."""
    pieces = [np.array(values[part][-part.start % step :: step]) for part in parts(len(values))]
    return np.concatenate(pieces) if pieces else values


def _over_parts(of_parts: Sequence[Sequence[FoundLine]], width: float) -> tuple[FoundLine, ...]:
    """Lines of all parts, those of one frequency together."""
    if len(of_parts) == 1:
        return tuple(of_parts[0])
    groups: list[list[FoundLine]] = []
    for line in sorted((line for lines in of_parts for line in lines), key=lambda line: line.omega):
        if groups and line.omega - groups[-1][-1].omega < width:
            groups[-1].append(line)
        else:
            groups.append([line])
    return tuple(_mean(group, len(of_parts)) for group in groups)


def _mean(group: Sequence[FoundLine], parts: int) -> FoundLine:
    """Root mean square of a line over the parts of a record; where it was not found it is zero."""

    def rms(values: Sequence[FloatArray]) -> FloatArray:
        return np.asarray(np.sqrt(np.sum(np.square(values), axis=0) / parts))

    strongest = max(group, key=lambda line: line.power)
    level = sum(10.0 ** (line.level / 10.0) for line in group) / parts
    return replace(
        strongest,
        omega=float(np.mean([line.omega for line in group])),
        phasor=rms([line.amplitude for line in group]).astype(complex),
        lower=rms([line.lower for line in group]),
        upper=rms([line.upper for line in group]),
        level=10.0 * math.log10(level),
        chance=min(line.chance for line in group),
    )
