"""Settings that change at a tick: order, checks, plant and controller that they act on, sentences about requests."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.run_parts import build_controller
from los_testbed.run.change_requests import SHOWN, requested
from los_testbed.run.loop.changes import NAMES, Changes, parse_change
from support.loop_rows import COMMANDS, MEASUREMENTS

from fsm_pma_controller.fade import FADE_TICKS, Fade
from titop_plant.interface import FORCES, MIRROR, STAGES, TICK_NS, TRUTH
from titop_plant.simulation.constant_step import ConstantStep
from titop_plant.simulation.plant import Plant
from titop_plant.simulation.plant_step import whole_step
from titop_plant.simulation.sensor_samples import SensorModel


def recording():
    """Changes of a plant and what was applied, with the tick at which it was."""
    applied = []
    changes = Changes(RunConfig(), {n: lambda value, n=n: applied.append((n, value)) for n in NAMES["plant"]})
    return changes, applied


def test_changes_apply_in_the_order_of_their_ticks_and_are_recorded():
    changes, applied = recording()
    changes.request("camera_dropout", 0.5, at=0.003)
    changes.request("noise", False, at=0.001)
    changes.request("disturbance", False)
    counts = []
    for tick in range(5):
        changes.advance(tick * TICK_NS)
        counts.append(len(applied))
    assert counts == [1, 2, 2, 3, 3]
    assert applied == [("disturbance", False), ("noise", False), ("camera_dropout", 0.5)]
    assert [row["tick"] for row in json.loads(changes.record()["changes"])] == [0, 1, 3]


@pytest.mark.parametrize(
    ("name", "value", "at", "reason"),
    [
        ("seed", 2, None, "name must be a setting that this node can change"),
        ("camera_dropout", 10**400, None, "camera_dropout must be between 0 and 1, got inf"),
        ("stop", False, None, "stop must be true, got False"),
    ],
)
def test_what_does_not_fit_is_refused_and_changes_nothing(name, value, at, reason):
    changes, applied = recording()
    changes.advance(10 * TICK_NS)
    with pytest.raises(ValueError, match=reason):
        changes.request(name, value, at)
    changes.advance(11 * TICK_NS)
    assert not applied


@pytest.mark.parametrize(
    "text",
    [
        "[]",
        '{"name": "loop"}',
        '{"name": "loop", "value": "fsm", "when": 1}',
        '{"name": "loop", "value": "fsm", "at": -1}',
        '{"name": "loop", "value": "fsm", "at": NaN}',
        "[" * 100_000,
        '{"name": "loop", "value": ' + "9" * 5000 + "}",
    ],
    ids=range(7),
)
def test_a_fault_that_is_no_change_is_refused(text):
    with pytest.raises(ValueError, match="must be"):
        parse_change(text)


def small_plant(dropout=0.0):
    """Measurement 20 is the sine of one tone; no dynamics."""
    matrix = np.zeros((MEASUREMENTS + TRUTH, COMMANDS + 2))
    matrix[20, COMMANDS + 1] = 1.0
    sensors = SensorModel(np.full(MEASUREMENTS, 0.1), np.zeros(MEASUREMENTS), 2, dropout, 3)
    step = whole_step(matrix, np.exp(1j * np.array([0.3])), 0)
    return Plant(ConstantStep(step, np.zeros(0), np.array([300.0])), sensors, np.ones(COMMANDS))


def outputs(plant, changes, ticks=100):
    """Measurements when `changes` (tick to name and value) are made."""
    y, truth, rows = np.zeros(MEASUREMENTS), np.zeros(TRUTH), []
    for tick in range(ticks):
        if tick in changes:
            plant.change(*changes[tick])
        plant.step(np.zeros(COMMANDS), y, truth)
        rows.append(y.copy())
    return np.array(rows)


def test_the_plant_without_noise_and_with_it_again_is_the_same_from_then_on():
    whole, cut = outputs(small_plant(), {}), outputs(small_plant(), {30: ("noise", 0), 60: ("noise", 1)})
    same = np.r_[0:30, 60:100]
    assert np.array_equal(whole[same], cut[same], equal_nan=True)
    assert np.allclose(cut[30:60, 20], np.sin(0.3 * np.arange(30, 60)))


def test_a_change_of_the_stage_does_not_step_a_command():
    """From tick to tick it changes by no more than the steepest part of the fade, and the law's own change."""
    controller, kept = build_controller(RunConfig()), build_controller(RunConfig())
    rng = np.random.default_rng(4)
    found, whole = np.zeros((400, COMMANDS)), np.zeros((400, COMMANDS))
    for k in range(400):
        estimate, accel = np.full(2, 1e-5), 1e-3 * np.sin(0.05 * k + np.arange(6))
        if k % 13 == 5:  # within the fade of the change before
            controller.switch(str(rng.choice(STAGES)))
        controller.step(estimate, accel, found[k])
        kept.step(estimate, accel, whole[k])
    steepest = 0.5 * np.pi / FADE_TICKS
    for part in (MIRROR, FORCES):
        steps = np.abs(np.diff(found[:, part], axis=0)).max()
        assert (
            0
            < steps
            <= 1.01 * (steepest * np.abs(whole[:, part]).max() + np.abs(np.diff(whole[:, part], axis=0)).max())
        )


def test_the_controller_opens_and_closes_loops_and_limits_at_the_next_step():
    controller = build_controller(RunConfig())
    estimate, accel, u, v = np.full(2, 1e-5), np.full(6, 1e-3), np.zeros(COMMANDS), np.zeros(COMMANDS)
    for stage, mirror, forces in (("fsm+pma", 1, 1), ("isolator", 0, 0), ("fsm", 1, 0), ("fsm+pma", 1, 1)):
        controller.switch(stage)
        fresh = build_controller(RunConfig())
        for _ in range(FADE_TICKS):
            controller.step(estimate, accel, u)
            fresh.step(estimate, accel, v)
        assert (np.any(u[MIRROR]), np.any(u[FORCES])) == (mirror, forces)
    assert np.array_equal(u, v), "K_PMA starts from its zero state"
    controller.limit(fsm_authority=1e-6)
    controller.step(np.full(2, 1e-3), accel, u)
    assert np.abs(u[MIRROR]).max() == 1e-6


def run(**changes):
    """A run whose nodes tell these changes."""
    statistics = {node: {"changes": json.dumps(rows)} for node, rows in changes.items()}
    return SimpleNamespace(parameters={"statistics": statistics})


def row(tick, name, value, by="/stranger"):
    return {"tick": tick, "name": name, "value": value, "by": by}


def test_requests_are_told_in_order_of_time_with_their_senders():
    plant = [row(100, "noise", False), row(9100, "stop", True)]
    controller = [row(50, "loop", "fsm", "/user"), row(60, "active", False)]
    assert requested(run(plant=plant, controller=controller)) == (
        'loop set to "fsm" by request at 0.05 s, from /user',
        "controller deactivated by request at 0.06 s, from /stranger",
        "noise set to false by request at 0.1 s, from /stranger",
        "stopped by request at 9.1 s, from /stranger",
    )
    many = requested(run(plant=[row(k, "noise", False) for k in range(50)] + [row(99, "reset", True)]))
    assert len(many) == SHOWN + 2, "the first ones and the last"
    assert many[SHOWN:] == (f"{50 - SHOWN} more changes by request", "reset by request at 0.099 s, from /stranger")


@pytest.mark.parametrize("text", ["", "[", "[" * 100_000, '[{"by": 1, "name": "stop", "tick": 3}]', {}])
def test_what_is_no_list_of_changes_is_named(text):
    """One without a value, a text or an object in the place of the list."""
    found = requested(SimpleNamespace(parameters={"statistics": {"plant": {"changes": text}}}))
    assert [said.startswith("changes of the node plant must be a list") for said in found] == [True]
    assert requested(SimpleNamespace(parameters={"statistics": text})) == ()


def test_a_fade_is_smooth_both_ways_and_can_turn_round():
    fade = Fade(20)
    assert fade.whole
    fade.turn(False)
    down = [fade.weight() for _ in range(12)]
    fade.turn(True)
    up = [fade.weight() for _ in range(12)]
    assert fade.whole
    weights = np.array([1.0, *down, *up])
    assert np.abs(np.diff(weights)).max() <= np.pi / 40
    assert down == sorted(down, reverse=True) and up == sorted(up)
