"""Definitions of messages, TOML and YAML of others: what they say, and what is told before anything is made of it."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lftkit.errors import InputError
from lftkit.support.input_limits import DEPTH
from lftkit.support.structured_text import parse
from pointing_analysis.files.structured_text import load_toml, load_yaml, tomllib
from pointing_analysis.read.mcap.records import BagError
from pointing_analysis.read.messages.idl_definitions import parse_idl
from pointing_analysis.read.messages.ros_definitions import locate, located, parse_definition, vectors

IDL = """================================================================================
IDL: my_msgs/msg/Rich
// generated from rosidl_adapter/resource/msg.idl.em
#include "std_msgs/msg/Header.idl"
module my_msgs { module msg {
  typedef double double__9[9];
  module Rich_Constants { const uint8 A = 1; @verbatim (language="comment", text="a (b) ; } c") const string S = "x"; };
  @verbatim (language="comment", text=
    "hello (world)" "more")
  struct Rich {
    std_msgs::msg::Header header; /* two
    lines */
    @unit (value="rad")
    double__9 cov;
    sequence<double, 3> few; sequence<my_msgs::msg::Part> parts;
    string<10> s; unsigned long long n; long l; octet o; boolean b; @default (value=3) int8 k; float f;
  };
}; };
================================================================================
IDL: my_msgs/msg/Part
module my_msgs { module msg { struct Part { uint8 a; double x; }; }; };
================================================================================
IDL: std_msgs/msg/Header
module std_msgs { module msg { struct Header { builtin_interfaces::msg::Time stamp; string frame_id; }; }; };
"""
MSG = """std_msgs/Header header
float64[9] cov
float64[<=3] few
my_msgs/Part[] parts
string<=10 s
uint64 n
int32 l
uint8 o
bool b
int8 k
float32 f
================================================================================
MSG: my_msgs/Part
uint8 a
float64 x
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
"""


def test_idl_and_msg_have_the_same_fields() -> None:
    idl, msg = parse_idl("my_msgs/msg/Rich", IDL), parse_definition("my_msgs/msg/Rich", MSG)
    assert set(idl) == set(msg)
    for name, fields in msg.items():
        expected = [(f.name, f.count, f.type.split("<")[0]) for f in fields]
        assert [(f.name, f.count, f.type) for f in idl[name]] == expected


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "must hold it, got none"),
        ("module a { module msg { struct X { double x; ", "must be IDL, got a truncated one"),
        ("module a { union X switch (long) { case 1: double x; }; };", "must be IDL, got 'union'"),
        ("struct X { double x };", "must be IDL, got '}' instead of ';'"),
        ("module a { " * 5000, "must be IDL"),
        ("struct X { sequence<double> x[2]; };", "an array of sequences"),
    ],
)
def test_other_text_is_refused(text: str, message: str) -> None:
    with pytest.raises(BagError, match=message):
        parse_idl("a/msg/X", text)


def test_an_array_of_arrays_has_all_their_elements() -> None:
    text = "module a { module msg { typedef double three[3]; struct X { three x[2]; three y; }; }; };"
    assert [field.count for field in parse_idl("a/msg/X", text)["a/X"]] == [6, 3]


def definition(width: int, depth: int) -> str:
    parts = ["\n".join(f"m/A{level + 1} f{i}" for i in range(width)) for level in range(depth)]
    parts = [parts[0], *(f"MSG: m/A{level}\n{text}" for level, text in enumerate(parts[1:], 1))]
    return ("\n" + "=" * 80 + "\n").join([*parts, f"MSG: m/A{depth}\nfloat64 x\nfloat64 y\n"])


def test_a_definition_that_stands_for_too_many_fields_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(BagError, match="at most 20000 fields"):
        vectors("m/msg/R", parse_definition("m/msg/R", definition(4, 10)))
    monkeypatch.setattr("pointing_analysis.read.messages.ros_definitions.MESSAGE_ELEMENTS", 10_000)
    with pytest.raises(BagError, match="at most 10000 elements"):
        locate("m/msg/R", parse_definition("m/msg/R", definition(30, 5)), "none", b"\0\1\0\0")


def test_one_walk_finds_what_a_walk_for_each_field_finds() -> None:
    types = parse_definition("m/msg/R", definition(3, 3))
    payload = b"\0\1\0\0" + struct.pack("<54d", *range(54))
    paths = {vector.path for vector in vectors("m/msg/R", types)}
    assert len(paths) == 27 and located("m/msg/R", types, payload) == paths
    assert located("m/msg/R", types, payload[:-16]) == paths - {"f2.f2.f2"}
    assert locate("m/msg/R", types, "f1.f0.f2", payload).numbers == ((4 + 16 * 11, "f8"), (12 + 16 * 11, "f8"))


def test_a_quaternion_in_another_type_and_order() -> None:
    text = "my/Q q\n" + "=" * 20 + "\nMSG: my/Q\nfloat32 w\nfloat32 x\nfloat32 y\nfloat32 z\n"
    found = vectors("my/msg/Status", parse_definition("my/msg/Status", text))
    assert [(v.name, v.components) for v in found] == [(f"q.{axis}", ("w", "x", "y", "z")) for axis in "xyz"]


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


def test_values_of_any_number_are_told_before_they_are_made() -> None:
    with pytest.raises(InputError, match="at most 300000 values"):
        load_toml("".join(f"[a{i}.b.c.d.e]\n" for i in range(100_000)), "x")
    assert len(load_yaml("a: [" + "1," * 1000 + "1]", "x")["a"]) == 1001
    for text in ("a: [" + "1," * 400_000 + "1]\n", "".join(f"k{i}: 1\n" for i in range(200_000))):
        with pytest.raises(InputError, match="x must be YAML with at most 300000 values"):
            load_yaml(text, "x")
    with pytest.raises(InputError, match="x must be YAML of at most 4 MB, got 5"):
        load_yaml("# " + "x" * 5_000_000, "x")
