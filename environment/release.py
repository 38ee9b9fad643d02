"""Wheels and sdists of the distributions in dist/, tried in an empty environment; then the tag of the version.

    make release            # or: python environment/release.py [--no-tag]

Nothing is tagged unless the tree is clean, the changelog has the version, and the wheels run.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tarfile
import tempfile
from io import BytesIO
from pathlib import Path

ROOT = Path(__file__).parents[1]
DIST = ROOT / "dist"
VERSIONS = {
    "los-testbed": "ros_ws/src/los_testbed/los_testbed/__init__.py",
    "lftkit": "lftkit/__init__.py",
    "pointing-analysis": "pointing_analysis/__init__.py",
}


def output_of(*command: str, folder: Path = ROOT) -> bytes:
    """Output of a command; the program ends where it fails."""
    done = subprocess.run(command, cwd=folder, stdout=subprocess.PIPE)
    if done.returncode:
        sys.exit(f"release: {' '.join(command)} must succeed, got exit code {done.returncode}")
    return done.stdout


def version_of(name: str) -> str:
    """Version of a distribution, as its package states it."""
    found = re.search(r'^__version__ = "(.+)"$', (ROOT / VERSIONS[name]).read_text("utf-8"), re.MULTILINE)
    assert found is not None, VERSIONS[name]
    return found[1]


def check(tag: str) -> None:
    """Refuse a tree from which no release is made."""
    if changed := output_of("git", "status", "--porcelain").decode().strip():
        sys.exit(f"release: the tree must have no changes, got\n{changed}")
    if f"## [{version_of('los-testbed')}]" not in (ROOT / "CHANGELOG.md").read_text("utf-8"):
        sys.exit(f"release: CHANGELOG.md must have a section {version_of('los-testbed')}, got none")
    if output_of("git", "tag", "--list", tag):
        sys.exit(f"release: tag {tag} must be new, got one that exists")


def built(folder: Path) -> list[Path]:
    """Sdists and wheels of the last commit, in dist/."""
    with tarfile.open(fileobj=BytesIO(output_of("git", "archive", "HEAD"))) as archive:
        archive.extractall(folder / "source")
    for source in (folder / "source" / "lftkit", folder / "source" / "pointing_analysis", folder / "source"):
        output_of(sys.executable, "-m", "uv", "build", "--quiet", "--out-dir", str(DIST), str(source))
    return [DIST / f"{name.replace('-', '_')}-{version_of(name)}-py3-none-any.whl" for name in VERSIONS]


def tried(folder: Path, wheels: list[Path]) -> None:
    """A run in an environment with the wheels and what they need, outside of the tree."""
    python = str(folder / "env" / "bin" / "python")
    output_of(sys.executable, "-m", "venv", str(folder / "env"))
    output_of(sys.executable, "-m", "uv", "pip", "install", "--quiet", "--python", python, *map(str, wheels))
    program = str(folder / "env" / "bin" / "los-testbed")
    print(output_of(program, "--version", folder=folder).decode().strip())
    run = ("run", "--mode", "inprocess", "--duration", "2", "--no-report", "--output", "bag")
    output_of(program, *run, folder=folder)
    output_of(python, "-c", "import lftkit; print(lftkit.__version__)", folder=folder)
    output_of(str(folder / "env" / "bin" / "pointing-analysis"), "analyse", "bag", "--output", "r.html", folder=folder)


def main() -> None:
    """Check, build, try, tag."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--no-tag", action="store_true", help="build and try alone")
    options = parser.parse_args()
    tag = f"v{version_of('los-testbed')}"
    check(tag)
    with tempfile.TemporaryDirectory() as name:
        wheels = built(Path(name))
        tried(Path(name), wheels)
    for file in sorted(f for f in DIST.iterdir() if f.suffix in (".whl", ".gz")):
        print(file.relative_to(ROOT))
    if not options.no_tag:
        output_of("git", "tag", "--annotate", tag, "--message", f"los-testbed {tag[1:]}")
        print(f"tagged {tag}")


if __name__ == "__main__":
    main()
