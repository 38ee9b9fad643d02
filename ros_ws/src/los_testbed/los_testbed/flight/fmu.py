"""Functional mock-up units (FMI 2.0, co-simulation) of the laws and of the telescope.

A communication step is one tick, or several with the same inputs. After a step the outputs of the telescope are the
samples of the tick at its beginning, those of the laws the command for the next tick: in each step the telescope first,
then the laws, then the loop is that of the testbed.
"""

from __future__ import annotations

import shlex
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from lftkit.errors import InputError
from lftkit.support.atomic_output import atomic_file
from lftkit.systems.ports import Port
from los_testbed import __version__
from los_testbed.flight.export import FLAGS, compiler, render, template, windows_compiler
from los_testbed.flight.laws import FlightLaws
from los_testbed.flight.tables import HEADER, UNITS, Tables, common_hash
from titop_plant.interface import (
    CAMERA,
    DT,
    K_FSM_OUTPUTS,
    TRUTH,
    TRUTH_PORTS,
)
from titop_plant.simulation.constant_step import ConstantStep
from titop_plant.simulation.plant import Plant
from titop_plant.telescope.loop_ports import LoopPorts

LAW, PLANT = "los_law", "los_plant"
LINUX, WINDOWS = "linux64", "win64"
LIBRARIES = {LINUX: (".so", "-fPIC", "-fvisibility=hidden", "-lm"), WINDOWS: (".dll",)}
"""Of each platform the end of its libraries and what they need beside the flags of flight code."""
LONGEST_S = 1800.0
"""Time limit of a compiler [s]: that of ziglang compiles its libraries once, which takes minutes."""
TIME = (1980, 1, 1, 0, 0, 0)
"""Of the entries of the archive: the same laws give the same sources."""


@dataclass(frozen=True)
class Model:
    """Sources of a unit.

    Parameters
    ----------
    identifier : str
    description : str
    inputs, outputs : tuple of (str, str)
        Names and units.
    files : mapping of str to str
        C files and headers of the model.
    sha256 : str
        Of its tables.
    """

    identifier: str
    description: str
    inputs: tuple[tuple[str, str], ...]
    outputs: tuple[tuple[str, str], ...]
    files: dict[str, str]
    sha256: str

    def sources(self) -> dict[str, str]:
        """All sources, with those of FMI."""
        values = self._given()
        return {**self.files, **{name: template(name).render(**values) for name in ("fmu_model.h", "fmi2.c")}}

    def xml(self) -> str:
        """The description of the model."""
        names = sorted(name for name in self.sources() if name.endswith(".c"))
        return template("modelDescription.xml").render(sources=names, **self._given())

    def _given(self) -> dict[str, Any]:
        return {
            "identifier": self.identifier,
            "description": self.description,
            "inputs": self.inputs,
            "outputs": self.outputs,
            "guid": f"{{{self.sha256[:32]}}}",
            "tick": repr(DT),
            "version": __version__,
        }


def variables(ports: Sequence[Port]) -> tuple[tuple[str, str], ...]:
    """Name and unit of each value of some ports.

    Examples
    --------
    >>> variables([Port("fsm_angle", 2, "rad")])
    (('fsm_angle_0', 'rad'), ('fsm_angle_1', 'rad'))
    """
    return tuple((f"{port.name}_{k}", port.unit) for port in ports for k in range(port.size))


def law_model(laws: FlightLaws) -> Model:
    """The laws: measurement to command and estimate."""
    inputs, outputs = variables(laws.ports.measured), variables((*laws.ports.commanded, *K_FSM_OUTPUTS))
    names = (HEADER, *(f"{unit}.c" for unit in UNITS))
    files = render(laws, names)
    files[f"{LAW}.c"] = template(f"{LAW}.c").render(inputs=inputs, outputs=outputs)
    digest = common_hash({unit: tables.sha256 for unit, tables in laws.tables().items()})
    text = f"Observer {laws.k_fsm.name}, mirror law, proof-mass law {laws.k_pma.name}; camera inputs: NaN where absent"
    return Model(LAW, text, inputs, outputs, files, digest)


def plant_model(plant: object, ports: LoopPorts) -> Model:
    """The telescope with its disturbance, without sensor noise: command to measurement and true line of sight.

    Between its frames the value of the camera is the last one.

    Parameters
    ----------
    plant : Plant
        It is reset.
    ports : LoopPorts
        Its sensors and actuators.

    Raises
    ------
    ValueError
        A plant of another kind, one with further parts, or one whose parameters change.
    """
    if not isinstance(plant, Plant) or not plant.is_plain or not isinstance(plant.dynamics, ConstantStep):
        raise InputError(f"the plant must be the telescope with constant parameters, got {_kind_of(plant)}")
    plant.reset()
    step, order = plant.dynamics.arrays, plant.dynamics.numbers.order
    tables = {
        "OWN": step.own,
        "CROSS": step.cross,
        "DRIVE": step.driven,
        **({"WITHIN": step.block} if order > len(step.own) else {}),
        "OUTPUTS": step.outputs,
        **({"TURN": step.turn} if step.turn.size else {}),
        "START": plant.values,
        "LIMITS": plant.authority,
        "BIAS": plant.sensors.bias,
    }
    rounded = Tables.of(**tables)
    every = np.ones(ports.measurements, int)
    every[CAMERA] = plant.frame_ticks
    inputs, outputs = variables(ports.commanded), variables((*ports.measured, *TRUTH_PORTS))
    text = template(f"{PLANT}.c").render(
        name=f"Values: {plant.parameters_hash}",
        order=order,
        plain=len(step.own),
        pairs=step.pairs,
        commands=ports.commands,
        tones=step.turn.shape[1],
        driven=len(step.driven),
        measurements=ports.measurements,
        truth=TRUTH,
        every=every.tolist(),
        tables="\n".join(map(rounded.declaration, rounded.values)),
    )
    about = f"Telescope {plant.parameters_hash} with its disturbance, without sensor noise"
    return Model(PLANT, about, inputs, outputs, {f"{PLANT}.c": text}, rounded.sha256)


def _kind_of(plant: object) -> str:
    """Description of a plant for an error: its class, or its difference from a telescope with constant parameters."""
    if not isinstance(plant, Plant):
        return type(plant).__name__
    return (
        "one with held inputs, sensors at places or device limits"
        if not plant.is_plain
        else "one whose parameters change"
    )


def write_fmu(model: Model, output: Path, *, windows: bool = False) -> dict[str, str]:
    """Write a unit: description, sources, the library for Linux where there is a compiler, and that for Windows.

    Returns
    -------
    dict
        Of each platform the compiler, or what is missing.

    Raises
    ------
    ValueError
        A compiler does not compile it; `windows` without a compiler for it.
    """
    compilers = {LINUX: compiler() if sys.platform.startswith("linux") else None}
    if windows:
        compilers[WINDOWS] = windows_compiler()
    sources, built = model.sources(), {}
    with atomic_file(output) as path, zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        write = partial(_entry, archive)
        write("modelDescription.xml", model.xml().encode())
        for name, text in sorted(sources.items()):
            write(f"sources/{name}", text.encode())
        for platform, command in compilers.items():
            if command is None:
                built[platform] = "not built: no C compiler for a library of this system; the unit has its sources"
                continue
            suffix, *flags = LIBRARIES[platform]
            folder = Path(f"{path}.{platform}")
            folder.mkdir()
            try:
                library = _library(model.identifier + suffix, sources, [*command, *flags], folder)
            finally:
                shutil.rmtree(folder, ignore_errors=True)
            write(f"binaries/{platform}/{model.identifier}{suffix}", library)
            built[platform] = f"built by {_named(command)}"
    return built


def _library(name: str, sources: dict[str, str], command: list[str], folder: Path) -> bytes:
    for file, text in sources.items():
        (folder / file).write_text(text, "utf-8")
    files = [str(folder / file) for file in sources if file.endswith(".c")]
    line = [*command, *FLAGS, "-shared", *files, "-o", str(folder / name)]
    try:
        done = subprocess.run(line, capture_output=True, text=True, errors="replace", timeout=LONGEST_S)
    except subprocess.TimeoutExpired:
        raise InputError(f"{_named(command)} must compile the unit within {LONGEST_S:g} s, got no library") from None
    if done.returncode:
        raise InputError(f"{_named(command)} must compile the unit, got {done.stderr.strip().splitlines()[:1]}")
    return (folder / name).read_bytes()


def _named(command: list[str]) -> str:
    """A command without the path of this interpreter."""
    return shlex.join(["python" if part == sys.executable else part for part in command])


def _entry(archive: zipfile.ZipFile, name: str, data: bytes) -> None:
    entry = zipfile.ZipInfo(name, TIME)
    entry.compress_type = zipfile.ZIP_DEFLATED
    entry.external_attr = 0o644 << 16
    archive.writestr(entry, data)
