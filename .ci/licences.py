"""List the licence of every installed package, and where it is stated: ``python .ci/licences.py``.

It is taken from the metadata of the package, else from the ``package.xml`` that packages of ROS 2 install, else from
the file that ``licences.toml`` names. Exit code 1: a package of which none of them says it, or an entry of
``licences.toml`` whose words are not in its file, or which its package needs no more.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib.metadata import Distribution, distributions
from pathlib import Path

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

STATED = Path(__file__).with_name("licences.toml")
LONGEST = 60
"""Characters of a licence in the list; some packages have its whole text in their metadata."""


@dataclass(frozen=True)
class Licence:
    """Licence of a package.

    Attributes
    ----------
    package, version : str
    name : as it is stated; empty where nothing says it
    where : what says it
    fault : what is wrong with the entry in the data file; empty for nothing
    """

    package: str
    version: str
    name: str
    where: str
    fault: str = ""


def normal(name: str) -> str:
    """Name of a package by which it is looked for."""
    return re.sub(r"[-_.]+", "-", name).lower()


def of_metadata(package: Distribution) -> str:
    """Licence in the metadata; empty where it says none."""
    metadata = package.metadata
    known = [metadata.get(key) or "" for key in ("License-Expression", "License")]
    classes = [text.rpartition("::")[2] for text in metadata.get_all("Classifier") or [] if text.startswith("License")]
    return next((text.strip() for text in (known[0], ", ".join(classes), known[1]) if text.strip()), "")


def of_ros(package: Distribution, share: Path) -> tuple[str, Path]:
    """Licences in the ``package.xml`` of a package of ROS 2, and that file; empty where there is none."""
    name = normal(package.metadata["Name"]).replace("-", "_")
    for folder in (name, re.sub("^ros_(jazzy_)?", "", name)):
        file = share / folder / "package.xml"
        if file.is_file():
            return ", ".join(re.findall(r"<license[^>]*>\s*([^<]*?)\s*</license>", file.read_text("utf-8"))), file
    return "", Path()


def licence_of(package: Distribution, stated: Mapping[str, Mapping[str, str]], share: Path) -> Licence:
    """Licence of a package, with what says it."""
    name, version = package.metadata["Name"], package.version
    entry = stated.get(normal(name))
    if found := of_metadata(package):
        fault = f"{STATED.name} has an entry that the metadata makes needless" if entry else ""
        return Licence(name, version, found.splitlines()[0][:LONGEST], "metadata", fault)
    found, file = of_ros(package, share)
    if found:
        fault = f"{STATED.name} has an entry that package.xml makes needless" if entry else ""
        return Licence(name, version, found, f"share/{file.parent.name}/package.xml", fault)
    if entry is None:
        return Licence(name, version, "", "", f"no licence in metadata or package.xml: name it in {STATED.name}")
    files = [file for file in package.files or () if str(file).endswith(entry["file"])]
    if not any(entry["words"] in Path(str(file.locate())).read_text("utf-8", "replace") for file in files):
        return Licence(name, version, entry["licence"], entry["file"], f"{entry['file']} has not the words stated")
    return Licence(name, version, entry["licence"], str(files[0]))


def main(packages: Iterable[Distribution] | None = None, share: Path | None = None) -> int:
    """Print the list; the exit code."""
    stated = tomllib.loads(STATED.read_text("utf-8"))
    folder = Path(sys.prefix) / "share" if share is None else share
    found = {normal(one.metadata["Name"]): one for one in (distributions() if packages is None else packages)}
    rows = [licence_of(found[name], stated, folder) for name in sorted(found)]
    for row in rows:
        sys.stdout.write(f"{row.package:42} {row.version:14} {row.name:{LONGEST}} {row.where}\n")
    for row in (faulty := [row for row in rows if row.fault]):
        sys.stderr.write(f"licences: {row.package} {row.version}: {row.fault}\n")
    without = sum(row.where != "metadata" for row in rows)
    sys.stdout.write(f"{len(rows)} packages, {without} without a licence in their metadata\n")
    return 1 if faulty else 0


if __name__ == "__main__":
    sys.exit(main())
