"""``design verify --output``: what an interrupt leaves, and what the same command makes of it."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

import pytest
from los_testbed.cli import app

from los_design.verification import stage_check

FOLDER = Path(__file__).parents[4] / "examples" / "spacecraft" / "small_telescope"


def test_an_interrupted_verification_goes_on_and_gives_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    file, parts = tmp_path / "check.json", tmp_path / "check.json.parts"
    command = ["design", "verify", "--designs", str(FOLDER), "--samples", "0", "--workers", "1", "--output", str(file)]
    computed = {"_swept": 0, "_looked_closely": 0}

    def counted(name: str, last: int) -> None:
        """Count the calls of a part of the work; the one after the last is an interrupt."""
        make = getattr(stage_check, name)

        def part(*arguments: Any) -> Any:
            if computed[name] == last:
                raise KeyboardInterrupt
            computed[name] += 1
            return make(*arguments)

        monkeypatch.setattr(stage_check, name, part)

    with monkeypatch.context():
        counted("_swept", 5)
        with pytest.raises(SystemExit) as ended:
            app.main(command)
    assert ended.value.code == 130 and parts.exists() and not file.exists()
    assert f"finished parts are stored; resume with: los-testbed {shlex.join(map(str, command))}" in (
        capsys.readouterr().err
    )
    monkeypatch.undo()
    counted("_swept", -1)
    counted("_looked_closely", 2)
    computed["_swept"] = 0
    with pytest.raises(SystemExit) as ended:
        app.main(command)
    assert ended.value.code == 130 and computed["_swept"] == stage_check.BLOCKS - 5
    assert f"5 parts are read from {parts}" in capsys.readouterr().err
    monkeypatch.undo()
    app.main(command)
    assert f"{stage_check.BLOCKS + 2} parts are read from {parts}" in capsys.readouterr().err
    assert not parts.exists()
    whole = tmp_path / "whole.json"
    app.main([*command[:-1], str(whole)])
    assert whole.read_bytes() == file.read_bytes()
