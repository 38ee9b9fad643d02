"""Fill `.venv` from a lock file: with uv where it can be had, else with pip. `make` calls this; it needs no package.

    .venv/bin/python environment/install.py run         # what `make run` needs, and the packages of this folder
    .venv/bin/python environment/install.py everything  # the packages of tests, documentation and all extras

Every package is a wheel whose hash the lock names. uv is told where pip looks: it does not read pip's configuration.
"""

from __future__ import annotations

import ast
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
LINE_EVERY = 5.0
"""Seconds from one line of progress to the next."""
LOCKED = ["--no-deps", "--require-hashes", "--only-binary", ":all:"]
PACKAGES = ["--no-deps", "--no-build-isolation", "-e", "./lftkit", "-e", "./pointing_analysis", "-e", "."]
LOCKS = "run", "everything"
COMPILE = "from los_testbed.run.loop.compiled_loop import prepare; prepare()"


class StepFailed(Exception):
    """A command that failed; the text is the end of what it printed."""


def said(line: str) -> None:
    print(f"environment: {line}", flush=True)


def step(what: str, command: list[str], variables: dict[str, str] | None = None) -> None:
    """Run a command; its output is shown if it fails, and a line every few seconds says how far it is."""
    began = time.monotonic()
    said(what)
    with tempfile.TemporaryFile("w+", errors="replace") as output:
        process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            env={**os.environ, **(variables or {})},
        )
        while True:
            try:
                status = process.wait(LINE_EVERY)
                break
            except subprocess.TimeoutExpired:
                said(f"  {time.monotonic() - began:.0f} s{_fetched(output.fileno())}")
            except BaseException:
                process.kill()
                raise
        if status:
            output.seek(0)
            lines = [line.rstrip() for line in output if line.strip() and not line.startswith("WARNING: Location")]
            raise StepFailed("\n".join(lines[-15:]) or f"exit status {status}")


def _fetched(file: int) -> str:
    """How many packages pip or uv says that it fetched; nothing for other programs."""
    lines = os.pread(file, 1 << 20, 0).decode(errors="replace").splitlines()
    count = sum(line.startswith(("Collecting ", " Downloaded ")) for line in lines)
    return f", {count} packages fetched" if count else ""


def pip_settings(listed: str) -> dict[str, str]:
    """Settings of pip by name, from what `pip config list` prints: of the environment before `install` and `global`."""
    found: dict[str, tuple[int, str]] = {}
    for line in listed.splitlines():
        key, _, value = line.partition("=")
        section, _, name = key.rpartition(".")
        rank = {"global": 1, "install": 2, ":env:": 3}.get(section, 0)
        if rank and rank >= found.get(name, (0, ""))[0]:
            found[name] = (rank, str(ast.literal_eval(value)))
    return {name: value for name, (_, value) in found.items()}


def uv_variables(pip: dict[str, str], given: dict[str, str]) -> dict[str, str]:
    """Variables that make uv look where pip looks; what the user set for uv stays.

    Parameters
    ----------
    pip
        Settings of pip by name.
    given
        The environment of this process.
    """
    several = {name: pip.get(name, "").split() for name in ("extra-index-url", "find-links", "trusted-host")}
    values = {
        "UV_DEFAULT_INDEX": pip.get("index-url", ""),
        "UV_INDEX": " ".join(several["extra-index-url"]),
        "UV_FIND_LINKS": ",".join(several["find-links"]),
        "UV_INSECURE_HOST": " ".join(several["trusted-host"]),
        "UV_NO_INDEX": "1" if pip.get("no-index", "") in ("1", "true", "yes", "on") else "",
        "UV_INDEX_STRATEGY": "unsafe-best-match",  # as pip; the hashes say which file it is
        "UV_HTTP_TIMEOUT": "20",
        "UV_NO_PROGRESS": "1",
        "SSL_CERT_FILE": pip.get("cert", ""),
        "HTTPS_PROXY": pip.get("proxy", ""),
    }
    return {name: value for name, value in values.items() if value and name not in given}


def uv_program() -> tuple[list[str], dict[str, str]]:
    """Command of uv, fetched with pip where it is not in this environment, and its variables."""
    pip = [sys.executable, "-m", "pip"]
    uv = str(Path(sys.executable).parent / "uv")
    locked = [*pip, "install", *LOCKED, "-r", str(HERE / "uv.lock")]
    step("uv, which installs the packages", locked)
    listed = subprocess.run([*pip, "config", "list"], stdin=subprocess.DEVNULL, capture_output=True, text=True).stdout
    variables = uv_variables(pip_settings(listed), dict(os.environ))
    folder = subprocess.run([uv, "cache", "dir"], capture_output=True, text=True, env={**os.environ, **variables})
    cache = Path(folder.stdout.strip() or os.devnull)
    try:
        cache.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=cache).close()
    except OSError:
        variables["UV_NO_CACHE"] = "1"
    return [uv, "pip", "install", "--python", sys.executable], variables


def install(name: str) -> None:
    """Packages of a lock, then those of this folder."""
    pip = [sys.executable, "-m", "pip", "install", "--disable-pip-version-check", "--progress-bar", "off"]
    work = [(f"the packages of environment/{name}.lock", [*LOCKED, "-r", str(HERE / f"{name}.lock")])]
    if name == "run":
        work.append(("lftkit and los-testbed of this folder, editable", PACKAGES))
    try:
        program, variables = uv_program()
        for what, options in work:
            step(what, [*program, *options], variables)
    except (StepFailed, OSError) as error:
        said(f"uv did not: {str(error).splitlines()[-1]}; pip does it instead, which takes some minutes")
        for what, options in work:
            step(f"{what}, with pip", [*pip, *options])


def main() -> int:
    name = sys.argv[1] if len(sys.argv) == 2 else ""
    if name not in LOCKS:
        print(f"argument must be one of {', '.join(LOCKS)}, got {' '.join(sys.argv[1:])!r}", file=sys.stderr)
        return 2
    began = time.monotonic()
    os.chdir(HERE.parent)
    try:
        install(name)
        if name == "run":
            step("the compiled code of the loop", [sys.executable, "-c", COMPILE])
    except StepFailed as error:
        print(f"environment: failed:\n{error}", file=sys.stderr)
        return 1
    said(f"ready after {time.monotonic() - began:.0f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
