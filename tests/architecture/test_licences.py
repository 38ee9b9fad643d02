"""The list of licences in CI: a package of which nothing says its licence is named."""

from __future__ import annotations

from importlib.metadata import PathDistribution
from pathlib import Path

import pytest
from support.scripts import script

licences = script(Path(__file__).parents[2] / ".ci" / "licences.py")


def package(folder: Path, name: str, *lines: str, licence: str = "") -> PathDistribution:
    info = folder / f"{name.replace('-', '_')}-1.0.dist-info"
    (info / "licenses").mkdir(parents=True)
    (info / "METADATA").write_text("\n".join(["Metadata-Version: 2.4", f"Name: {name}", "Version: 1.0", *lines, ""]))
    (info / "licenses" / "LICENSE.txt").write_text(licence)
    (info / "RECORD").write_text(f"{info.name}/licenses/LICENSE.txt,,\n")
    return PathDistribution(info)


def test_each_place_in_which_a_licence_is_stated_is_found(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "share" / "std_msgs").mkdir(parents=True)
    (tmp_path / "share" / "std_msgs" / "package.xml").write_text("<license>Apache License 2.0</license>")
    packages = [
        package(tmp_path, "one", "License-Expression: MIT"),
        package(tmp_path, "two", "Classifier: License :: OSI Approved :: BSD License"),
        package(tmp_path, "ros-jazzy-std-msgs"),
        package(tmp_path, "FMPy", licence="Redistribution and use in source and binary forms, with"),
    ]
    assert licences.main(packages, tmp_path / "share") == 0
    out = capsys.readouterr().out
    for words in ("MIT", "BSD License", "share/std_msgs/package.xml", "BSD-2-Clause", "4 packages, 2 without"):
        assert words in out


def test_a_package_without_a_licence_and_a_false_entry_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    packages = [
        package(tmp_path, "nothing"),
        package(tmp_path, "FMPy", licence="all rights reserved"),
        package(tmp_path, "cpylog", "License-Expression: MIT"),
    ]
    assert licences.main(packages, tmp_path) == 1
    err = capsys.readouterr().err
    assert "nothing 1.0: no licence in metadata or package.xml" in err
    assert "FMPy 1.0: licenses/LICENSE.txt has not the words stated" in err
    assert "cpylog 1.0: licences.toml has an entry that the metadata makes needless" in err
