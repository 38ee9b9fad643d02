"""Names and words: no old name is left, the language is plain, every reason to skip a test has a remedy."""

from __future__ import annotations

import ast
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from support.packages import LIBRARIES, ROOT, files_of
from support.skip_remedies import REMEDIES, remedy

CODE = sorted(
    path
    for folder in (
        *LIBRARIES,
        "ros_ws/src",
        "tests",
        "benchmarks",
        "examples",
        "docs",
    )
    for path in files_of(ROOT / folder)
)
TEXTS = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *CODE])

FORMER_NAMES = {
    "Shell",
    "judgement",
    "plant_members",
    "check_member",
    "replay_core",
    "as_flown",
    "FlownLoop",
    "flown_norms",
    "flown_figures",
    "flown_plant",
    "ROOMS",
    "_HOMES",
    "SampleJoin",
    "Durations",
    "PLACES",
    "_HandsOff",
    "most_rounds",
    "MOST_ROUNDS",
    "begun",
    "began",
    "LoopScan",
    "level_set",
    "special_structures",
    "_mate",
    "_dry",
    "Scene",
    "scene",
    "_hung",
    "test_house_rules",
    "BudgetError",
    "BudgetVerdict",
}
"""Identifiers of the left columns of the table of renames that mean nothing else."""

FORMER_NAMES_OF_THE_TUNER = {"place", "places"}

WORDS = re.compile(r"\b(flown|house|room|somebody else)\b", re.IGNORECASE)


def former_names(path: Path) -> set[str]:
    """What no identifier of a file may be."""
    return FORMER_NAMES | (FORMER_NAMES_OF_THE_TUNER if "tuning" in path.parts else set())


def identifiers(text: str) -> Iterator[tuple[str, int]]:
    """Names that a module defines or uses, with their lines."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)):
            yield node.name, node.lineno
        elif isinstance(node, ast.Name):
            yield node.id, node.lineno
        elif isinstance(node, ast.Attribute):
            yield node.attr, node.lineno
        elif isinstance(node, ast.arg):
            yield node.arg, node.lineno
        elif isinstance(node, ast.alias):
            yield from ((part, node.lineno) for part in (node.asname or node.name).split("."))
        elif isinstance(node, ast.keyword) and node.arg:
            yield node.arg, node.value.lineno


def relative(path: Path) -> str:
    return str(path.relative_to(ROOT))


def test_no_former_name_is_left() -> None:
    """Only a file in which one of them stands as a word is parsed."""
    found: list[str] = []
    for path in CODE:
        text, names = path.read_text("utf-8"), former_names(path)
        if re.search(rf"\b({'|'.join(sorted(names))})\b", text):
            found += [f"{relative(path)}:{line}: {name}" for name, line in identifiers(text) if name in names]
    assert not found
    assert not [relative(path) for path in CODE if path.stem in FORMER_NAMES]


def classes(path: Path) -> Iterator[tuple[str, str]]:
    """Public classes that a module defines, with their places."""
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            yield node.name, f"{relative(path)}:{node.lineno}"


def test_no_name_stands_for_two_classes() -> None:
    """Classes of the packages and of the launch file; only files that may hold one of a name twice are parsed."""
    product = [p for p in CODE if p.relative_to(ROOT).parts[0] in (*LIBRARIES, "ros_ws")]
    headed = {path: re.findall(r"^ *class ([A-Za-z]\w*)", path.read_text("utf-8"), re.MULTILINE) for path in product}
    counts = Counter(name for names in headed.values() for name in names)
    assert len(counts) > 300
    found: dict[str, list[str]] = {}
    for path, names in headed.items():
        if any(counts[name] > 1 for name in names):
            for name, place in classes(path):
                found.setdefault(name, []).append(place)
    assert {name: places for name, places in found.items() if len(places) > 1} == {}


def test_words_are_those_of_the_field() -> None:
    """Quotations stand between backticks."""
    found = [
        f"{relative(path)}:{number}: {line.strip()}"
        for path in TEXTS
        if path != Path(__file__)
        for number, line in enumerate(path.read_text("utf-8").splitlines(), start=1)
        if WORDS.search(re.sub("`[^`]*`", "", line))
    ]
    assert not found


def skip_reasons(path: Path) -> Iterator[str]:
    """Reasons in calls of pytest.skip, skipif and importorskip; what is filled in at run time is left out."""
    if "skip" not in (text := path.read_text("utf-8")):
        return
    for node in ast.walk(ast.parse(text, str(path))):
        if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Attribute):
            continue
        given = {k.arg: k.value for k in node.keywords}
        if node.func.attr in ("skip", "skipif"):
            reason = given.get("reason", node.args[0] if node.args else None)
            parts = reason.values if isinstance(reason, ast.JoinedStr) else [reason]
            yield " ".join(str(p.value) for p in parts if isinstance(p, ast.Constant))
        elif node.func.attr == "importorskip" and "reason" not in given and isinstance(node.args[0], ast.Constant):
            yield f"could not import '{node.args[0].value!s}"


def test_every_reason_to_skip_has_a_remedy() -> None:
    assert not list(skip_reasons(Path(__file__)))
    reasons = {reason for path in (ROOT / "tests").rglob("test_*.py") for reason in skip_reasons(path)}
    assert len(reasons) > 5
    assert not [reason for reason in reasons if remedy(reason) is None]
    unused = [part for part in REMEDIES if not any(part in reason for reason in reasons)]
    assert set(unused) <= {"extra nastran", "could not import 'mcap_ros2", "could not import 'rosbags"}
