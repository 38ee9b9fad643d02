"""A file of a kind that is not read: one line that names what came, exit code 2, nothing written."""

from __future__ import annotations

import gzip
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest
from los_testbed.cli import app

from lftkit.support.file_kind import kind_of_file


def _zip(*names: str) -> Callable[[Path], None]:
    def write(path: Path) -> None:
        with zipfile.ZipFile(path, "w") as archive:
            for name in names:
                archive.writestr(name, "1,2\n")

    return write


KINDS: dict[str, tuple[Callable[[Path], object], str]] = {
    "page.html": (lambda path: path.write_text("<!DOCTYPE html>\n<html><body>1,2</body></html>\n"), "an HTML page"),
    "page.csv": (lambda path: path.write_text("<html>\n<p>1,2</p></html>\n"), "an HTML page"),
    "paper.pdf": (lambda path: path.write_bytes(b"%PDF-1.4\n%\xe2\xe3\n1 0 obj\n"), "a PDF document"),
    "data.zip": (_zip("x.csv"), "a zip archive (unpack it first)"),
    "image.png": (lambda path: path.write_bytes(b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR"), "a PNG picture"),
    "data.json": (lambda path: path.write_text('{"a": [1, 2, 3]}'), "JSON"),
    "sheet.xlsx": (_zip("[Content_Types].xml", "xl/workbook.xml"), "an Excel workbook (save the sheet as CSV)"),
    "empty.csv": (lambda path: path.write_bytes(b""), "an empty file"),
    "folder": (lambda path: path.mkdir(), "a folder"),
    "data.csv.gz": (lambda path: path.write_bytes(gzip.compress(b"t,x,y\n0,1,2\n")), "a gzip file (unpack it first)"),
}
COMMANDS = {
    "analyse": ["analyse", "FILE"],
    "disturbance": ["run", "--mode", "inprocess", "--output", "out", "--disturbance", "FILE"],
    "k_fsm": ["run", "--mode", "inprocess", "--output", "out", "--k-fsm", "FILE"],
    "requirements": ["analyse", str(Path("bags/reference").resolve()), "--requirements", "FILE"],
    "members": ["campaign", "--output", "out", "--sampling", "FILE"],
    "config": ["run", "--output", "out", "--config", "FILE"],
}


@pytest.mark.parametrize("name", KINDS)
def test_the_kind_of_a_file_is_told_by_its_content(tmp_path: Path, name: str) -> None:
    write, kind = KINDS[name]
    write(tmp_path / name)
    assert kind_of_file(tmp_path / name) == kind


@pytest.mark.parametrize("command", COMMANDS)
def test_commands_refuse_other_kinds_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "words.txt").write_text("this is a text\nwithout any numbers\nin three lines\n")
    for name, (write, _) in KINDS.items():
        write(tmp_path / name)
    for name in (*KINDS, "words.txt"):
        with pytest.raises(SystemExit) as ended:
            app.main([name if word == "FILE" else word for word in COMMANDS[command]])
        lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("los-testbed: ")]
        assert ended.value.code == 2 and len(lines) == 1, (name, lines)
        if (command, name) != ("config", "data.json"):  # JSON is YAML: its names are what is wrong
            assert name in lines[0]
        assert not Path("out").exists()
        known, kind = name in KINDS and name != "folder", KINDS.get(name, (None, ""))[1]
        if command in ("analyse", "disturbance") and (known or name == "words.txt"):
            assert "CSV or other text, Parquet" in lines[0]
            assert lines[0].endswith(f"got {kind or 'a text without numbers'}")
        if command == "k_fsm" and known and name != "data.json":
            assert lines[0].endswith(f"expected JSON or .mat (up to 7.2), got {kind}")


def test_a_csv_table_with_a_bracket_at_its_head_is_a_table(tmp_path: Path) -> None:
    for text in ("[s],x [mas]\n0,1\n", "{t},x\n0,1\n", "nan,1\n2,3\n"):
        (tmp_path / "table.csv").write_text(text)
        assert kind_of_file(tmp_path / "table.csv") is None
