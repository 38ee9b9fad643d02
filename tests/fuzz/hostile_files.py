"""Files that are made to stop, fill or end the program that reads them, and a child in which a command meets one."""

from __future__ import annotations

import contextlib
import io
import json
import os
import resource
import signal
import socket
import struct
import sys
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from hypothesis import strategies as st
from mcap.writer import Writer
from scipy import io as scipy_io
from scipy import sparse

MEMORY = 700_000_000
"""Memory that a command may take beside what this process has [byte]."""
WAIT = 90
"""Wall time after which a command waits for what never comes [s]."""
SECONDS = 20
"""Processor time that a command may take [s]."""


@dataclass(frozen=True)
class End:
    """How a command ended: exit code (negative: the signal), error output, memory taken [byte]."""

    code: int
    err: str
    memory: int


def in_child(command: Callable[[Sequence[str]], int], arguments: Sequence[str], folder: Path) -> End:
    """A command in a copy of this process with limits of memory and time: a crash ends the copy alone."""
    report = folder / "end"
    child = os.fork()
    if child == 0:
        _limited(command, arguments, folder, report)
    _, status, usage = os.wait4(child, 0)
    code = os.waitstatus_to_exitcode(status)
    err, before = json.loads(report.read_text()) if report.exists() else ("", 0)
    report.unlink(missing_ok=True)
    return End(code, err, 1024 * usage.ru_maxrss - before)


def _limited(command: Callable[[Sequence[str]], int], arguments: Sequence[str], folder: Path, report: Path) -> None:
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    before, err, code = resident(), io.StringIO(), 99
    try:
        resource.setrlimit(resource.RLIMIT_AS, (2 * MEMORY + 4096 * pages,) * 2)
        resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.alarm(WAIT)
        os.chdir(folder)
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(err):
            code = command(arguments)
    except SystemExit as stop:
        code = stop.code if isinstance(stop.code, int) else 98
    except BaseException as error:  # the end of a copy, told to the process that made it
        err.write(f"Traceback: {error!r}")
    finally:
        report.write_text(json.dumps([err.getvalue(), before]))
        sys.stdout.flush()
        os._exit(code)


def resident() -> int:
    """Memory of this process [byte]."""
    return 4096 * int(Path("/proc/self/statm").read_text().split()[1])


def no_file(path: Path, kind: str) -> None:
    """A pipe, a link to a device that never ends, a socket, or more bytes than a disk has."""
    path.unlink(missing_ok=True)
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "zero":
        path.symlink_to("/dev/zero")
    elif kind == "socket":
        with socket.socket(socket.AF_UNIX) as found:
            here = Path.cwd()
            os.chdir(path.parent)  # the name of a socket has 100 characters
            found.bind(path.name)
            os.chdir(here)
    else:
        with path.open("wb") as file:
            file.truncate(1 << 40)


KINDS = ("pipe", "zero", "socket", "endless")
NUMBERS = st.integers(1, 60_000)
NAMES = st.sampled_from(["a", '"a"', "'a'", "a-b"])
FRAMES = st.sampled_from(
    ["{} = 1", "[{}]", "[[{}]]", "x = {{ {} = 1 }}", 's = """x"""" # "\n{} = 1', "t = '''\n'''\n{} = 1"]
)


def dotted(number: int, name: str, frame: str) -> str:
    """TOML with a name of so many parts."""
    return frame.format(" . ".join([name] * number)) + "\n"


TOML = st.one_of(
    st.builds(dotted, NUMBERS, NAMES, FRAMES),
    NUMBERS.map(lambda n: "a = " + "[" * n + "]" * n),
    NUMBERS.map(lambda n: "".join(f"[a{i}.b.c.d.e]\n" for i in range(4 * n))),
    NUMBERS.map(lambda n: "a = [" + "[]," * (20 * n) + "]"),
)
YAML = st.one_of(
    NUMBERS.map(lambda n: "a: [" + "1," * (40 * n) + "1]\n"),
    NUMBERS.map(lambda n: "a: " + "[" * n),
    NUMBERS.map(lambda n: "".join(f"k{i}: 1\n" for i in range(10 * n))),
    NUMBERS.map(lambda n: "a: &a [1]\nb: [" + "*a," * n + "1]\n"),
    NUMBERS.map(lambda n: "a: [" + "1," * (10 * n) + "}"),
)
JSON = st.one_of(
    NUMBERS.map(lambda n: '{"format": ' + "[" * n + "]" * n + "}"),
    NUMBERS.map(lambda n: '{"A": [' + "[]," * (100 * n) + "[]]}"),
)
TEXTS = st.one_of(TOML, YAML, JSON)


def nested_cells(depth: int, packed: bool) -> bytes:
    """A .mat file of a cell in a cell in a cell."""
    inner = b""
    for level in range(depth):
        shape = struct.pack("<IIii", 5, 8, 1, 1) if level else struct.pack("<IIii", 5, 8, 0, 0)
        body = struct.pack("<IIII", 6, 8, 1, 0) + shape + struct.pack("<II", 1, 0) + inner
        inner = struct.pack("<II", 14, len(body)) + body
    return _mat_head() + (_packed(inner) if packed else inner)


def _mat_head() -> bytes:
    return b"MATLAB 5.0 MAT-file".ljust(124, b" ") + struct.pack("<H", 0x0100) + b"IM"


def _packed(data: bytes) -> bytes:
    found = zlib.compress(data)
    return struct.pack("<II", 15, len(found)) + found


def whole_mat() -> bytes:
    """A .mat file with a matrix of each class."""
    cells = np.empty((1, 2), object)
    cells[0, 0], cells[0, 1] = np.ones((2, 2)), "text"
    content = {
        "A": np.eye(2),
        "B": np.ones((2, 1)),
        "C": sparse.csc_matrix(np.ones((1, 2))),
        "D": np.zeros((1, 1)),
        "Ts": 0.001,
        "z": 1j * np.ones(3),
        "c": cells,
        "s": {"a": 1, "b": {"c": "deep"}},
    }
    file = io.BytesIO()
    scipy_io.savemat(file, content)
    return file.getvalue()


def changed_mat(places: list[tuple[int, int, int]], packed: bool) -> bytes:
    """The whole .mat file with other words of 4 bytes: data types, sizes, classes, indices."""
    data = bytearray(whole_mat())
    words = [i for i in range(128, len(data) - 4, 4) if struct.unpack_from("<I", data, i)[0] < 1000]
    for which, kind, value in places:
        at = words[which % len(words)]
        struct.pack_into("<I", data, at, value if kind else struct.unpack_from("<I", data, at)[0] ^ (1 << value % 32))
    if not packed:
        return bytes(data)
    at, parts = 128, []
    while at + 8 <= len(data):
        size = struct.unpack_from("<I", data, at + 4)[0]
        parts.append(_packed(bytes(data[at : at + 8 + size])))
        at += 8 + size
    return bytes(data[:128]) + b"".join(parts)


WORDS = st.one_of(st.integers(0, 300), st.sampled_from([2**31 - 1, 2**32 - 1, 2**31, 1 << 20, 10**7]))
MATS = st.one_of(
    st.builds(nested_cells, st.integers(40, 8000), st.booleans()),
    st.builds(
        changed_mat,
        st.lists(st.tuples(st.integers(0, 10**6), st.integers(0, 3), WORDS), min_size=1, max_size=4),
        st.booleans(),
    ),
)


def deep_hdf5(path: Path, depth: int, width: int) -> None:
    """An HDF5 file of groups in groups, with some beside each."""
    import h5py

    with h5py.File(path, "w") as file:
        group = file
        for _ in range(depth):
            for number in range(width):
                group.create_group(f"side{number}")
            group = group.create_group("g" * 60)
        group["los"] = np.ones((10, 2))


def branching_bag(path: Path, width: int, depth: int) -> None:
    """A bag with a message type whose fields have so many fields of the next type, and so on."""
    fields = ["\n".join(f"m/A{level + 1} f{i}" for i in range(width)) for level in range(depth)]
    parts = [fields[0], *(f"MSG: m/A{level}\n{text}" for level, text in enumerate(fields[1:], 1))]
    parts.append(f"MSG: m/A{depth}\nfloat64 x\nfloat64 y\n")
    definition = ("\n" + "=" * 80 + "\n").join(parts)
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2")
        schema = writer.register_schema("m/msg/Root", "ros2msg", definition.encode())
        channel = writer.register_channel("/los", "cdr", schema)
        for number in range(20):
            time_ns = 10_000_000 * number
            writer.add_message(channel, time_ns, b"\0\1\0\0" + bytes(16 * width**depth)[:100_000], time_ns)
        writer.finish()
