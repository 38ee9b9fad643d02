"""TOML and YAML of others: what would take gigabytes or minutes is told before anything is made of it."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lftkit.errors import InputError
from lftkit.support.input_limits import DEPTH
from lftkit.support.structured_text import parse
from pointing_analysis.files.structured_text import load_toml, load_yaml, tomllib

PARTS = st.lists(st.sampled_from(["a", "'b.c'", '"d.e"', "f-1", '"\\"."', "'#'"]), min_size=1, max_size=70)
VALUES = st.sampled_from(
    ["1", "1.5", '"a.b.c"', "'''\n.....\n'''", '"""x\\"""."""', '"""q""""', "'''q''''", '"#"', "[1.5, 2.5]", "{}", '""']
)
BLANKS = st.sampled_from(["", " ", "\t ", "  "])
LINES = st.lists(st.tuples(PARTS, VALUES, BLANKS, st.sampled_from(["", ' # a.b.c \' """ x'])), min_size=1, max_size=5)


@given(lines=LINES)
@settings(max_examples=100, deadline=None)
def test_names_with_dots_are_counted_as_the_parser_does(lines: list[tuple[list[str], str, str, str]]) -> None:
    """Strings, comments and blanks hide no dot of a name, and none of theirs is taken for one."""
    text = "".join(
        f"{blank}{f'{blank}.{blank}'.join([f'k{i}', *parts])} = {value}{note}\n"
        for i, (parts, value, blank, note) in enumerate(lines)
    )
    deepest = max(1 + len(parts) for parts, _, _, _ in lines)
    assert tomllib.loads(text)
    if deepest <= DEPTH - 1:
        assert len(load_toml(text, "x")) == len(lines)
    if deepest > DEPTH:
        called: list[object] = []
        with pytest.raises(InputError, match="x must be nested at most 50 levels deep"):
            parse(text, "x", "TOML", called.append)
        assert not called  # before anything is made of it


@pytest.mark.parametrize("frame", ["{} = 1", "[{}]", "[[{}]]", "x = {{ {} = 1 }}", 's = """x""""\n{} = 1\n#"'])
def test_a_name_of_thousands_of_parts_takes_no_memory(frame: str) -> None:
    for name in ("a", '"a"', "'a'"):
        with pytest.raises(InputError, match="nested at most"):
            load_toml(frame.format(" . ".join([name] * 30_000)), "x")


def test_tables_of_any_number_are_told() -> None:
    with pytest.raises(InputError, match="at most 300000 values"):
        load_toml("".join(f"[a{i}.b.c.d.e]\n" for i in range(100_000)), "x")


def test_a_flat_yaml_of_any_number_is_told_before_it_is_made() -> None:
    assert len(load_yaml("a: [" + "1," * 1000 + "1]", "x")["a"]) == 1001
    for text in ("a: [" + "1," * 400_000 + "1]\n", "".join(f"k{i}: 1\n" for i in range(200_000))):
        with pytest.raises(InputError, match="x must be YAML with at most 300000 values"):
            load_yaml(text, "x")
    with pytest.raises(InputError, match="x must be YAML of at most 4 MB, got 5"):
        load_yaml("# " + "x" * 5_000_000, "x")
