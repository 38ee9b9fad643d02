"""The start of a run that the runner hands to its nodes: theirs if it is of their configuration, else computed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import yaml
from los_testbed.config.run_config import RunConfig
from los_testbed.parts import run_parts
from los_testbed.parts.run_parts import RunParts
from los_testbed.parts.start import START_VARIABLE, RunStart, for_nodes
from los_testbed.run.processes.node_launch import parameter_text


def as_node(config: RunConfig) -> RunConfig:
    """The configuration as a node reads it from its parameter file."""
    values = yaml.safe_load(parameter_text(config))["/**"]["ros__parameters"]
    return RunConfig.from_mapping({key: value for key, value in values.items() if key != "use_sim_time"})


@pytest.fixture(scope="module")
def computed() -> RunStart:
    return RunParts(RunConfig(duration=2.0)).start


@pytest.fixture
def handed(tmp_path: Path, computed: RunStart, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "start.json").write_bytes(for_nodes(RunParts(RunConfig(duration=2.0)).config.to_plain(), computed))
    monkeypatch.setenv(START_VARIABLE, str(tmp_path / "start.json"))


@pytest.mark.usefixtures("handed")
def test_a_node_takes_it_and_computes_nothing(computed: RunStart, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run_parts, "find_run_start", lambda *_: pytest.fail("computed again"))
    found = RunParts(as_node(RunConfig(duration=2.0, output="elsewhere"))).start
    assert found.to_bytes() == computed.to_bytes()
    assert found.states is not None and found.states.plant.any()


@pytest.mark.usefixtures("handed")
@pytest.mark.parametrize("other", [{"duration": 1.0}, {"loop": "fsm"}, {"fsm_authority": 1e-6}])
def test_that_of_another_configuration_is_not_taken(other: dict[str, object], computed: RunStart) -> None:
    config = replace(RunConfig(duration=2.0), **other)  # type: ignore[arg-type]
    assert RunParts(as_node(config)).start.to_bytes() != computed.to_bytes()


@pytest.mark.parametrize("content", [None, b"[]", b"\xff"])
def test_without_a_file_that_can_be_read_it_is_computed(
    content: bytes | None, tmp_path: Path, computed: RunStart, monkeypatch: pytest.MonkeyPatch
) -> None:
    if content is not None:
        (tmp_path / "start.json").write_bytes(content)
    monkeypatch.setenv(START_VARIABLE, str(tmp_path / "start.json"))
    assert RunParts(as_node(RunConfig(duration=2.0))).start.to_bytes() == computed.to_bytes()
