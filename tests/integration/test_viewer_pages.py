"""Pages on bags and viewers: their code runs, the options of their commands exist, their example output is correct."""

import re
import shlex
from pathlib import Path

import pytest
import typer
from los_testbed.cli.app import app

ROOT = Path(__file__).parents[2]
PAGES = ("your_data.md", "reference.md", "pointing_analysis.md")


@pytest.mark.parametrize("name", PAGES)
def test_commands_and_options_exist(name) -> None:
    text = (ROOT / "docs" / name).read_text("utf-8")
    commands = typer.main.get_command(app).commands
    found = re.findall(r"^ {4}(los-testbed .*)$", text, re.M) + re.findall(r"`(los-testbed [^`]*)`", text)
    assert found
    for line in found:
        words = shlex.split(re.sub(r"[\[\]|]", " ", line.split("#")[0]))
        names = [w for w in words[1:] if w in commands]
        assert names, line
        known = {option for parameter in commands[names[0]].params for option in parameter.opts}
        assert {w for w in words if w.startswith("--")} <= known, line


def test_python_code_prints_the_documented_output(monkeypatch, capsys) -> None:
    monkeypatch.chdir(ROOT)
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "your_data.md").read_text("utf-8"), re.S)
    (code,) = [block for block in blocks if "Run.open" in block]
    exec(code, {})
    shape = re.findall(r"# (.*)$", code, re.M)[0]
    out = capsys.readouterr().out.splitlines()
    assert out[0] == shape
    assert out[1] == "1 ['k_fsm.json', 'k_pma.json', 'run.yaml', 'start.json']"
