"""Files of the flight code from templates, and its self test where there is a compiler."""

from __future__ import annotations

import importlib.util
import json
import os
import shlex
import shutil
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import jinja2

from lftkit.errors import InputError
from lftkit.support.atomic_output import atomic_folder
from lftkit.systems.ports import Port, port_slices
from lftkit.systems.sampled.sampled_system import SampledSystem
from los_testbed import __version__
from los_testbed.flight.laws import FlightLaws
from los_testbed.flight.tables import HEADER, UNITS, Tables, common_hash, hex_float
from los_testbed.flight.vectors import gate_ticks, law_ticks
from titop_plant.interface import MIRROR, TICK_NS

TEMPLATES = Path(__file__).with_name("templates")

FILES = (HEADER, *(f"{unit}.c" for unit in UNITS), "self_test.c", "Makefile", "CMakeLists.txt")
"""Files of the export."""

SOURCES = (*(f"{unit}.c" for unit in UNITS), "self_test.c")
FLAGS = ("-std=c99", "-O2", "-ffp-contract=off")
COMPILERS = ("cc", "gcc", "clang")
MINGW = "x86_64-w64-mingw32-gcc"
TIME_LIMIT_S = 120.0
LONGEST_ENTRY, LONGEST_TEXT = 200, 3000
"""Characters of one entry of the provenance, and of all: C99 promises 4095 in a string."""


@dataclass(frozen=True)
class SelfTest:
    """Result of the self test.

    Parameters
    ----------
    status : {"passed", "failed", "not built"}
    compiler : str
        Command; empty where there is none.
    text : str
        What it printed, or why it was not built.
    """

    status: str
    compiler: str
    text: str


def provenance(law: SampledSystem) -> dict[str, str]:
    r"""Provenance of a law, names to JSON, escaped for C comments and strings.

    Entries that are lists or objects are left out, long texts are cut.

    Examples
    --------
    >>> law = SampledSystem([], [], [], [[1.0]], (Port("u", 1),), (Port("y", 1),), 1e-3, "*/ mine")
    >>> provenance(law)
    {'name': '"\\u002a/ mine"', 'dt': '0.001'}
    """
    entries: dict[str, Any] = {"name": law.name, "dt": law.dt}
    for group in ("design_basis", "provenance"):
        entries |= {f"{group}.{key}": value for key, value in getattr(law, group).items()}
    kept, total = {}, 0
    for key, value in entries.items():
        if not isinstance(value, (str, int, float)):
            continue
        name, text = _plain(key), _plain(value[:LONGEST_ENTRY] if isinstance(value, str) else value)
        total += len(name) + len(text) + 4
        if total <= LONGEST_TEXT:
            kept[name[1:-1]] = text
    return kept


def _plain(value: Any) -> str:
    """JSON in ASCII without stars and question marks, which end comments and make trigraphs."""
    return json.dumps(value, default=str).replace("*", "\\u002a").replace("?", "\\u003f")


def c_string(entries: Mapping[str, str]) -> str:
    """JSON object of :func:`provenance` as a string of C, one line for each entry."""
    texts = [f'"{name}": {text}' for name, text in entries.items()]
    lines = [text + (", " if i < len(texts) - 1 else "}") for i, text in enumerate(texts)]
    lines[0] = "{" + lines[0]
    return "".join('\n    "' + line.replace("\\", "\\\\").replace('"', '\\"') + '"' for line in lines)


def _rows(ports: tuple[Port, ...]) -> list[str]:
    """Columns, name and unit of each port of a vector."""
    columns = port_slices(ports)
    return [
        f"[{part.start}..{part.stop - 1}]".ljust(9) + f"{port.name} [{port.unit.replace(',', ', ')}]"
        for port, part in zip(ports, columns.values(), strict=True)
    ]


def template(name: str) -> jinja2.Template:
    """Template of the file of this name, in which ``hex`` writes a number with all of its bits."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,  # of C; texts of XML are escaped in their template
    )
    environment.filters["hex"] = hex_float
    return environment.get_template(f"{name}.j2")


def render(laws: FlightLaws, names: Sequence[str] = FILES) -> dict[str, str]:
    """Text of each file of these names, of :data:`FILES`; the same laws give the same bytes."""
    tables = laws.tables()
    hashes = {unit: tables[unit].sha256 for unit in UNITS}
    common = {
        "version": __version__,
        "tick_ns": TICK_NS,
        "measurements": laws.ports.measurements,
        "commands": laws.ports.commands,
        "units": UNITS,
        "tables_sha256": common_hash(hashes),
        "fade_ticks": laws.fade_ticks,
    }
    fill = {
        HEADER: partial(_header, laws),
        **{f"{unit}.c": partial(_unit, laws, unit, tables[unit]) for unit in UNITS},
        "self_test.c": partial(_self_test, laws),
    }
    return {name: template(name).render(**common, **fill.get(name, dict)()) for name in names}


def _header(laws: FlightLaws) -> dict[str, Any]:
    return {
        **{name: provenance(getattr(laws, name))["name"] for name in ("k_fsm", "k_pma")},
        "measured": _rows(laws.ports.measured),
        "commanded": _rows(laws.ports.commanded),
        "los_sensitivity": repr(laws.los_sensitivity),
        "held_ports": ", ".join(row.name for row in laws.ports.framed),
        "platform": laws.measured.start,
        "accelerations": laws.measured.stop - laws.measured.start,
        "forces": laws.ports.commands - MIRROR.stop,
        "mirror_axes": MIRROR.stop - MIRROR.start,
        "held": len(laws.ports.held),
        "order_k_fsm": laws.k_fsm.order,
        "order_k_pma": laws.k_pma.order,
        "columns_k_fsm": laws.k_fsm.order + laws.ports.measurements,
        "columns_k_pma": laws.k_pma.order + laws.measured.stop - laws.measured.start,
    }


def _unit(laws: FlightLaws, unit: str, tables: Tables) -> dict[str, Any]:
    values: dict[str, Any] = {
        "sha256": tables.sha256,
        "tables": "\n".join(tables.declaration(name) for name in tables.values),
    }
    if unit in ("k_fsm", "k_pma"):
        entries = provenance(getattr(laws, unit))
        values["provenance"] = [f"{name}: {text}" for name, text in entries.items()]
        values["provenance_text"] = c_string(entries)
    if unit == "k_fsm":
        values["held_columns"] = laws.ports.held.tolist()
        values["parts"] = [0, *(part.stop for part in laws.ports.held_parts.values())]
    return values


def _self_test(laws: FlightLaws) -> dict[str, Any]:
    gates = zip(("LOS_GATE_MIRROR", "LOS_GATE_FORCES"), laws.gates())
    times = laws.hold_ticks, laws.fade_ticks
    return {
        "law_ticks": list(law_ticks(laws)),
        "gate_ticks": [(kind, list(gate_ticks(gate, *times))) for kind, gate in gates],
    }


def write_flight_code(laws: FlightLaws, output: Path) -> SelfTest:
    """Write the files into a new folder, and build and run their self test if there is a compiler.

    Parameters
    ----------
    laws : FlightLaws
    output : Path
        New folder; it holds nothing of the build.
    """
    files = render(laws)
    with atomic_folder(output) as folder:
        folder.mkdir()
        for name, text in files.items():
            (folder / name).write_text(text, "utf-8")
        build = folder / ".build"
        try:
            result = self_test(folder, build)
        finally:
            shutil.rmtree(build, ignore_errors=True)
    return result


def compiler() -> list[str] | None:
    """Command of the C compiler: that of the variable CC, else the first one that there is; None without one."""
    command = shlex.split(os.environ.get("CC", ""))
    if command:
        return command if shutil.which(command[0]) else None
    return next(([name] for name in COMPILERS if shutil.which(name)), None)


def windows_compiler() -> list[str]:
    """Command of a C compiler for 64 bit Windows: MinGW-w64, else that of the package ziglang.

    Raises
    ------
    ValueError
        There is none.
    """
    if shutil.which(MINGW):
        return [MINGW]
    if importlib.util.find_spec("ziglang") is not None:
        return [sys.executable, "-m", "ziglang", "cc", "-target", "x86_64-windows-gnu"]
    raise InputError(f"--windows needs {MINGW}, or the package ziglang: pip install 'los-testbed[win64]'")


def self_test(folder: Path, build: Path) -> SelfTest:
    """Build the self test of flight code in the new folder `build`, and run it."""
    command = compiler()
    if command is None:
        named = os.environ.get("CC") or ", ".join(COMPILERS)
        return SelfTest("not built", "", f"no C compiler ({named})")
    build.mkdir()
    name, program = shlex.join(command), build / "self_test"
    sources = [str(folder / source) for source in SOURCES]
    for line in ([*command, *FLAGS, *sources, "-o", str(program)], [str(program)]):
        try:
            done = subprocess.run(line, capture_output=True, text=True, errors="replace", timeout=TIME_LIMIT_S)
        except (OSError, subprocess.TimeoutExpired) as error:
            return SelfTest("failed", name, " ".join(str(error).split()))
        if done.returncode:
            text = (done.stderr + done.stdout).strip()
            return SelfTest("failed", name, text.splitlines()[0] if text else f"exit code {done.returncode}")
    return SelfTest("passed", name, done.stdout.strip())
