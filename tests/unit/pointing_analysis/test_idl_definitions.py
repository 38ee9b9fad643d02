"""Definitions in IDL have the layout that another reader of them finds."""

from __future__ import annotations

import pytest

from pointing_analysis.read.mcap.records import BagError
from pointing_analysis.read.messages.idl_definitions import parse_idl
from pointing_analysis.read.messages.ros_definitions import parse_definition

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
        assert [(f.name, f.count, f.type.split("<")[0]) for f in fields] == [
            (f.name, f.count, f.type) for f in idl[name]
        ]


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
