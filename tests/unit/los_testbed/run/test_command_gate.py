"""Nothing invalid passes the gate, everything rejected is counted, silence fades out."""

import numpy as np
import pytest
from los_testbed.bags.cdr import Codec
from los_testbed.run.loop.command_gate import CommandGate

from pointing_analysis.read.messages.message_types import VECTOR3

MS = 1_000_000
LIMIT = 5.3e-3
START = 1_000 * MS


@pytest.fixture
def gate():
    gate = CommandGate(Codec(VECTOR3, 2, "fsm"), LIMIT, hold_ticks=5, fade_ticks=20)
    gate.begin(START)
    return gate


def message(stamp, x=1e-3, y=-2e-3):
    return bytes(Codec(VECTOR3, 2, "fsm").encode(stamp, np.array([x, y])))


def output(gate, now):
    out = np.zeros(2)
    gate.apply(now, out)
    return out


def test_the_command_of_the_tick_before_passes_unchanged(gate):
    assert gate.offer(message(START), START + MS)
    assert gate.fresh(START + MS)
    assert output(gate, START + MS).tolist() == [1e-3, -2e-3]
    assert not gate.rejected


def test_before_the_first_command_the_output_is_zero_and_nothing_is_missed(gate):
    assert gate.fresh(START)
    assert output(gate, START).tolist() == [0, 0]


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (message(START, np.nan), "not_finite"),
        (message(START, np.inf), "not_finite"),
        (message(START, -np.inf), "not_finite"),
        (message(START, 10 * LIMIT), "limit"),
        (message(START, 0.0, -1.0001 * LIMIT), "limit"),
        (message(START + 1), "off_grid"),
        (message(START + MS), "future"),
        (message(START + 50 * MS), "future"),
        (message(START - MS), "duplicate"),
        (message(START - 2 * MS), "late"),
        (message(0), "late"),
        (message(START)[:30], "size"),
        (b"", "encoding"),
        (b"\x00\x00" + message(START)[2:], "encoding"),
    ],
)
def test_an_invalid_command_is_counted_by_reason_and_changes_nothing(gate, data, reason):
    now = START + MS
    assert not gate.offer(data, now)
    assert dict(gate.rejected) == {reason: 1}
    assert not gate.fresh(now)
    assert output(gate, now).tolist() == [0, 0]


def test_values_are_judged_before_stamps(gate):
    """So a count tells what came, not when: NaN in a late message is NaN."""
    for stamp in (START - 2 * MS, START + 50 * MS, START + 1):
        assert not gate.offer(message(stamp, np.nan), START + MS)
        assert not gate.offer(message(stamp, 10 * LIMIT), START + MS)
    assert dict(gate.rejected) == {"not_finite": 3, "limit": 3}


def test_a_late_command_is_used_while_it_is_the_newest_but_is_not_fresh(gate):
    assert gate.offer(message(START), START + 3 * MS)
    assert not gate.fresh(START + 3 * MS)
    assert output(gate, START + 3 * MS)[0] == 1e-3


def test_a_command_older_than_the_hold_time_is_late(gate):
    assert not gate.offer(message(START), START + 7 * MS)
    assert gate.rejected["late"] == 1


def test_silence_is_held_then_faded_smoothly_to_zero_and_back(gate):
    gate.offer(message(START), START + MS)
    held = [output(gate, START + k * MS)[0] for k in range(1, 7)]
    assert held == [1e-3] * 6  # fresh, then five ticks of holding
    fading = np.array([output(gate, START + k * MS)[0] for k in range(7, 40)])
    assert gate.fading
    assert np.all(np.diff(fading) <= 0)
    assert fading[-1] == 0
    # raised cosine over 20 ticks: no step larger than pi / 2 / 20 of the command
    steps = np.abs(np.diff(np.concatenate([[1e-3], fading])))
    assert steps.max() <= 1e-3 * np.pi / 40 * 1.001
    back = []
    for k in range(40, 70):
        assert gate.offer(message(START + (k - 1) * MS), START + k * MS)
        back.append(output(gate, START + k * MS)[0])
    assert back[-1] == 1e-3
    assert not gate.fading
    assert np.abs(np.diff([0.0, *back])).max() <= 1e-3 * np.pi / 40 * 1.001
