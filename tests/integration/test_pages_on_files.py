"""Commands on the pages about files of others run as they are printed, with the files that the pages make."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
from los_testbed.cli.app import main

import los_estimator

pytestmark = pytest.mark.usefixtures("without_pictures")

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"


def blocks(page: str, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", (DOCS / page).read_text("utf-8"), flags=re.DOTALL | re.MULTILINE)


@pytest.mark.parametrize("page", ["your_data.md", pytest.param("your_disturbances.md", marks=pytest.mark.further)])
def test_the_commands_of_a_page_run(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bags").symlink_to(ROOT / "bags")
    for block in blocks(page, "python"):
        exec(block, {})
    observer = Path(los_estimator.__file__).parent / "designs" / "k_fsm.json"
    Path("my_laws.py").write_text(
        "from lftkit.systems.sampled.sampled_system import SampledSystem\n"
        f"observer = SampledSystem.from_file({str(observer)!r}).to_control()\n"
    )
    for block in blocks(page, "toml"):
        (tmp_path / "my_sources.toml").write_text(block)
    commands = [line for block in blocks(page, "sh") for line in block.splitlines()]
    assert len(commands) >= 3
    for line in commands:
        words = shlex.split(line, comments=True)
        assert words.pop(0) == "los-testbed"
        more = ["--no-report"] if words[0] == "run" else []
        assert main([*words, *more]) == 0, line
        shown = "".join(capsys.readouterr())
        if words[0] == "run":
            assert ("Sources, each alone" in shown) == ("--disturbance" in words)
        else:
            assert "512 Hz from the times" in shown
