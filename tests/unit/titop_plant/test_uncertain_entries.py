"""Further uncertain factors: isolator and gains, against telescopes that are assembled with the changed values."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from oracles.accurate_response import accurate_response

from lftkit import System
from titop_plant.interface import COLUMNS, COMMANDED, MEASURED
from titop_plant.telescope import assembly
from titop_plant.telescope.assembly import build_telescope
from titop_plant.telescope.control_plant import disturbances_of, with_sensors
from titop_plant.telescope.load import load_telescope
from titop_plant.telescope.tables.uncertain import ENTRIES, spread_of
from titop_plant.telescope.telescope import Telescope

SPREADS = ("isolator.stiffness=10%", "isolator.damping=0.3", "fsm_command.gain=5%", "camera_los.gain=3%")
AT = {"isolator.stiffness": 1.1, "isolator.damping": 0.7, "fsm_command.gain": 0.95, "camera_los.gain": 1.03}
OMEGA = (0.3, 8.0, 90.0, 400.0)


def plant(telescope: Telescope) -> System:
    whole = build_telescope(telescope).system
    outputs = (*MEASURED, "los_controlled")
    return with_sensors(whole, telescope).select(inputs=(*COMMANDED, *disturbances_of(whole)), outputs=outputs)


@pytest.fixture(scope="module")
def uncertain() -> System:
    return plant(load_telescope().with_uncertain(SPREADS))


def test_a_member_is_the_telescope_with_these_values(uncertain: System) -> None:
    reference = load_telescope()
    table = reference.isolator
    isolator = {
        "stiffness": [1.1 * value for value in table.stiffness],
        "damping": [0.7 * value for value in table.damping],
    }
    member, other = uncertain.at(AT), plant(reference.changed({"isolator": isolator})).at({})
    scale_in, scale_out = np.ones(member.D.shape[1]), np.ones(member.D.shape[0])
    scale_in[COLUMNS["fsm_command"]], scale_out[COLUMNS["camera_los"]] = 0.95, 1.03
    for omega in OMEGA:
        found, expected = member.response(omega), scale_out[:, None] * other.response(omega) * scale_in
        size = np.abs(expected).max(axis=1, keepdims=True) + 1e-300
        assert np.abs((found - expected) / size).max() < 1e-6


MODAL = ("body.frequency_2=8%", "body.damping=60%", "payload.frequency_1=5%", "payload.damping_1=50%")


@pytest.mark.parametrize("seed", [1, 2])
def test_a_member_has_the_modes_of_a_telescope_with_these_values(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """At random values: assembled of bodies with other frequencies and damping ratios."""
    system = plant(load_telescope().with_uncertain(MODAL))
    factors = system.parameters[-len(MODAL) :]
    assert [p.name for p in factors] == ["body.damping", *(text.split("=")[0] for text in (MODAL[0], *MODAL[:1:-1]))]
    assert [system.channels.count(p.name) for p in factors] == [35, 2, 1, 2]
    chance = np.random.default_rng(seed)
    values = {p.name: float(chance.uniform(p.lower, p.upper)) for p in factors}
    speeds = {p.name: float(chance.uniform(p.lower, p.upper)) for p in system.parameters if p.name not in values}
    body, payload = assembly.build_body, assembly.build_payload

    def changed(build: Any, name: str, mode: int, dampings: Any) -> Any:
        def own(*asked: Any) -> Any:
            data = build(*asked)
            frequencies, damping = data.frequencies.copy(), data.damping.copy()
            frequencies[mode] *= values[f"{name}.frequency_{mode + 1}"]
            damping[dampings] *= values.get(f"{name}.damping", values.get(f"{name}.damping_{mode + 1}"))
            return dataclasses.replace(data, frequencies=frequencies, damping=damping)

        return own

    monkeypatch.setattr(assembly, "build_body", changed(body, "body", 1, slice(None)))
    monkeypatch.setattr(assembly, "build_payload", changed(payload, "payload", 0, 0))
    member, other = system.at({**values, **speeds}), plant(load_telescope()).at(speeds)
    omega = np.array([0.3, 8.0, 140.0, 340.0, 900.0])
    found, expected = (accurate_response(s.A, s.B, s.C, s.D, omega) for s in (member, other))
    size = np.abs(expected).max(axis=2, keepdims=True) + 1e-300
    assert np.abs((found - expected) / size).max() < 1e-9


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("isolator.stiffness", "ENTRY=SPREAD"),
        ("isolator.damping=nan", "above 0 and at most 0.9"),
        ("payload.frequency_0=5%", r"entry 'payload\.frequency_0' of uncertain: did you mean payload\.frequency_1\?"),
        ("colour=5%", r"entry 'colour' of uncertain, expected one of: .*, payload\.damping, payload\.damping_1$"),
    ],
)
def test_other_entries_are_refused(text: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=message):
        spread_of(text)
    assert spread_of(f"{ENTRIES[0]} = 10%") == (ENTRIES[0], 0.1)


@pytest.mark.parametrize(
    ("texts", "message"),
    [
        (["payload.frequency_37=5%"], "one of the 36 modes, got mode 37"),
        (["payload.damping=50%", "payload.damping_2=20%"], r"must be given without payload\.damping_2"),
    ],
)
def test_modes_that_are_none_or_counted_twice_are_refused(texts: list[str], message: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=message):
        load_telescope().with_uncertain(texts)
    file = tmp_path / "mine.toml"
    file.write_text("base = 'reference'\n[uncertain]\n" + "".join(text.replace("%", "e-2\n") for text in texts))
    with pytest.raises(ValueError, match=rf"mine\.toml.*{message}"):
        load_telescope(file)


SHARED = {
    "solar_array.damping": 0.6,
    "solar_array.frequency_3": 1.05,
    "fsm.stiffness": 1.1,
    "payload.frequency": 0.98,
}


def test_array_modes_mirror_and_all_modes_of_a_body_are_those_of_changed_values(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of a telescope assembled with these numbers; the mirror's torque by a command stays."""
    reference = load_telescope()
    system = plant(reference.with_uncertain([f"{name}=50%" for name in SHARED]))
    arrays = reference.to_mapping()["solar_array"]
    counted = {p.name: system.channels.count(p.name) for p in system.parameters if p.name in SHARED}
    modes = len(arrays["frequencies"]) + len(arrays["further_modes"])
    assert counted == {"fsm.stiffness": 2, "payload.frequency": 72, "solar_array.damping": 2 * modes} | {
        "solar_array.frequency_3": 4
    }
    member = system.at({**SHARED, "wheel_1.speed": 500.0, "solar_array.tau": 0.4})
    first, *others = arrays["further_modes"]
    further = [{**first, "frequency": 1.05 * first["frequency"]}, *others]
    other = reference.changed(
        {
            "solar_array": {"damping": 0.6 * arrays["damping"], "further_modes": further},
            "fsm": {"stiffness": 1.1 * reference.fsm.stiffness},
        }
    )
    build = assembly.build_payload
    monkeypatch.setattr(
        assembly,
        "build_payload",
        lambda *asked: dataclasses.replace(build(*asked), frequencies=0.98 * build(*asked).frequencies),
    )
    whole = plant(other).at({"wheel_1.speed": 500.0, "solar_array.tau": 0.4})
    scale = np.ones(member.D.shape[1])
    scale[COLUMNS["fsm_command"]] = 1.0 / 1.1
    omega = np.array([0.3, 0.8, 8.0, 16.0, 340.0, 900.0])
    found, expected = (accurate_response(s.A, s.B, s.C, s.D, omega) for s in (member, whole))
    expected = expected * scale
    size = np.abs(expected).max(axis=2, keepdims=True) + 1e-300
    assert np.abs((found - expected) / size).max() < 1e-9


@pytest.mark.parametrize(
    ("texts", "message"),
    [
        (["wing.damping=50%"], "must be of one of body, payload, solar_array, got wing"),
        (["solar_array.frequency_2=5%"], r"without a parameter of their own, got that of solar_array\.omega_2"),
        (["solar_array.frequency=5%"], r"got that of solar_array\.omega_1"),
        (["solar_array.damping_7=5%"], "one of the 6 modes, got mode 7"),
    ],
)
def test_other_modes_of_arrays_are_refused(texts: list[str], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        load_telescope().with_uncertain(texts)
