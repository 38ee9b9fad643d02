"""What is given twice counts once: a recording as several runs, a column as both axes."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from los_testbed.cli.analysis.recordings import require_different
from support.command_line import refused


@pytest.fixture
def table(tmp_path: Path) -> Path:
    t = np.arange(2048) / 512.0
    rows = np.column_stack([t, *np.random.default_rng(0).standard_normal((2, t.size))])
    np.savetxt(tmp_path / "a.csv", rows, delimiter=",", header="time,x_mas,y_mas", comments="")
    return tmp_path / "a.csv"


def test_a_recording_or_its_copy_is_no_further_run(table: Path, capsys: pytest.CaptureFixture[str]) -> None:
    copy = table.with_name("b.csv")
    shutil.copy(table, copy)
    for second in (table, copy):
        assert "recordings must be distinct, got" in refused(capsys, "analyse", table, second)
    said = refused(capsys, "analyse", absent := table.with_name("absent"), table.with_name("other"))
    assert f"{absent}: no such file or folder" in said and "different ones" not in said


def test_compressed_bags_are_compared_by_their_content(tmp_path: Path) -> None:
    """Files as ``ros2 bag record --compression-mode file`` names them; the same one twice is refused."""
    bags = [tmp_path / name for name in "abc"]
    for bag, content in zip(bags, (b"first", b"other", b"first")):
        bag.mkdir()
        (bag / "bag_0.mcap.zstd").write_bytes(content)
    require_different(bags[:2])
    with pytest.raises(ValueError, match=r"c, which is the same as .*a$"):
        require_different(bags)
