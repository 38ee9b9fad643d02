"""Open a line of sight wherever it is: a bag of the testbed, another bag, a table of any format."""

from __future__ import annotations

import os
from pathlib import Path

from lftkit.errors import InputError
from pointing_analysis.read.external_bag import TIME_SOURCES, read_external
from pointing_analysis.read.mcap.records import MAX_CHUNK
from pointing_analysis.read.recording import Recording
from pointing_analysis.read.run import Run
from pointing_analysis.read.tables.formats import Format, format_of
from pointing_analysis.read.tables.los_table import read_los_table


def open_los(
    path: str | os.PathLike[str],
    *,
    los: str | None = None,
    unit: str | None = None,
    rate: float | None = None,
    time: str | None = None,
    max_chunk: int = MAX_CHUNK,
) -> Recording:
    """Open a recording.

    Parameters
    ----------
    path : a file of one of `pointing_analysis.read.tables.formats.FORMATS`, detected by its content
    los : topic and field of a bag, names of two columns of a table; None for a bag of the testbed
    unit : rad, mrad, urad, nrad, deg, mdeg, arcmin, arcsec or mas; needed for all but a bag of the testbed and a file
        that says it
    rate : sampling rate [Hz]; by default from the times
    time : of a bag ``header``, ``log`` or ``auto``; of a table the name of the time column
    max_chunk : largest chunk of a bag that is unpacked [byte]

    Raises
    ------
    ValueError
        A file that cannot be read, or a field, unit, rate or time that does not fit.
    """
    file = Path(path)
    if format_of(file) is not Format.BAG:
        return read_los_table(file, los, unit=unit, rate=rate, time=time)
    if los is not None:
        return read_external(file, los, unit=unit, rate=rate, time=time or TIME_SOURCES[0], max_chunk=max_chunk)
    if unit is not None or rate is not None or time is not None:
        raise InputError("los must be given with unit, rate or time for a bag, got none")
    return Run.open(file, max_chunk=max_chunk)
