"""No name stands for two classes, every reason to skip a test has a remedy."""

from __future__ import annotations

import ast
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from support.packages import LIBRARIES, ROOT, files_of, tree
from support.skip_remedies import REMEDIES, remedy

CODE = sorted(
    path
    for folder in (*LIBRARIES, "ros_ws/src", "tests", "benchmarks", "examples", "docs")
    for path in files_of(ROOT / folder)
)


def relative(path: Path) -> str:
    return str(path.relative_to(ROOT))


def classes(path: Path) -> Iterator[tuple[str, str]]:
    """Public classes that a module defines, with their places."""
    for node in ast.walk(tree(path)):
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


def skip_reasons(path: Path) -> Iterator[str]:
    """Reasons in calls of pytest.skip, skipif and importorskip; what is filled in at run time is left out."""
    if "skip" not in path.read_text("utf-8"):
        return
    for node in ast.walk(tree(path)):
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
    files = [path for pattern in ("test_*.py", "conftest.py") for path in (ROOT / "tests").rglob(pattern)]
    reasons = {reason for path in files for reason in skip_reasons(path)}
    assert len(reasons) > 5
    assert not [reason for reason in reasons if remedy(reason) is None]
    unused = [part for part in REMEDIES if not any(part in reason for reason in reasons)]
    assert set(unused) <= {"extra nastran", "could not import 'mcap_ros2", "could not import 'rosbags"}
