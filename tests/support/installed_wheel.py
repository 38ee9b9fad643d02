"""Wheels and sdists of the distributions, and environments with them and chosen dependencies, without the network."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tarfile
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from support.packages import LIBRARIES, ROOT

NAMES = {"lftkit", "pointing-analysis", "los-testbed"}
LFTKIT = ("lftkit",)
ANALYSIS = ("pointing_analysis",)
"""What the distributions lftkit and pointing-analysis are made from."""
PARTS = (
    *(name for name in LIBRARIES if name not in (*LFTKIT, *ANALYSIS)),
    "ros_ws",
    "pyproject.toml",
    "MANIFEST.in",
    "README.md",
    "LICENSE",
    "CITATION.cff",
    "CHANGELOG.md",
)
"""What the distribution los-testbed is made from."""
IGNORED = shutil.ignore_patterns("__pycache__", "*.egg-info", "build", "install", "log", ".*")


def build(kind: str, source: Path, target: Path) -> Path:
    """Build ``wheel`` or ``sdist`` of a source tree with the installed setuptools."""
    code = f"from setuptools import build_meta; print(build_meta.build_{kind}({str(target)!r}))"
    done = subprocess.run([sys.executable, "-c", code], cwd=source, capture_output=True, text=True, timeout=240)
    assert done.returncode == 0, done.stderr
    return target / done.stdout.splitlines()[-1]


def sdist_and_wheel(folder: Path, parts: tuple[str, ...] = PARTS) -> tuple[Path, Path]:
    """Sdist of a copy of parts of the repository, and the wheel that is built from the unpacked sdist."""
    copy = folder / "copy"
    copy.mkdir()
    for part in parts:
        if (ROOT / part).is_dir():
            shutil.copytree(ROOT / part, copy / part, ignore=IGNORED)
        else:
            shutil.copy(ROOT / part, copy / part)
    sdist = build("sdist", copy if (copy / "pyproject.toml").exists() else copy / parts[0], folder)
    with tarfile.open(sdist) as archive:
        archive.extractall(folder / "unpacked")
    (unpacked,) = (folder / "unpacked").iterdir()
    return sdist, build("wheel", unpacked, folder)


def _key(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def closure(requirements: list[str]) -> set[str]:
    """Names of the installed distributions that the requirements need, extras and markers respected."""
    from packaging.requirements import Requirement

    found: set[tuple[str, str]] = set()
    names: set[str] = set()
    waiting = [(Requirement(text), "") for text in requirements]
    while waiting:
        requirement, extra = waiting.pop()
        if requirement.marker is not None and not requirement.marker.evaluate({"extra": extra}):
            continue
        try:
            installed = distribution(requirement.name)
        except PackageNotFoundError:
            continue
        names.add(_key(requirement.name))
        for wanted in ("", *requirement.extras):
            if (_key(requirement.name), wanted) not in found:
                found.add((_key(requirement.name), wanted))
                waiting += [(Requirement(text), wanted) for text in installed.requires or ()]
    return names - NAMES


def environment(folder: Path, wheels: list[Path], requirements: list[str]) -> Path:
    """Virtual environment with the wheels and what the requirements need; returns its folder of programs."""
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(folder)], check=True, timeout=600)
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    site = folder / "lib" / version / "site-packages"
    for name in closure(requirements):
        files = distribution(name).files or []
        for top in {file.parts[0] for file in files} - {"..", "__pycache__"}:
            original = Path(str(distribution(name).locate_file(top)))
            if original.exists() and not (site / top).exists():
                (site / top).symlink_to(original)
    install = [sys.executable, "-m", "pip", "--python", str(folder / "bin/python"), "install", "--quiet"]
    options = ["--no-deps", "--no-index", "--disable-pip-version-check", *map(str, wheels)]
    subprocess.run([*install, *options], check=True, timeout=600)
    return folder / "bin"


def run(
    program: Path, *arguments: str, folder: Path, variables: dict[str, str] | None = None, timeout: float = 240.0
) -> subprocess.CompletedProcess[str]:
    """Run an installed program in a folder outside the tree, with no path of ours in the environment."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "PYTEST_"))}
    return subprocess.run(
        [str(program), *arguments],
        cwd=folder,
        env={**kept, **(variables or {})},
        capture_output=True,
        text=True,
        timeout=timeout,
    )
