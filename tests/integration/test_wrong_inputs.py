"""Wrong inputs as users bring them: each is refused in one line that names file, row, column, unit, option or kind.

A row of the tables has the text (or bytes) of a file, what the message must name, parts with a bar between them, and
perhaps options of the command. Nothing is written, and messages about a table do not speak of topics.
"""

from __future__ import annotations

import gzip
import io
import zipfile
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from support.command_line import call_command

from lftkit.support.file_kind import kind_of_file

HEAD = "time,x_mas,y_mas\n"
ROWS = [f"{0.01 * k:.2f},{k % 7 - 3}.25,{k % 5}.5\n" for k in range(12)]
PLAIN = HEAD + "".join(ROWS)


def cell(text: str) -> str:
    """The table with this cell in the column x_mas of row 5."""
    return HEAD + "".join([*ROWS[:3], f"0.03,{text},1.5\n", *ROWS[4:]])


def line(text: str, row: int = 5) -> str:
    """The table with this line in a row."""
    return HEAD + "".join([*ROWS[: row - 2], f"{text}\n", *ROWS[row - 2 :]])


def times(*cells: str, head: str = "time") -> str:
    """The table with these times; three give twelve by their first part and step."""
    return f"{head},x_mas,y_mas\n" + "".join(f"{t},1.5,{k % 5}.25\n" for k, t in enumerate(cells))


def counted(step: float, head: str, digits: int = 0, start: float = 0.0) -> str:
    return times(*(f"{start + step * k:.{digits}f}" for k in range(12)), head=head)


def headed(x: str, y: str = "", time: str = "time") -> str:
    """The table with other names of columns."""
    return f"{time},{x},{y or x.replace('x', 'y')}\n" + "".join(ROWS)


def semicolons(text: str) -> str:
    return text.replace(",", ";")


def stored(kind: str, los: np.ndarray) -> bytes:
    """The content of a file with an array, and with times beside it where the format names arrays."""
    file = io.BytesIO()
    if kind == "npy":
        np.save(file, los)
    else:
        scipy.io.savemat(file, {"los": los, "t": 0.01 * np.arange(len(los))})
    return file.getvalue()


BAD_CELLS = ["#N/A", "NA", "-", "null", "?", "1.0.0", "0x1F", "1_000", "3 mas", "1e", "1/2", "True", "12:00:00"]
LAST_ROWS = ["total,1,2", "Mean,,", "sum;1;2", "[EOF]"]

Row = tuple[str | bytes, str] | tuple[str | bytes, str, str]
ANALYSE: dict[str, Row] = {
    **{f"cell {text}": (cell(text), f"row 5|column x_mas|{text}") for text in BAD_CELLS},
    **{f"last {text}": (PLAIN + text + "\n", "row 14") for text in LAST_ROWS},
    "complex numbers": (stored("mat", np.full((50, 2), 1j)), "two of the columns t|complex numbers not used: los"),
    "an array of complex numbers": (stored("npy", np.full((50, 2), 1j)), "real numbers|complex128"),
    "most of a column": (
        "time,x_mas,y_mas,z_mas\n" + "".join(f"{k}e-2,{'#N/A' if k % 3 else k},1,{k}\n" for k in range(12)),
        "column x_mas|#N/A",
    ),
    "column of words": ("time,x_mas,y_mas,z_mas\n0,a,1,2\n0.01,b,2,3\n0.02,c,4,4\n", "row 2|column x_mas|'a'"),
    "one cell more": (line("0.03,1,2,3"), "3 cells|got 4|row 5"),
    "decimal commas between commas": (line("0,03,1,5,2,5"), "3 cells|row 5"),
    "thousands and decimals": (semicolons(HEAD) + "0.00;1,234;2,345\n0.01;1,235;2,346\n", "decimal mark|1,234|row 2"),
    "points for thousands": (semicolons(HEAD) + "0,00;1.234;2.345\n0,01;1.235;2.346\n", "decimal mark|1.234|row 2"),
    "thousands in some rows": (
        semicolons(HEAD) + "0;999;1\n1;1,000;2\n2;1,001;3\n3;998;1\n",
        "row 3|marks of thousands|1,000",
    ),
    "no rows": (HEAD, "without numbers"),
    "one row": (HEAD + "0,1,2\n", "two or more rows|got 1"),
    "names twice": ("time,x_mas,x_mas\n0,1,2\n", "different names|x_mas"),
    "times of milliseconds": (counted(10, "time"), "unit of the times|time_ms"),
    "times of nanoseconds": (counted(1e7, "stamp"), "unit of the times|stamp"),
    "Julian days": (counted(0.01 / 86_400, "JD", 9, 2_460_000.5), "days|JD (d)"),
    "cut seconds": (times(*["1.7e9"] * 12), "too few digits|--rate"),
    "dates of the USA": (times(*[f"11/20/2026 12:00:0{k}" for k in range(9)]), "row 2|column time|11/20/2026"),
    "dates under another name": (times(*[f"11/20/2026 12:00:0{k}" for k in range(9)], head="date"), "column date"),
    "half of the day": (times(*[f"2026-11-20 1:00:0{k} PM" for k in range(9)]), "row 2|column time|PM"),
    "a month 13": (times(*[f"2026-13-20T12:00:0{k}" for k in range(9)]), "row 2|column time|2026-13-20"),
    "a date among numbers": (line("2026-11-20T12:00:00,1,2"), "column time"),
    "a missing time": (line(",1,2"), "time must be given|1 missing|sample 4"),
    "an infinite time": (line("inf,1,2"), "time must be given|sample 4"),
    "two records": (
        PLAIN + "".join(row.replace(".25", ".75") for row in ROWS),
        "two records|sample 13|12 with|--time none --rate",
    ),
    "sample numbers": (counted(1, "sample"), "sample numbers|--rate|sample"),
    "no times": ("x_mas,y_mas\n1,2\n3,4\n", "rate must be given"),
    "rate of other times": (PLAIN, "rate must match|100 Hz|500 Hz", "--rate 500"),
    "rate of zero": (PLAIN, "rate", "--rate 0"),
    "an unknown time": (PLAIN, "time must be one of|time, x_mas, y_mas|clock", "--time clock"),
    "another unit of time": (counted(10, "time_ms"), "time must be in ms", "--time time_s"),
    "a text as the time": ("when,x_mas,y_mas\nmon,1,2\ntue,2,3\n", "row 2|column when|mon", "--time when"),
    "an unknown axis": (PLAIN, "los must be two of|z_mas", "--los x_mas,z_mas"),
    "one axis": (PLAIN, "los must be two of|x_mas", "--los x_mas"),
    "one axis twice": (PLAIN, "two different columns", "--los x_mas,x_mas"),
    "many columns": ("time,a,b,c\n0,1,2,3\n1,2,3,4\n", "los must name two|a, b, c", "--unit mas"),
    "no unit": (headed("x"), "unit must be given|--unit|x"),
    "no unit of one axis": (headed("x_mas", "y"), "unit must be given|y"),
    "another unit": (PLAIN, "unit must be mas|x_mas|urad", "--unit urad"),
    "an unknown unit": (headed("x"), "unit must be one of|furlong", "--unit furlong"),
    "rates": (headed("x_rad_s"), "angle|x_rad_s|rad/s"),
    "percent": (headed("x (%)"), "angle|%"),
    "unknown units in a row": (HEAD.replace("_mas", "") + "s,furlong,furlong\n" + "".join(ROWS), "angle|furlong"),
    "units that differ": (HEAD + "s,urad,urad\n" + "".join(ROWS), "unit of x_mas must be one|urad"),
    "two units of a name": (headed("x_urad (mas)"), "unit of x_urad (mas) must be one"),
    "a wrap": ("time,x_deg,y_deg\n0,359.9,1\n0.01,0.1,1\n0.02,0.2,1\n", "full turn|sample 1"),
    "titles without a header": ("Bench 5, run 7\nOperator, N. N.\n" + "".join(ROWS), "2 cells|row 3"),
    "zero bytes": (PLAIN + "\0\0\0\0", "row 14|zero bytes"),
    "another encoding": (PLAIN.encode() + b"\x81\x8d\n", "UTF-8"),
    "LabVIEW": ("LabVIEW Measurement\t\nSeparator\tTab\n", "LabVIEW measurement file|to convert it"),
    "TDMS": (b"TDSm\x0e\0\0\0\x69\x12\0\0", "TDMS|npTDMS"),
    "FITS": (b"SIMPLE  =                    T".ljust(2880), "FITS|astropy"),
    "MDF": (b"MDF     4.10    " + bytes(80), "MDF|asammdf"),
    "pickle": (b"\x80\x04\x95\x10" + bytes(80), "pickle|read_pickle"),
    "ROOT": (b"root\0\0\xf6\x18" + bytes(80), "ROOT"),
    "an old workbook": (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(80), ".xls"),
    "XML": ("<?xml version='1.0'?><table><tr>1</tr></table>", "XML"),
}

SIX = "Fx (N),Fy (N),Fz (N),Mx (Nm),My (Nm),Mz (Nm)"
FORCES = [f"{0.001 * k:.3f},{k % 3}e-3,2e-3,{k % 5}e-3,0,1e-3,0\n" for k in range(2500)]


def forces(head: str = f"time (s),{SIX}", rows: list[str] = FORCES) -> str:
    return head + "\n" + "".join(rows)


def units(force: str, torque: str) -> str:
    return forces(f"time (s),Fx ({force}),Fy ({force}),Fz ({force}),Mx ({torque}),My ({torque}),Mz ({torque})")


def few(first: str, *starts: str) -> str:
    """A short table of another kind with one row for each start."""
    return f"{first},Fx,Fy,Fz,Tx,Ty,Tz\n" + "".join(f"{start},1e-7,1e-7,1e-7,0,0,0\n" for start in starts)


DISTURBANCE: dict[str, Row] = {
    "kilonewtons": (units("kN", "Nm"), "unit of Fx (kN)|N or mN"),
    "millimetres": (units("N", "Nmm"), "unit of Mx (Nmm)|Nm or mNm"),
    "a torque as a force": (units("Nm", "Nm"), "unit of Fx (Nm)|N or mN"),
    "other names": (forces("time,F1,F2,F3,M1,M2,M3"), "must have columns of Fx, Fy|F1, F2"),
    "errors of an axis": (forces(rows=[r.replace("1e-3,2", "#N/A,2") for r in FORCES]), "row 3|column Fx (N)|#N/A"),
    "a row of totals": (forces() + "total,1,1,1,1,1,1\n", "row 2502|column time (s)|total"),
    "an empty cell": (forces(rows=[*FORCES[:9], "0.009,,0,0,0,0,0\n", *FORCES[10:]]), "finite values|1 that are"),
    "a gap": (forces(rows=FORCES[:900] + FORCES[905:]), "without gaps|0.006 s"),
    "a time twice": (forces(rows=FORCES[:900] + FORCES[899:]), "uniform|0 to 0.001"),
    "a short record": (forces(rows=FORCES[:500]), "as long as the run|0.5 s|repeat"),
    "milliseconds": (forces(f"time,{SIX}", [f"{k}{row[5:]}" for k, row in enumerate(FORCES)]), "unit of the times"),
    "no time": (forces(SIX, [row.partition(",")[2] for row in FORCES]), "column time|rate"),
    "dates of the USA": (
        forces(f"time,{SIX}", [f"11/20/2026 12:00:00,{row.partition(',')[2]}" for row in FORCES]),
        "row 2|column time|11/20/2026",
    ),
    "a density in newtons": (few("frequency (Hz)", "1", "2").replace("Fx", "Fx (N)"), "unit of Fx (N)|N^2/Hz"),
    "decibels": (few("frequency (Hz)", "1", "2").replace("Fy", "Fy (dB)"), "unit of Fy (dB)|N^2/Hz"),
    "a negative density": (few("frequency (Hz)", "1", "2").replace("1e-7", "-1e-7"), "negative"),
    "harmonics in newtons": (few("order", "1", "2").replace("Fx", "Fx (N)"), "unit of Fx (N)|squared = false"),
    "an order of zero": (few("order", "0", "1"), "order of a harmonic|0"),
    "a waterfall without a row": (few("speed (rpm),frequency", "1,1", "1,2", "2,1"), "a row for each|3 rows"),
    "TDMS": (b"TDSm\x0e\0\0\0\x69\x12\0\0", "TDMS|npTDMS"),
}


def table(kind: str, text: str = "", place: str = "payload") -> str:
    """A source of a TOML file; keys between semicolons."""
    lines = (f'name = "c"; kind = "{kind}"; place = "{place}"; ' + text).split("; ")
    return "[[disturbance]]\n" + "\n".join(lines) + "\n"


PUSH = "harmonics = [{ order = 1, force = [1, 0, 0] }]"
SOURCE: dict[str, Row] = {
    "a file that is missing": (table("series", 'file = "x.csv"'), "disturbance 'c'|file|x.csv|no such file"),
    "a file of another kind": (table("psd", 'file = "data.toml"'), "disturbance 'c'|data.toml|without numbers"),
    "neither list nor file": (table("cooler", "frequency = 47"), "harmonics must be tables or in a file|neither"),
    "no harmonics": (table("cooler", "frequency = 47; harmonics = []"), "harmonics must be tables"),
    "an order alone": (table("cooler", "frequency = 47; harmonics = [{ order = 1 }]"), "force or torque|order"),
    "pulses of nothing": (table("pulses", "period = 1; width = 0.1"), "force or torque|period, width"),
    "no frequency": (table("cooler", PUSH), "disturbance 'c'|has no 'frequency'"),
    "a frequency with its unit": (table("cooler", f'frequency = "47 Hz"; {PUSH}'), "frequency|'47 Hz'"),
    "two axes": (
        table("cooler", f"frequency = 47; {PUSH}").replace("1, 0, 0", "1, 0"),
        "harmonics[0].force|3 numbers|2",
    ),
    "an unknown place": (table("cooler", f"frequency = 47; {PUSH}", "moon"), "place|payload|wheel_1|'moon'"),
    "an unknown kind": (table("colder"), "kind must be one of|cooler|'colder'"),
    "an unknown key": (table("pulses", "force = [1, 0, 0]; periode = 1"), "unknown parameter|periode|period"),
    "no table": ("[disturbance]\n", "[[disturbance]]"),
    "two of one name": (2 * table("cooler", f"frequency = 47; {PUSH}"), "different names|c, c"),
}

LIMIT = "prob(|APE| < 3 mas) >= 0.9 at 90 % confidence"


def requirement(text: str, more: str = "") -> str:
    return f'[[requirement]]\nname = "a"\ntext = "{text}"\n{more}'


REQUIREMENTS: dict[str, Row] = {
    "an unknown unit of a limit": (requirement(LIMIT.replace("mas", "m")), "mission.toml|unit|mas|'m'"),
    "a limit below zero": (requirement(LIMIT.replace("3", "-3")), "mission.toml|limit must be positive|-3"),
    "a probability above one": (requirement(LIMIT.replace("0.9", "1.9")), "mission.toml|probability|1.9"),
    "no confidence": (requirement(LIMIT.partition(" at")[0]), "mission.toml|must read like|>= 0.9'"),
    "an unknown index": (requirement(LIMIT.replace("APE", "XPE")), "mission.toml|index|APE|'XPE'"),
    "no window": (requirement(LIMIT.replace("APE", "RPE")), "mission.toml|must have 1 time, got 0"),
    "a window without unit": (requirement(LIMIT.replace("APE", "RPE(20)")), "mission.toml|time|20 ms|'20'"),
    "an unknown key of a requirement": (requirement(LIMIT, "colour = 1\n"), "mission.toml|unknown parameter|colour"),
    "no text": ("[[requirement]]\nname = 'a'\n", "mission.toml|requirement|text"),
    "no requirement": ("", "mission.toml|requirement"),
    "broken TOML": ("[[requirement\n", "mission.toml|TOML|line 1"),
}

ARRAY = "[[solar_array]]\nname = 'wing'\npoint = 'A1'\nlike = 'reference'\n"
TELESCOPE: dict[str, Row] = {
    "an unknown table": ("[isolater]\n", "line 2|isolater|isolator"),
    "an unknown key": ("[isolator]\nstifness = 1\n", "line 3|isolator.stifness|did you mean stiffness"),
    "a negative stiffness": ("[isolator]\nstiffness = [-1.0, 1, 1, 1, 1, 1]\n", "line 3|stiffness[0]|above 0|-1"),
    "a damping above one": (ARRAY + "damping = 1.5\n", "line 2|solar_array[0]|damping|1.5"),
    "modes heavier than the body": (ARRAY + "mass = 2.0\n", "line 2|solar_array[0]|residual mass"),
    "a point elsewhere": (ARRAY.replace("A1", "Z9"), "line 4|solar_array[0].point|A1|'Z9'"),
    "a missing file of modes": ("[payload]\nmodal_data = 'm.toml'\n", "line 3|payload.modal_data|m.toml"),
    "a source at no place": (table("cooler", f"frequency = 47; {PUSH}", "moon"), "disturbance 'c'|place|'moon'"),
}
"""Behind the line of the base."""

RUN_FILE: dict[str, Row] = {
    "a value out of range": ("duration: -3\n", "duration must be between|-3"),
    "an unknown setting": ("durration: 3\n", "unknown parameter 'durration'|duration"),
    "TOML": ('duration = "x"\n', "YAML"),
}
RUN = ["run", "--mode=inprocess", "--duration=2", "--loop=isolator", "--output=out", "--disturbance"]


COMMANDS = {
    "data.csv": ["analyse", "data.csv"],
    "wheel.csv": [*RUN, "wheel.csv@wheel_1"],
    "data.toml": [*RUN, "data.toml"],
    "mission.toml": ["analyse", "data.csv", "--requirements", "mission.toml"],
    "telescope.toml": ["plant", "check", "telescope.toml"],
    "run.yaml": ["run", "--mode=inprocess", "--output=out", "--config", "run.yaml"],
}


KINDS = {
    "data.csv": ANALYSE,
    "wheel.csv": DISTURBANCE,
    "data.toml": SOURCE,
    "mission.toml": REQUIREMENTS,
    "telescope.toml": TELESCOPE,
    "run.yaml": RUN_FILE,
}
"""Wrong inputs of a command by the name of its file."""


@pytest.mark.parametrize(
    ("name", "case"), [pytest.param(name, case, id=f"{name}-{case}") for name, kind in KINDS.items() for case in kind]
)
def test_a_wrong_input_is_refused(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path, name: str, case: str
) -> None:
    content, words, *options = KINDS[name][case]
    monkeypatch.chdir(tmp_path)
    files = {"data.csv": PLAIN, name: content} if name == "mission.toml" else {name: content}
    for file, text in files.items():
        head = b'base = "reference"\n' if file == "telescope.toml" else b""
        Path(file).write_bytes(head + (text if isinstance(text, bytes) else text.encode()))
    code, out, err = call_command(capsys, *COMMANDS[name], *" ".join(options).split())
    messages = [text for text in err.splitlines() if text.startswith(("los-testbed: ", "los-testbed analyse: error: "))]
    assert code == 2 and out == "" and len(messages) == 1, (code, out, err)
    missing = [word for word in (name, *words.split("|")) if word not in messages[0]]
    assert not missing, (missing, messages[0])
    assert messages[0].count(f"{name}: ") <= 1, messages[0]
    assert "topic" not in messages[0] and sorted(path.name for path in tmp_path.iterdir()) == sorted(files)


def archive(*names: str) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as made:
        for name in names:
            made.writestr(name, "1,2\n")
    return file.getvalue()


OTHER_KINDS: dict[str, tuple[bytes | None, str]] = {
    "page.html": (b"<!DOCTYPE html>\n<html><body>1,2</body></html>\n", "an HTML page"),
    "page.csv": (b"<html>\n<p>1,2</p></html>\n", "an HTML page"),
    "paper.pdf": (b"%PDF-1.4\n%\xe2\xe3\n1 0 obj\n", "a PDF document"),
    "data.zip": (archive("x.csv"), "a zip archive (unpack it first)"),
    "image.png": (b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR", "a PNG picture"),
    "data.json": (b'{"a": [1, 2, 3]}', "JSON"),
    "sheet.xlsx": (archive("[Content_Types].xml", "xl/workbook.xml"), "an Excel workbook (save the sheet as CSV)"),
    "empty.csv": (b"", "an empty file"),
    "folder": (None, "a folder"),
    "data.csv.gz": (gzip.compress(b"t,x,y\n0,1,2\n"), "a gzip file (unpack it first)"),
}
"""Content of files of kinds that are not read, and what each is called."""


def made(path: Path) -> Path:
    content = OTHER_KINDS[path.name][0]
    path.mkdir() if content is None else path.write_bytes(content)
    return path


COMMANDS_WITH_FILES = {
    "analyse": ["analyse", "FILE"],
    "disturbance": ["run", "--mode", "inprocess", "--output", "out", "--disturbance", "FILE"],
    "k_fsm": ["run", "--mode", "inprocess", "--output", "out", "--k-fsm", "FILE"],
    "requirements": ["analyse", str(Path("bags/reference").resolve()), "--requirements", "FILE"],
    "members": ["campaign", "--output", "out", "--sampling", "FILE"],
    "config": ["run", "--output", "out", "--config", "FILE"],
}


@pytest.mark.parametrize("name", OTHER_KINDS)
def test_the_kind_of_a_file_is_told_by_its_content(tmp_path: Path, name: str) -> None:
    assert kind_of_file(made(tmp_path / name)) == OTHER_KINDS[name][1]


@pytest.mark.parametrize("command", COMMANDS_WITH_FILES)
def test_commands_refuse_other_kinds_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "words.txt").write_text("this is a text\nwithout any numbers\nin three lines\n")
    for name in OTHER_KINDS:
        made(tmp_path / name)
    for name in (*OTHER_KINDS, "words.txt"):
        words = [name if word == "FILE" else word for word in COMMANDS_WITH_FILES[command]]
        code, _, err = call_command(capsys, *words)
        lines = [line for line in err.splitlines() if line.startswith("los-testbed: ")]
        assert code == 2 and len(lines) == 1, (name, lines)
        if (command, name) != ("config", "data.json"):  # JSON is YAML: its names are what is wrong
            assert name in lines[0]
        assert not Path("out").exists()
        known, kind = name in OTHER_KINDS and name != "folder", OTHER_KINDS.get(name, (None, ""))[1]
        if command in ("analyse", "disturbance") and (known or name == "words.txt"):
            assert "CSV or other text, Parquet" in lines[0]
            assert lines[0].endswith(f"got {kind or 'a text without numbers'}")
        if command == "k_fsm" and known and name != "data.json":
            assert lines[0].endswith(f"expected JSON or .mat (up to 7.2), got {kind}")


def test_a_csv_table_with_a_bracket_at_its_head_is_a_table(tmp_path: Path) -> None:
    for text in ("[s],x [mas]\n0,1\n", "{t},x\n0,1\n", "nan,1\n2,3\n"):
        (tmp_path / "table.csv").write_text(text)
        assert kind_of_file(tmp_path / "table.csv") is None
