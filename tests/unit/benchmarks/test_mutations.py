"""The mutation script: every kind of change gives another program that parses, and harmless text is left alone."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest
from support.scripts import script

PATH = Path(__file__).parents[3] / "benchmarks" / "mutations.py"
mutants = script(PATH)

SOURCE = '''"""Text: 1 < 2 and 3 + 4."""

from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    LIMIT = 5


def f(a: Literal[7], b: float = 2.5) -> Literal[8]:
    """Text: 9."""
    if a < b and not a == 0:
        raise ValueError(f"{a + 1}: expected 6" + "text")
    total = -a * (b + 3) ** 2  # comment: 1 + 1
    while total >= 10:
        total -= 1
    return total if total or b else [x for x in (a, "ä", b) if x != 4]
'''


def test_each_kind_makes_another_program_that_parses() -> None:
    found = mutants.mutations(SOURCE)
    assert {m.kind for m in found} == set(mutants.KINDS)
    programs = [m.apply(SOURCE) for m in found]
    trees = [ast.dump(ast.parse(program)) for program in programs]
    assert ast.dump(ast.parse(SOURCE)) not in trees
    assert len(set(trees)) == len(trees)


def test_texts_type_hints_and_messages_are_left_alone() -> None:
    for mutation in mutants.mutations(SOURCE):
        lines = mutation.apply(SOURCE).splitlines()
        for number in (0, 4, 5, 9, 11):
            assert lines[number] == SOURCE.splitlines()[number]
        assert "Literal[7]" in lines[8] and "Literal[8]" in lines[8] and '"ä"' in lines[-1]


@pytest.mark.parametrize(
    ("kind", "old", "new"),
    [
        ("comparison", "a < b", "b <= a"),
        ("boundary", "a < b", "a <= b"),
        ("sign", "a + b", "a - b"),
        ("sign", "-a", "a"),
        ("operator", "a / b", "a * b"),
        ("constant", "a + 1.5", "a + 3.0"),
        ("off by one", "a + 3", "a + 4"),
        ("condition", "1 if a else b", "1 if not a else b"),
        ("and/or", "a and b", "a or b"),
    ],
)
def test_a_kind_does_what_its_name_says(kind: str, old: str, new: str) -> None:
    def values(program: str) -> list[object]:
        return [eval(program, {"a": a, "b": b}) for a in (1, 2, 7) for b in (2, 4)]

    results = [values(m.apply(old)) for m in mutants.mutations(old) if m.kind == kind]
    assert values(new) in results or (kind == "comparison" and values("a >= b") in results)


def test_the_longest_path_names_the_tests() -> None:
    assert mutants.tests_of("lftkit/systems/ports.py") == ("tests/unit/lftkit",)
    assert "tests/unit/lftkit/systems/test_interconnection.py" in mutants.tests_of(
        "lftkit/systems/connection/interconnection.py"
    )
    with pytest.raises(SystemExit, match="MODULE must be below one of"):
        mutants.tests_of("docs/index.md")


def test_the_tests_it_names_exist() -> None:
    for paths in mutants.TESTS.values():
        for path in paths:
            assert (PATH.parents[1] / path.split("::")[0]).exists(), path
