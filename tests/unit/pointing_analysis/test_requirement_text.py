"""Laws of the text form of requirements: what is written is read again, and where what can be read ends."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
import yaml

from lftkit.errors import InputError
from lftkit.support.counted_nouns import counted
from pointing_analysis.requirements.requirement import INTERPRETATIONS, Requirement, entries, from_entries, load, parse
from pointing_analysis.units import ANGLES

INDICES = {"APE": 0, "MPE": 1, "RPE": 1, "PDE": 2, "PRE": 1, "AKE": 0, "MKE": 1, "RKE": 1}
"""Times of each index by its definition: none at an instant, the window of a mean, for drift its separation too."""


def text(
    quantity: str = "|APE|", limit: str = "1 mas", p: str = "0.9", c: str = "95 %", kind: str = "", than: str = "<"
) -> str:
    return f"prob({quantity} {than} {limit}) >= {p} at {c} confidence{kind}"


TAIL = ">= 0.997 at 95 % confidence"


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("prob(MTF(20 ms, Nyquist) > 0.90) >= 0.997 at 95 % confidence", "MTF(20 ms, Nyquist)"),
        ("prob( mtf ( 20 ms , 0.5 nyquist ) >= .9 ) >= 99.7 % at 95 % confidence", "MTF(20 ms, 0.5 Nyquist)"),
        ("prob(MTF(1 s, 8 cycles/arcsec) > 1e-3) >= 0.5 at 95 % confidence, mixed", "MTF(1 s, 8 cycles/arcsec)"),
        ("prob(Strehl(20 ms) > 0.8) >= 0.997 at 95 % confidence", "Strehl(20 ms)"),
        ("prob(EE80(20 ms) < 140 mas) >= 0.997 at 95 % confidence, ensemble", "EE80(20 ms)"),
        ("prob(ee50(20 ms) < 0.3 urad) >= 0.997 at 95 % confidence", "EE50(20 ms)"),
        ("prob(ELLIPTICITY(20 ms) < 0.02) >= 0.997 at 95 % confidence", "ellipticity(20 ms)"),
    ],
)
def test_text_form_of_requirements_on_images(text: str, shown: str) -> None:
    r = parse(text)
    assert r.quantity == shown and r.of_image and r.lower == (">" in text.split(")")[1])
    assert parse(str(r)) == r and parse(r.exact_text, r.name) == r
    assert from_entries(entries([r]), "list") == (r,)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("prob(MTF(20 ms, Nyquist) < 0.9) ", r"MTF must have a lower limit \(>\), got '<'"),
        ("prob(EE80(20 ms) > 90 mas) ", r"EE80 must have an upper limit \(<\), got '>'"),
        ("prob(|RPE(20 ms)| > 90 mas) ", r"RPE must have an upper limit \(<\), got '>'"),
        ("prob(MTF(20 ms, Nyquist) > 0.9 mas) ", "MTF must have a limit without a unit, got mas"),
        ("prob(EE80(20 ms) < 90) ", "EE80 must have a limit in one of mas, .*, got none"),
        ("prob(MTF(20 ms) > 0.9) ", "MTF must have a spatial frequency, as in"),
        ("prob(MTF(20 ms, 8 cycles/pixel) > 0.9) ", "unit of a spatial frequency must be one of mas, .*, got 'pixel'"),
        ("prob(MTF(Nyquist) > 0.9) ", r"MTF\(...\) must have 1 time, got 0"),
        ("prob(Strehl(20 ms, 1 s) > 0.9) ", r"Strehl\(...\) must have 1 time, got 2"),
        ("prob(|Strehl(20 ms)| > 0.9) ", "Strehl must be given without"),
        ("prob(MTF(20 ms, Nyquist) > 1.0) ", r"limit of MTF must be below 1, got 1\.0"),
        ("prob(MTF(20 ms, Nyquist) > 0) ", "limit must be positive, got 0"),
        ("prob(EE85(20 ms) < 40 mas) ", "index must be one of APE.*got 'EE85'"),
        ("prob(|XPE(20 ms)| < 40 mas) ", "index must be one of APE.*got 'XPE'"),
        ("prob(|RPE_z(20 ms)| < 40 mas) ", "axis must be one of x, y, got 'z'"),
        ("prob(|APE| < 40 parsec) ", "unit must be one of"),
        ("RPE below 40 mas", "requirement must read like"),
        (f"prob(|APE| < 40 mas) {TAIL}, hopeful", "interpretation must be one of"),
    ],
)
def test_text_that_cannot_be_understood(text: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as raised:
        parse(text if "confidence" in text else text + TAIL)
    assert "\n" not in str(raised.value)


def written(index: str, count: int) -> str:
    """An index with so many times of a second."""
    return f"{index}({', '.join(['1 s'] * count)})" if count else index


def random_requirement(rng: np.random.Generator) -> Requirement:
    """Numbers with all their bits, over the whole range of each."""
    index = str(rng.choice(list(INDICES)))
    return Requirement(
        index,
        str(rng.choice(["", "x", "y"])),
        tuple(float(10.0 ** rng.uniform(-7.0, 8.9)) for _ in range(INDICES[index])),
        float(10.0 ** rng.uniform(-15.0, 3.0)),
        str(rng.choice(list(ANGLES))),
        round(float(rng.uniform(0.01, 0.99)), 6),
        round(float(rng.uniform(0.01, 0.99)), 6),
        str(rng.choice(INTERPRETATIONS)),
        "name",
        ("fsm",),
        bool(index in ("RPE", "RKE") and rng.random() < 0.5),
    )


def test_the_exact_text_is_read_as_the_same_limit_and_times() -> None:
    rng = np.random.default_rng(2)
    for _ in range(300):
        wanted = random_requirement(rng)
        found = parse(wanted.exact_text, wanted.name, wanted.loops)
        assert dataclasses.replace(found, unit=wanted.unit) == wanted
        assert found.unit in (wanted.unit, "rad")
        assert from_entries(entries([found]), "here") == (found,)


def test_the_text_of_its_author_is_quoted_until_the_requirement_is_changed() -> None:
    own = "prob( rms rpe(0.02 s) <= 4.0e1 mas ) >= 99.9999999999 % at 95.0 % confidence"
    made = parse(f"  {own}\n", "fine", ["fsm"])
    assert made.exact_text == own and entries([made])[0]["text"] == own
    changed = dataclasses.replace(made, limit=2 * made.limit)
    assert "4.0e1" not in changed.exact_text and parse(changed.exact_text, "fine", ["fsm"]).limit == changed.limit


@pytest.mark.parametrize("shown", ["20 ms", "999 ms", "1 s", "90 s", "0.001 ms", "2.5 s", "33.3 ms"])
def test_a_time_of_few_digits_stays_as_it_is(shown: str) -> None:
    """Below a second in milliseconds, from a second on in seconds."""
    made = parse(text(f"|RPE({shown})|"))
    assert made.exact_text == text(f"|RPE({shown})|") == str(made)


def test_units_of_times_and_limits() -> None:
    times = {"500 us": 5e-4, "3 ms": 3e-3, "4 s": 4.0, "2 min": 120.0}
    for shown, seconds in times.items():
        assert parse(text(f"|MPE({shown})|")).times == (pytest.approx(seconds, rel=1e-15),)
    for unit, radians in ANGLES.items():
        made = parse(text(limit=f"3 {unit}"))
        assert (made.limit, made.scale, made.unit) == (pytest.approx(3 * radians), radians, unit)
        assert f"< 3 {unit})" in str(made)


@pytest.mark.parametrize("index", INDICES)
def test_each_index_has_its_number_of_times_and_no_other(index: str) -> None:
    for count in range(4):
        quantity = f"|{written(index, count)}|"
        if count == INDICES[index]:
            made = parse(text(quantity))
            assert (made.index, made.times, made.quantity) == (index, (1.0,) * count, quantity)
        else:
            with pytest.raises(InputError, match=f"must have {counted(INDICES[index], 'time')}, got {count}"):
                parse(text(quantity))


@pytest.mark.parametrize("value", ["0", "1", "100 %", "0 %", "1.5", "150 %", "1.2.3"])
def test_probability_and_confidence_are_inside_of_zero_and_one(value: str) -> None:
    for name in ("p", "c"):
        with pytest.raises(InputError, match="must be between 0 and 1"):
            parse(text(**{name: value}))


@pytest.mark.parametrize(("percent", "share"), [("99.7 %", 0.997), ("0.1 %", 0.001), ("99.999 %", 0.99999)])
def test_a_percentage_is_its_share(percent: str, share: float) -> None:
    assert parse(text(p=percent)).probability == pytest.approx(share) == parse(text(p=str(share))).probability
    assert parse(text(c=percent)).confidence == pytest.approx(share) == parse(text(c=str(share))).confidence
    assert f">= {share:g} at " in str(parse(text(p=percent)))
    assert f" at {100 * share:g} % confidence" in str(parse(text(c=percent)))


@pytest.mark.parametrize("limit", ["0 mas", "-1 mas", "1e999 mas", "1.2.3 mas", "e mas"])
def test_a_limit_is_positive_and_finite(limit: str) -> None:
    with pytest.raises(InputError, match="limit must be positive"):
        parse(text(limit=limit))


@pytest.mark.parametrize("time", ["0 s", "1000000000 s", "1.2.3 s", "5", "5 h", "s"])
def test_a_time_is_positive_and_below_a_billion(time: str) -> None:
    with pytest.raises(InputError, match="time must read like '20 ms'"):
        parse(text(f"|RPE({time})|"))
    assert parse(text("|RPE(999999999 s)|")).times == (999999999.0,)
    assert parse(text("|RPE(0.5 s)|")).times == (0.5,)


def test_rms_is_of_windows_and_of_two_indices() -> None:
    for index, count in INDICES.items():
        quantity = written(index, count)
        if index in ("RPE", "RKE"):
            made, other = parse(text(f"rms {quantity}")), parse(text(f"|{quantity}|"))
            assert made.of_windows and not other.of_windows
            assert (made.quantity, other.quantity) == (f"rms {quantity}", f"|{quantity}|")
        else:
            with pytest.raises(InputError, match="index of rms must be one of RPE, RKE"):
                parse(text(f"rms {quantity}"))


def test_what_is_judged_across_runs() -> None:
    for index, count in INDICES.items():
        quantity = f"|{written(index, count)}|"
        for kind in INTERPRETATIONS:
            made = parse(text(quantity, kind=f", {kind}"))
            assert made.across_runs == (kind != "temporal" or index == "PRE")
            assert str(made).endswith(" confidence" if kind == "temporal" else f", {kind}")
        assert parse(text(quantity)).interpretation == "temporal"


def test_a_list_of_entries_holds_what_they_say() -> None:
    made = from_entries(
        [
            {"text": text()},
            {"text": text(), "name": "a", "loop": "fsm"},
            {"text": text(), "loop": ["fsm", "none"]},
            {"text": text(), "loop": ("fsm",)},
        ],
        "here",
    )
    assert [r.name for r in made] == ["APE", "a", "APE", "APE"]
    assert [r.loops for r in made] == [(), ("fsm",), ("fsm", "none"), ("fsm",)]
    assert from_entries(entries(made), "here") == made
    assert from_entries([], "here") == ()
    assert ["loop" in entry for entry in entries(made)] == [False, True, True, True]


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ("text", "must hold a list 'requirement'"),
        ({"name": "a"}, "must hold a list 'requirement'"),
        (
            {"text": text(), "limit": 3},
            r".*\[1\]: unknown parameter 'limit', expected one of: text, name, loop",
        ),
        ({"text": text(), "loops": "fsm"}, r".*\[1\]: unknown parameter 'loops': did you mean loop\?"),
        ({"text": text(), "loop": 3}, "loop must be a name or a list of names, got 3"),
        ({"text": text(), "loop": ["fsm", 3]}, "loop must be a name or a list of names"),
        ({"text": text(), "loop": {"fsm": 1}}, "loop must be a name or a list of names"),
    ],
)
def test_an_entry_of_another_form_is_refused_with_the_name_of_the_list(entry: object, message: str) -> None:
    with pytest.raises(InputError, match=f"^here: {message}"):
        from_entries([{"text": text()}, entry], "here")


@pytest.mark.parametrize("suffix", [".toml", ".yaml", ".YML", ".txt"])
def test_files_of_both_kinds_have_the_same_requirements(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"mine{suffix}"
    if suffix in (".yaml", ".YML"):
        path.write_text(yaml.safe_dump({"requirement": [{"text": text(), "name": "a"}]}))
    else:
        path.write_text(f'[[requirement]]\ntext = "{text()}"\nname = "a"\n')
    assert load(path) == load(str(path)) == (parse(text(), "a"),)


@pytest.mark.parametrize("content", ["", "requirement = []\n", "requirement = 3\n", "[requirement]\na = 1\n"])
def test_a_file_without_the_list_is_refused(content: str, tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(content)
    with pytest.raises(InputError, match="must hold a list 'requirement' whose entries have a 'text'"):
        load(path)
    with pytest.raises(InputError, match="No such file"):
        load(tmp_path / "none.toml")


def test_a_requirement_that_cannot_be_read_is_named_with_its_file(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    first = f'[[requirement]]\ntext = "{text()}"\n[[requirement]]\n'
    path.write_text(first + f'text = "{text("|RPE(20)|")}"\n')
    with pytest.raises(InputError, match=r"mine.toml: requirement\[1\]: time must read like '20 ms', got '20'"):
        load(path)
    path.write_text(first + f'text = "{text()}"\nloop = "fsm_pma"\n')
    assert load(path)[1].loops == ("fsm_pma",)
    with pytest.raises(InputError, match=r"mine.toml: requirement\[1\]: loop must be one of fsm, .*, got 'fsm_pma'"):
        load(path, ("fsm", "fsm+pma"))


def test_a_limit_that_its_unit_cannot_say_is_in_radians() -> None:
    """Some doubles are no double times the unit: the text has them in radians."""
    rng, radians = np.random.default_rng(5), 0
    for _ in range(400):
        limit = float(rng.uniform(1e-9, 2e-9))
        made = dataclasses.replace(parse(text()), limit=limit)
        found = parse(made.exact_text, made.name)
        radians += " rad)" in made.exact_text
        assert found.limit == limit
        value = limit / ANGLES["mas"]
        near = (value, math.nextafter(value, 0.0), math.nextafter(value, math.inf))
        assert (" rad)" in made.exact_text) == (limit not in [x * ANGLES["mas"] for x in near])
    assert 0 < radians < 400
