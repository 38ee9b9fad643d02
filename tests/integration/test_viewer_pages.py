"""Pages on bags and viewers: their code runs, and their example output is correct."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_python_code_prints_the_documented_output(monkeypatch, capsys) -> None:
    monkeypatch.chdir(ROOT)
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "your_data.md").read_text("utf-8"), re.S)
    (code,) = [block for block in blocks if "Run.open" in block]
    exec(code, {})
    shape = re.findall(r"# (.*)$", code, re.M)[0]
    out = capsys.readouterr().out.splitlines()
    assert out[0] == shape
    assert out[1] == "1 ['k_fsm.json', 'k_pma.json', 'run.yaml', 'start.json']"
