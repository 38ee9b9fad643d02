"""A user's parameter file: tables with names are merged by name, and what differs from the reference is told."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from titop_plant.telescope.load import differences, load_telescope
from titop_plant.telescope.sections import Equipment


def equipment(tmp_path: Path, text: str) -> dict[str, Equipment]:
    file = tmp_path / "own.toml"
    file.write_text(text, "utf-8")
    return {item.name: item for item in load_telescope(file).payload.equipment}


def test_a_table_changes_that_of_its_name_and_leaves_the_others(tmp_path: Path) -> None:
    reference = {item.name: item for item in load_telescope().payload.equipment}
    found = equipment(tmp_path, '[[payload.equipment]]\nname = "front-end electronics"\nmass = 48.5\n')
    assert list(found) == list(reference)
    changed = found.pop("front-end electronics")
    assert changed == replace(reference.pop("front-end electronics"), mass=48.5)
    assert found == reference


def test_the_whole_list_is_replaced_only_when_asked(tmp_path: Path) -> None:
    one = '[[payload.equipment]]\nname = "all"\nmass = 30.0\nsize = [0.5, 0.5, 0.5]\nnode = "bench"\n'
    assert list(equipment(tmp_path, '[payload]\nreplace = ["equipment"]\n' + one)) == ["all"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[[payload.equipment]]\nmass = 3.0", ["payload.equipment[0]", "name"]),
        ('[[payload.equipment]]\nname = "new"\nmass = 3.0\nnode = "bench"', ["payload.equipment[0]", "size"]),
        ('[[payload.equipment]]\nname = "a"\n[[payload.equipment]]\nname = "a"', ["payload.equipment[0]", "mass"]),
        ('[payload]\nreplace = ["sections"]', ["payload.replace", "equipment", "sections"]),
        ('[payload]\nreplace = ["equipment"]', ["payload.replace", "must name lists that this file holds"]),
        ('[sadm]\nreplace = ["equipment"]', ["replace", "expected one of"]),
        (
            '[[payload.equipment]]\nname = "FSM mount"\n[[payload.equipment]]\nname = "FSM mount"',
            ["line 4", "payload.equipment[1].name", "twice"],
        ),
    ],
)
def test_a_mistake_names_the_key(tmp_path: Path, text: str, words: list[str]) -> None:
    with pytest.raises(ValueError) as refused:
        equipment(tmp_path, text)
    assert all(word in str(refused.value) for word in words), refused.value


def test_the_differences_are_those_of_the_file(tmp_path: Path) -> None:
    file = tmp_path / "own.toml"
    file.write_text(
        '[isolator]\nmass = 2.0\n[fsm]\nlos_sensitivity = 0.1\n[[payload.equipment]]\nname = "FSM mount"\nmass = 1.5\n'
    )
    assert differences(file) == [
        "payload.equipment[FSM mount].mass = 1.5, reference 0.9",
        "isolator.mass = 2, reference 1.5",
    ]
    file.write_text(
        '[body]\nreplace = ["equipment"]\n[[body.equipment]]\n'
        'name = "battery"\nmass = 1.0\nsize = [1, 1, 1]\nnode = "G"\n'
    )
    lines = differences(file)
    assert "body.equipment[battery].mass = 1, reference 117.6" in lines
    assert "body.equipment[computer].mass removed" in lines
    assert "body.equipment[battery].node = G, added" in lines
