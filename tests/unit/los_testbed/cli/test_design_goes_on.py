"""``design k-fsm``: what an interrupt leaves, and what becomes of it."""

from __future__ import annotations

import json
import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from los_testbed.cli import app

from lftkit.support.job import Job
from los_design.synthesis import synthesis
from los_design.synthesis.options import DesignOptions
from los_design.synthesis.round_state import RoundState
from los_design.synthesis.store import load_designs


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Stand-in for the tuning: keeps its state, then does what stands first in the list: a status, or an error."""
    ends: list[Any] = []

    def design(telescope: Any, options: DesignOptions, report: Any, job: Job) -> Any:
        state = RoundState.load(job) or RoundState(np.zeros(2))
        RoundState(state.x, state.number + 1).save(job)
        end = ends.pop(0)
        if isinstance(end, type):
            raise end
        system = load_designs("implemented")[0]
        return replace(system, provenance={**system.provenance, "status": end, "rounds": state.number + 1})

    monkeypatch.setattr(synthesis, "design_observer", design)
    return ends


def test_the_same_command_goes_on_until_it_is_done(
    tmp_path: Path, asked: list[Any], capsys: pytest.CaptureFixture[str]
) -> None:
    file, rounds = tmp_path / "mine.json", tmp_path / "mine.rounds.json"
    command = ["design", "k-fsm", "--output", str(file)]
    asked += [KeyboardInterrupt, "out_of_time", "converged", "converged"]
    with pytest.raises(SystemExit) as ended:
        app.main(command)
    assert ended.value.code == 130
    assert f"rounds so far are stored; resume with: los-testbed design k-fsm --output {shlex.quote(str(file))}" in (
        capsys.readouterr().err
    )
    assert rounds.exists() and not file.exists()
    app.main(command)
    assert rounds.exists() and json.loads(file.read_text())["provenance"]["rounds"] == 2
    app.main([*command, "--seed", "5"])
    assert not rounds.exists() and json.loads(file.read_text())["provenance"]["rounds"] == 1, "another design"
    app.main(command)
    assert json.loads(file.read_text())["provenance"]["rounds"] == 1
