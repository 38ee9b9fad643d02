"""Run a command in a fresh clone of HEAD as on another ordinary machine.

    python tests/elsewhere.py young nohup spaces                  # make run, started so
    python tests/elsewhere.py user blas -- make test-anywhere     # another command
    python tests/elsewhere.py --help                              # the kinds

Kinds can be combined. The environment is that of a login: of this shell's variables only the settings of package
installers and proxies stay. The clone and its folder vanish at the end (`keep` leaves them). The exit code is that of
the command. `.ci/run` uses it.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import pwd
import re
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
KEPT = re.compile(r"(PIP|UV|SSL|REQUESTS_CA|OPENBLAS)_.*|(https?|no|all)_proxy", re.IGNORECASE)
COMPILERS = re.compile(r"(.*-)?(gcc|g\+\+|cc|c\+\+|c[89]9|clang|ld|cmake|ctest|chromium|google-chrome)(\W.*|\d.*)?")
DAY = 86_400


@dataclass
class Machine:
    """What a command is started with.

    Attributes
    ----------
    folder : temporary folder of this machine
    place : where the clone is to be
    variables : environment of the command
    prefix : what starts the command, for instance ``taskset``
    before : called in the new process
    """

    folder: Path
    place: Path
    variables: dict[str, str]
    prefix: list[str] = field(default_factory=list)
    before: list[Callable[[], object]] = field(default_factory=list)
    pipe: bool = False
    busy: int = 0
    keep: bool = False
    user: str = ""


def booted(machine: Machine, seconds: int) -> None:
    with open("/proc/uptime") as uptime, open("/proc/self/timens_offsets") as offsets:
        own = {line.split()[0]: int(line.split()[1]) for line in offsets}  # not zero on a machine that was made so
        shift = own["boottime"] + seconds - int(float(uptime.read().split()[0]))
    machine.prefix[:0] = ["unshare", "--time", f"--monotonic={shift}", f"--boottime={shift}", "--fork"]


def young(machine: Machine) -> None:
    """booted a minute ago (needs root)"""
    booted(machine, 60)


def old(machine: Machine) -> None:
    """booted 400 days ago (needs root)"""
    booted(machine, 400 * DAY)


def nohup(machine: Machine) -> None:
    """SIGHUP is ignored"""
    machine.before.append(lambda: signal.signal(signal.SIGHUP, signal.SIG_IGN))


def noterm(machine: Machine) -> None:
    """SIGTERM is ignored"""
    machine.before.append(lambda: signal.signal(signal.SIGTERM, signal.SIG_IGN))


def nostdin(machine: Machine) -> None:
    """standard input is closed"""
    machine.before.append(lambda: os.close(0))


def pipe(machine: Machine) -> None:
    """the output is a pipe"""
    machine.pipe = True


def c(machine: Machine) -> None:
    """LANG=C, LC_ALL=C"""
    machine.variables |= {"LANG": "C", "LC_ALL": "C"}


def chatham(machine: Machine) -> None:
    """TZ=Pacific/Chatham, 12 h 45 min from UTC"""
    machine.variables["TZ"] = "Pacific/Chatham"


def narrow(machine: Machine) -> None:
    """40 columns"""
    machine.variables["COLUMNS"] = "40"


def spaces(machine: Machine) -> None:
    """clone and TMPDIR in folders with spaces and an umlaut"""
    machine.place = machine.folder / "Jürgen's work" / "los testbed"
    temporary = machine.folder / "for a while, Jürgen"
    temporary.mkdir()
    machine.variables["TMPDIR"] = str(temporary)


def umask(machine: Machine) -> None:
    """new files are for their owner alone"""
    machine.before.append(lambda: os.umask(0o077))


def user(machine: Machine) -> None:
    """an ordinary user without rights for real-time priority; HOME cannot be written (needs root)"""
    machine.user = "nobody"
    home = machine.folder / "home"
    home.mkdir(mode=0o555)
    machine.variables |= {"HOME": str(home), "USER": machine.user}
    rights = ["--clear-groups", "--inh-caps=-all", "--bounding-set=-sys_nice,-ipc_lock"]
    folders = [name for name in machine.variables["PATH"].split(":") if _reaches(machine.user, name)]
    machine.variables["PATH"] = ":".join(folders)
    machine.prefix += ["setpriv", f"--reuid={machine.user}", *rights]


def _reaches(name: str, folder: str) -> bool:
    test = ["setpriv", f"--reuid={name}", "--clear-groups", "test", "-x", folder]
    return subprocess.run(test, stderr=subprocess.DEVNULL).returncode == 0


def nocc(machine: Machine) -> None:
    """no C compiler, linker, cmake or chromium"""
    programs = machine.folder / "programs"
    programs.mkdir()
    for folder in machine.variables["PATH"].split(":"):
        for path in sorted(Path(folder).glob("*")):
            if not COMPILERS.fullmatch(path.name) and not (programs / path.name).is_symlink():
                (programs / path.name).symlink_to(path)
    machine.variables["PATH"] = str(programs)


def blas(machine: Machine) -> None:
    """another kernel of OpenBLAS"""
    machine.variables["OPENBLAS_CORETYPE"] = "Prescott"


def one(machine: Machine) -> None:
    """one processor"""
    machine.prefix += ["taskset", "--cpu-list", str(min(os.sched_getaffinity(0)))]


def busy(machine: Machine) -> None:
    """two busy processes beside the command"""
    machine.busy = 2


def keep(machine: Machine) -> None:
    """leave the clone behind"""
    machine.keep = True


KINDS = {
    kind.__name__: kind
    for kind in (
        young, old, nohup, noterm, nostdin, pipe, c, chatham, narrow, spaces, umask, nocc, user, blas, one, busy, keep
    )
}  # fmt: skip
"""In the order in which they are applied: a user's PATH is made of the folders that are left."""


def login(folder: Path) -> Machine:
    """A machine as it is, with the environment of a login."""
    names = ("PATH", "HOME", "USER", "LANG", "TERM", "CI")
    variables = {name: value for name, value in os.environ.items() if name in names or KEPT.fullmatch(name)}
    return Machine(folder, folder / "clone", {"LANG": "C.UTF-8", **variables})


@contextlib.contextmanager
def busy_processes(count: int) -> Iterator[None]:
    """So many processes that do nothing, as fast as they can."""
    started = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield
    finally:
        for process in started:
            process.kill()
            process.wait()


def run(machine: Machine, command: list[str]) -> int:
    """Clone, start the command on this machine, wait for it; its exit code."""
    machine.place.parent.mkdir(exist_ok=True)
    subprocess.run(["git", "clone", "--quiet", str(ROOT), str(machine.place)], check=True)
    if machine.user:
        machine.folder.chmod(0o755)
        owner = pwd.getpwnam(machine.user)
        for path in (machine.folder, *machine.folder.rglob("*")):
            os.chown(path, owner.pw_uid, owner.pw_gid, follow_symlinks=False)
    with busy_processes(machine.busy):
        process = subprocess.Popen(
            [*machine.prefix, *command],
            cwd=machine.place,
            env=machine.variables,
            stdin=None if sys.stdin else subprocess.DEVNULL,
            stdout=subprocess.PIPE if machine.pipe else None,
            stderr=subprocess.STDOUT if machine.pipe else None,
            preexec_fn=lambda: [action() for action in machine.before] and None,
        )
        if process.stdout:
            shutil.copyfileobj(process.stdout, sys.stdout.buffer)
            sys.stdout.flush()
        return process.wait()


def main() -> int:
    kinds = "\n".join(f"  {name:8} {kind.__doc__}" for name, kind in KINDS.items())
    parser = argparse.ArgumentParser(
        description=f"{__doc__}\nkinds:\n{kinds}", formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("kinds", nargs="+", choices=KINDS, metavar="KIND")
    given = sys.argv[1:]
    cut = given.index("--") if "--" in given else len(given)
    arguments, command = parser.parse_args(given[:cut]), given[cut + 1 :] or ["make", "run"]
    folder = Path(tempfile.mkdtemp(prefix="elsewhere-"))
    machine = login(folder)
    named = " ".join(kind for kind in KINDS if kind in arguments.kinds)
    try:
        for kind in named.split():
            KINDS[kind](machine)
        print(f"elsewhere: {named}: {' '.join(command)}", flush=True)
        code = run(machine, command)
    finally:
        if machine.keep:
            print(f"elsewhere: left in {machine.place}")
        else:
            shutil.rmtree(folder, ignore_errors=True)
    print(f"elsewhere: {named}: exit code {code}", flush=True)
    return code if code >= 0 else 128 - code


if __name__ == "__main__":
    sys.exit(main())
