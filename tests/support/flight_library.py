"""Flight code as a shared library, called through ctypes; compilers and their options."""

from __future__ import annotations

import ctypes
import subprocess
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from los_testbed.flight.export import FILES, render
from los_testbed.flight.laws import FlightLaws
from los_testbed.flight.tables import HEADER, UNITS
from los_testbed.parts.flight_library import LibraryLaw

from lftkit.arrays import BoolArray, FloatArray
from titop_plant.interface import STAGES

STRICT = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Wconversion", "-Wdouble-promotion", "-Werror"]
LEVELS = ("-O0", "-O1", "-O2", "-O3")
_ROOM = 1 << 14
"""Bytes for the state of a law: that of order 22 takes 400."""


LIBRARY = (HEADER, *(f"{unit}.c" for unit in UNITS))
"""Files of the library, without its self test."""


def write(laws: FlightLaws, folder: Path, names: Sequence[str] = FILES) -> Path:
    """The files of the laws, in a new folder."""
    folder.mkdir()
    for name, text in render(laws, names).items():
        (folder / name).write_text(text, "utf-8")
    return folder


def build(folder: Path, compiler: str, *options: str) -> Path:
    """Shared library of the units in a folder, without a warning."""
    library = folder / f"{compiler}{''.join(options)}.so"
    sources = [str(folder / f"{unit}.c") for unit in UNITS]
    line = [compiler, *STRICT, "-ffp-contract=off", *options, "-fPIC", "-shared", *sources, "-o", str(library)]
    done = subprocess.run(line, capture_output=True, text=True, check=False)
    assert done.returncode == 0 and not done.stderr, done.stderr
    return library


def pointer(values: FloatArray) -> ctypes.c_void_p:
    assert values.dtype == float and values.flags.c_contiguous
    return ctypes.c_void_p(values.ctypes.data)


def observer_of(library: Path, start: tuple[FloatArray, FloatArray] | None = None) -> LibraryLaw:
    """Observer of a library, at rest or in a state with values that are held."""
    law = LibraryLaw(library, "k_fsm")
    if start is not None:
        law.start_at(*start)
    law.reset()
    return law


class FlightController:
    """Controller of a library, with the interface of `FsmPmaController`."""

    def __init__(self, library: Path, stage: str = STAGES[-1], start: FloatArray | None = None) -> None:
        self._library = ctypes.CDLL(str(library))
        self._self = ctypes.create_string_buffer(_ROOM)
        self._start = start
        self._library.los_controller_init(self._self)
        self.switch(stage)
        self.reset()

    def switch(self, stage: str) -> None:
        self._library.los_controller_switch(self._self, STAGES.index(stage))

    def limit(self, mirror: float, force: float) -> None:
        self._library.los_controller_limit(self._self, ctypes.c_double(mirror), ctypes.c_double(force))

    def step(self, los_estimate: FloatArray, accel_Ip: FloatArray, out: FloatArray) -> None:
        estimate, accel = np.ascontiguousarray(los_estimate), np.ascontiguousarray(accel_Ip)
        self._library.los_controller_step(self._self, pointer(estimate), pointer(accel), pointer(out))

    def reset(self) -> None:
        if self._start is None:
            self._library.los_controller_reset(self._self)
        else:
            self._library.los_k_pma_reset_to(self._self, pointer(self._start))  # the first member of the structure


def same_bits(found: FloatArray, expected: FloatArray) -> BoolArray:
    """Where the bits are the same; a NaN is the same as any NaN."""
    same: BoolArray = found.view(np.uint64) == expected.view(np.uint64)
    return same | (np.isnan(found) & np.isnan(expected))
