"""Runs with random faults for some minutes:

    PYTHONPATH=tests python tests/fuzz/fault_campaign.py MINUTES [SEED] [CASE ...]

Each case is one run of the program with one fault, chosen by the seed and the number of the case: a signal to one of
its processes, a full disk, too few descriptors, too little memory, one processor, steps of the wall clock, a second run
on its domain or output.
A case is judged from outside: exit code and words of the message, processes that are left, bags that can be read or
repaired. The table at the end counts; what is wrong is printed at once, with the command that repeats it. Exit code:
0 nothing found, 1 something found.
"""

from __future__ import annotations

import atexit
import contextlib
import functools
import importlib.util
import os
import random
import re
import resource
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from los_testbed.bags.repair import repair_bag
from los_testbed.config.run_config import NAMESPACE
from los_testbed.run.processes.domains import domain_lock
from mcap.reader import NonSeekingReader
from support.marked_processes import processes_with

from pointing_analysis.command.exit_codes import ExitCode
from pointing_analysis.read.mcap.records import BagError
from pointing_analysis.read.run import Run
from titop_plant.interface import TICK_NS

HANG_S = 300.0
"""Wall time in which a run must end, also on a busy machine."""
LEFT_S = 30.0
"""Time in which its processes must be gone."""
DURATION_S = 2.0
MARK = "FAULT_CASE"
CLOCK_SOURCE = Path(__file__).parents[1] / "support" / "clock_step.c"
HOUR_S = 3600
MCAP0_MAGIC = b"\x89MCAP0\r\n"
LOOP = ("plant", "estimator", "controller")
NODES = (*LOOP, "recorder", *(("live",) if importlib.util.find_spec("foxglove") else ()))
"""Its processes; the server for viewers runs where it is the one that is chosen."""
UNANSWERED = (signal.SIGKILL, signal.SIGSEGV, signal.SIGABRT)
PAUSE_TICKS = 800
"""Commands that a loop misses while a node of it is started again, at least; it is never so long without a fault."""
ENDS = (signal.SIGKILL, signal.SIGTERM, signal.SIGHUP, signal.SIGSEGV, signal.SIGABRT)
COLUMNS = ("cases", "survived", "reported", "orphans", "unreadable bags", "wrong exit codes")
OK, FAILED, MISTAKE = ExitCode.FINISHED, ExitCode.FAILED, ExitCode.USER_ERROR


@dataclass
class Case:
    """One run and its fault.

    Attributes
    ----------
    kind : what the table counts it under
    text : the fault, for the reader
    folder : everything that it writes
    allowed : exit codes, each with the words that the output must have with it
    mode : mode of the run
    act : does the fault while the run goes on
    prepare : limits of the process, set before the program begins
    variables : of the environment of the program
    options : of the program
    crashed : a node of the loop that was ended by a signal that it cannot answer
    bag : where it is written
    """

    kind: str
    text: str
    folder: Path
    allowed: dict[int, str]
    mode: str = "realtime"
    act: Callable[[Case, subprocess.Popen[str]], None] = lambda case, process: None
    prepare: Callable[[], None] = lambda: None
    variables: dict[str, str] = field(default_factory=dict)
    options: tuple[str, ...] = ()
    crashed: str = ""
    bag: Path = field(init=False)
    outputs: list[tuple[int, str]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.bag = self.folder / "bag"


def start(case: Case, domain: int, bag: Path) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "los_testbed.cli.app", "run", f"--mode={case.mode}", f"--duration={DURATION_S:g}"]
    command += [f"--output={bag}", "--no-report", f"--domain={domain}", "--max-missed=100", "--start=rest"]
    command += case.options
    variables = {**os.environ, MARK: str(case.folder), "OPENBLAS_NUM_THREADS": "1", "COLUMNS": "400"}
    variables |= case.variables
    return subprocess.Popen(
        command,
        cwd=case.folder,
        env=variables,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
        preexec_fn=case.prepare,
    )


TAKEN = f"without another run in namespace {NAMESPACE} on this machine"
"""In the refusal of a domain that another program took after :func:`some_domain` had found it free."""


def some_domain() -> int:
    """A ROS domain that other runs of this machine do not use: the smallest free one may be taken by the next."""
    while True:
        domain = random.SystemRandom().randrange(40, 101)
        with contextlib.suppress(ValueError), domain_lock(domain, NAMESPACE):
            return domain


def moment(case: Case, process: subprocess.Popen[str], rng: random.Random) -> None:
    """Wait until a random time of the start, or a random tick of the run."""
    early = rng.random() < 0.3
    wait = rng.uniform(0.0, 6.0 if early else 1.1 * DURATION_S)
    end = time.monotonic() + HANG_S
    while not early and not case.bag.exists() and process.poll() is None and time.monotonic() < end:
        time.sleep(0.005)
    time.sleep(wait)


ANY_MODE = ("realtime", "lockstep", "inprocess")


def signal_to_node(rng: random.Random, folder: Path) -> Case:
    node, number = rng.choice(NODES), rng.choice(ENDS)
    named = rf"\w*{node}\w* ended unexpectedly \(signal {number.value}\)"  # both laws are in one process
    before = rf"recorder: a plant must run|was ended before|{node}: |the run ended before|did not reach"
    allowed = {OK: "", ExitCode.RESTARTED: named, FAILED: f"{named}|{before}"}
    mode, live = rng.choice(("realtime", "realtime", "lockstep")), ("--live=0",) if node == "live" else ()
    if node == "live":
        allowed = {OK: "", FAILED: f"server for viewers|{node}|{before}"}

    def act(case: Case, process: subprocess.Popen[str]) -> None:
        moment(case, process, rng)
        for pid in processes_with(f"{MARK}={folder}", f"nodes.{node}")[:1]:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, number)
                if node in LOOP and number in UNANSWERED:
                    case.crashed = node

    text = f"{number.name} to {node}"
    return Case(f"{number.name} to a node", text, folder, allowed, mode, act=act, options=live)


def pause_of_process(rng: random.Random, folder: Path) -> Case:
    name, pause = rng.choice((*NODES, "runner")), rng.uniform(0.05, 2.0)

    def act(case: Case, process: subprocess.Popen[str]) -> None:
        moment(case, process, rng)
        pids = [process.pid] if name == "runner" else processes_with(f"{MARK}={folder}", f"nodes.{name}")[:1]
        with contextlib.suppress(ProcessLookupError):
            for pid in pids:
                os.kill(pid, signal.SIGSTOP)
            time.sleep(pause)
            for pid in pids:
                os.kill(pid, signal.SIGCONT)

    text, live = f"SIGSTOP to {name} for {pause:.2f} s", ("--live=0",) if name == "live" else ()
    return Case("SIGSTOP", text, folder, {OK: ""}, rng.choice(ANY_MODE[:2]), act=act, options=live)


def signal_to_runner(rng: random.Random, folder: Path) -> Case:
    number = rng.choice((signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGKILL))
    allowed = {-number.value: "", OK: ""}  # before the program answers signals
    if number != signal.SIGKILL:
        allowed[ExitCode.INTERRUPTED] = ""

    def act(case: Case, process: subprocess.Popen[str]) -> None:
        moment(case, process, rng)
        process.send_signal(number)

    def end_by_interrupt() -> None:
        signal.signal(signal.SIGINT, signal.default_int_handler)

    text = f"{number.name} to the program"
    return Case(text, text, folder, allowed, rng.choice(ANY_MODE), act=act, prepare=end_by_interrupt)


def limited(kind: str, what: int, low: int, high: int, unit: int, words: str) -> Callable[[random.Random, Path], Case]:
    """Case with a limit of a resource; whatever the run says of it must have these words."""

    def make(rng: random.Random, folder: Path) -> Case:
        limit, allowed = rng.randint(low, high), {OK: "", FAILED: words, MISTAKE: words}
        return Case(
            kind,
            f"{kind} {limit}",
            folder,
            allowed,
            rng.choice(ANY_MODE),
            prepare=lambda: resource.setrlimit(what, (limit * unit, limit * unit)),
        )

    return make


def one_processor(rng: random.Random, folder: Path) -> Case:
    processor, mode = rng.choice(sorted(os.sched_getaffinity(0))), rng.choice(ANY_MODE[:2])
    text, allowed = f"processor {processor} alone", {OK: "", FAILED: "within .* s"}
    return Case("one processor", text, folder, allowed, mode, prepare=lambda: os.sched_setaffinity(0, {processor}))


def full_disk(rng: random.Random, folder: Path) -> Case:
    size, small = rng.randint(8, 1500), folder / "small"
    small.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}k", "tmpfs", str(small)], check=True)
    allowed = {OK: "", FAILED: "No space left on device"}
    case = Case("full disk", f"disk of {size} kB", folder, allowed, rng.choice(ANY_MODE))
    case.bag = small / "bag"
    return case


def second_run(rng: random.Random, folder: Path) -> Case:
    """Another run on the domain or the output of one; the first is not disturbed, the second is refused."""
    same, mode = rng.choice(("domain", "output")), rng.choice(ANY_MODE[:2])

    def act(case: Case, process: subprocess.Popen[str]) -> None:
        time.sleep(rng.uniform(0.0, 3.0))
        own = re.search(r"--domain=(\d+)", " ".join(map(str, process.args)))  # type: ignore[call-overload]
        assert own is not None
        domain = int(own.group(1)) if same == "domain" else some_domain()
        other = start(case, domain, case.bag if same == "output" else folder / "other")
        out = other.communicate(timeout=HANG_S)[0]
        case.outputs.append((other.returncode, out))

    return Case(f"second run, same {same}", f"another run with the same {same}", folder, {OK: ""}, mode, act=act)


def clock_step(rng: random.Random, folder: Path) -> Case:
    """The wall clock of all its processes is set by up to an hour, back and forth."""
    offset, mode = folder / "offset", rng.choice(("realtime", *ANY_MODE))
    offset.write_bytes(struct.pack("<q", 0))
    variables = {"LD_PRELOAD": str(build_clock()), "CLOCK_STEP_FILE": str(offset)}

    def act(case: Case, process: subprocess.Popen[str]) -> None:
        for _ in range(3):
            moment(case, process, rng)
            with offset.open("r+b") as stream:
                stream.write(struct.pack("<q", rng.randint(-HOUR_S, HOUR_S)))

    return Case("clock step", "wall clock set three times", folder, {OK: ""}, mode, act=act, variables=variables)


@functools.cache
def build_clock() -> Path:
    """Library with a wall clock that can be set."""
    library = Path(tempfile.mkdtemp(prefix="fault_clock_")) / "clock_step.so"
    command = [compiler(), "-shared", "-fPIC", "-O1", "-o", str(library), str(CLOCK_SOURCE), "-ldl"]
    subprocess.run(command, check=True)
    atexit.register(shutil.rmtree, library.parent, ignore_errors=True)
    return library


def compiler() -> str:
    """C compiler of this machine; empty without one."""
    return shutil.which("cc") or shutil.which("gcc") or ""


FAULTS: list[tuple[int, Callable[[random.Random, Path], Case]]] = [
    (8, signal_to_node),
    (3, pause_of_process),
    (3, signal_to_runner),
    (1, limited("descriptors", resource.RLIMIT_NOFILE, 8, 80, 1, "open files|descriptor")),
    (2, limited("memory [MB]", resource.RLIMIT_AS, 350, 1400, 10**6, "memory|Memory|allocat")),
    (1, one_processor),
    (2, second_run),
]


def faults() -> Iterator[str]:
    """Extend the faults by those that this machine permits; what it does not, with the reason."""
    with tempfile.TemporaryDirectory() as folder:
        mounted = subprocess.run(["mount", "-t", "tmpfs", "tmpfs", folder], capture_output=True, text=True)
        if mounted.returncode:
            yield f"full disk left out: mounting is not permitted ({mounted.stderr.strip()})"
        else:
            subprocess.run(["umount", folder], check=True)
            FAULTS.append((2, full_disk))
    if compiler():
        FAULTS.append((2, clock_step))
    else:
        yield "clock step left out: there is no C compiler"


def holds_messages(file: Path) -> bool:
    """Whether another reader finds a message in a file, or it is no recording at all."""
    with file.open("rb") as stream:
        begin = stream.read(len(MCAP0_MAGIC))
        stream.seek(0)
        with contextlib.suppress(Exception):
            return any(True for _ in NonSeekingReader(stream).iter_messages(log_time_order=False))
    return len(begin) == len(MCAP0_MAGIC) and begin != MCAP0_MAGIC


def unreadable(case: Case) -> list[str]:
    """Bags that can neither be read nor repaired; one without a message has nothing to read."""
    wrong = []
    for bag in sorted([*case.folder.glob("bag*"), *case.folder.glob("other*"), *case.folder.glob("small/bag*")]):
        if not bag.is_dir() or not list(bag.glob("*.mcap")):
            continue
        try:
            run = Run.open(bag)
            if any("truncated" in problem for problem in run.problems):
                repair_bag(bag, case.folder / f"repaired-{bag.name}")
                run = Run.open(case.folder / f"repaired-{bag.name}")
            if run["truth/los"].integrity.conflicts:
                wrong.append(f"{bag.name}: conflicts")
        except BagError as error:
            if any(holds_messages(file) for file in bag.glob("*.mcap")):
                wrong.append(f"{bag.name}: {error}")
        except Exception as error:
            wrong.append(f"{bag.name}: {type(error).__name__} {error}")
    return wrong


def wrong_end(case: Case, code: int, out: str) -> str:
    """What is wrong with the exit code or the message; empty for nothing."""
    if "Traceback" in out or "(a bug: please report it)" in out:
        return "traceback"
    refused = "in use by another run" in out or "without another run" in out
    if code == MISTAKE and refused and [other for other, _ in case.outputs] == [OK]:
        code, case.outputs = OK, [(code, out)]  # the second program was there first: it is the one that runs
        if "domain" in case.kind:
            case.bag = case.folder / "other"
    if code not in case.allowed:
        return f"exit code {code}"
    if not re.search(case.allowed[code], out):
        return f"exit code {code} without the words {case.allowed[code]!r}"
    ended = re.search(r"ended unexpectedly|no message", out)
    if code == OK and ended and "before the run began" not in out and "server for viewers" not in out:
        return "exit code 0 in spite of the fault that is told of"
    whole = [bag for bag in (case.bag, *case.folder.glob("bag*")) if bag.is_dir()]
    if code == OK and case.bag.parent == case.folder and (not whole or Run.open(case.bag).problems):
        return "exit code 0 without a whole bag"
    if code == OK and case.crashed and "before the run began" not in out and (lost := missing_commands(case.bag)):
        return f"exit code 0 though {lost} commands in a row are missing after the end of {case.crashed}"
    for other, text in case.outputs:
        over = other == OK and "domain" in case.kind  # the first one had not begun, or was over
        if not over and (other != MISTAKE or "must" not in text):
            return f"exit code {other} of the second run: {text}"
    return ""


def missing_commands(bag: Path) -> int:
    """The largest number of ticks in a row without a mirror command, if a node that was started again explains it."""
    run = Run.open(bag)
    first, last = run["truth/los"].stamp[[0, -1]]
    stamps = run["fsm/command"].stamp if "fsm/command" in run.topics else np.array([], np.int64)
    longest = int(np.diff(np.concatenate([[first], stamps, [last]])).max()) // TICK_NS
    return longest if longest > PAUSE_TICKS else 0


def orphans(case: Case) -> list[int]:
    """Processes that are left, ended here."""
    end = time.monotonic() + LEFT_S
    while (left := processes_with(f"{MARK}={case.folder}")) and time.monotonic() < end:
        time.sleep(0.1)
    for number in left:
        with contextlib.suppress(ProcessLookupError):
            os.kill(number, signal.SIGKILL)
    return left


def perform(seed: int, number: int, table: dict[str, Counter[str]]) -> bool:
    """One case; whether nothing was wrong."""
    rng = random.Random(f"{seed} {number}")
    make = rng.choices([fault for _, fault in FAULTS], [weight for weight, _ in FAULTS])[0]
    folder = Path(tempfile.mkdtemp(prefix="fault_"))
    case = make(rng, folder)
    domain = some_domain()
    try:
        process = start(case, domain, case.bag)
        out, hung = "", ""
        try:
            case.act(case, process)
            out = process.communicate(timeout=HANG_S)[0]
        except subprocess.TimeoutExpired:
            hung = f"it did not end within {HANG_S:g} s"
            process.kill()
            out = process.communicate()[0]
        code = process.returncode
        left, bags = orphans(case), unreadable(case)
        end = hung or wrong_end(case, code, out)
    finally:
        if (folder / "small").is_mount():
            subprocess.run(["umount", "-l", str(folder / "small")], check=True)
    if code == ExitCode.USER_ERROR and f"{TAKEN}, got {domain}" in " ".join(out.split()) and "domain" not in case.kind:
        sys.stdout.write(f"case {number}: another program took domain {domain} before the run did; again\n")
        shutil.rmtree(folder, ignore_errors=True)
        return perform(seed, number, table)
    row = table.setdefault(case.kind, Counter())
    survived = code in (OK, ExitCode.RESTARTED)
    row.update({"cases": 1, "survived": survived, "reported": not survived and not end})
    row.update({"orphans": len(left), "unreadable bags": len(bags), "wrong exit codes": bool(end)})
    sys.stdout.write(f"case {number}: {case.text}, {case.mode}: exit code {code}\n")
    found = [*bags, *([end] if end else []), *([f"processes left: {left}"] if left else [])]
    for line in found:
        sys.stdout.write(f"  WRONG: {line}\n  {' '.join(out.split())[-1500:]}\n")
        sys.stdout.write(f"  repeat: PYTHONPATH=tests python {__file__} 60 {seed} {number}\n")
    sys.stdout.flush()
    shutil.rmtree(folder, ignore_errors=True)
    return not found


def main(minutes: float, seed: int, cases: list[int]) -> int:
    """Cases until the time is over or a signal comes; the exit code."""
    came: list[int] = []
    for kind_of_end in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(kind_of_end, lambda number, _: came.append(number))
    for line in faults():
        sys.stdout.write(f"{line}\n")
    table: dict[str, Counter[str]] = {}
    end, good, number = time.monotonic() + 60 * minutes, True, 0
    while time.monotonic() < end and not came and (not cases or number < len(cases)):
        good &= perform(seed, cases[number] if cases else number, table)
        number += 1
    sys.stdout.write(f"\n{'fault':28}" + "".join(f"{name:>18}" for name in COLUMNS) + "\n")
    for kind, row in [*sorted(table.items()), ("all", sum(table.values(), Counter()))]:
        sys.stdout.write(f"{kind:28}" + "".join(f"{row[name]:18d}" for name in COLUMNS) + "\n")
    sys.stdout.write(f"seed {seed}, {number} cases: {'nothing found' if good else 'something was found'}\n")
    return 0 if good else 1


if __name__ == "__main__":
    chosen = int(sys.argv[2]) if len(sys.argv) > 2 else random.SystemRandom().randrange(10**6)
    sys.exit(main(float(sys.argv[1]), chosen, [int(text) for text in sys.argv[3:]]))
