"""Strangers beside runs in lockstep: ``make attacks CASES=200 SEED=0``.

    PYTHONPATH=tests python tests/support/attack_campaign.py CASES [FIRST_SEED [MINUTES]]

Each seed gives a case: topic or service, name, stamps, rate, size and time of arrival of a stranger. The bag of the run
beside it is compared with that of an undisturbed run of the same seed, message by message. Outcomes:

- unchanged: the same messages, and whoever sent on a topic of the loop is reported;
- told: the same messages up to a request that changed, ended or began the run again, and the bag tells who asked (of a
  transition of the life cycle: that somebody did);
- refused: the run did not begin or did not end, with a line that names the stranger or its topic.

All others are found errors: falsified (another message), silent (no line about messages that were refused), unnamed (an
end without the reason), hung. Exit code: 0 without errors, else 1.
"""

from __future__ import annotations

import json
import random
import signal
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from attacker import EARLY, REQUESTS, SERVICES, STAMPS, Attacker, Case
from los_testbed.bags.cdr import stamp_of
from los_testbed.nodes.support.requesters import UNKNOWN
from los_testbed.run.results import Results, RunError
from los_testbed.run.runner import Runner
from los_testbed.topics import PROGRESS_TOPIC, TOPICS
from mcap.reader import make_reader
from ros_runs import PLANT, config_for

from pointing_analysis.read.run import Run
from titop_plant.interface import TICK_NS

DURATION = 0.6
LIMIT_S = 150
"""Wall time of a run; an undisturbed one takes some seconds."""

NAMES = ("stranger", "/"), ("plant", "/telescope"), ("controller", "/telescope"), ("recorder", "/telescope")
LOOP = tuple(topic.name for topic in TOPICS)
OTHERS = PROGRESS_TOPIC, "plant/diagnostics", "recorder/diagnostics"
GOOD = "unchanged", "told", "refused"

Messages = dict[str, list[bytes]]


class HungError(Exception):
    """A run took longer than its limit."""


def case_of(seed: int) -> Case:
    """The case of a seed."""
    chance = random.Random(seed)
    topic = chance.choice([*LOOP, *LOOP, *OTHERS, *OTHERS, *SERVICES])
    name, space = chance.choice(NAMES)
    service = topic in SERVICES
    return Case(
        topic=topic,
        name="stranger" if service else name,
        namespace="/" if service else space,
        stamps=chance.choice(STAMPS),
        rate=chance.choice([5.0, 50.0]) if service else 10 ** chance.uniform(1.0, 3.9),
        size=0 if service else chance.choice([0, 0, 0, 0, -1, -20, -30, 4, 1000, 60_000]),
        begin=EARLY if chance.random() < 0.3 else chance.randint(0, 300),
        seconds=chance.choice([0.5, 2.0, 4.0]),
        request=chance.choice(REQUESTS[topic]) if service else "",
    )


def messages_of(bag: Path) -> Messages:
    """Bytes of all messages, topic by topic in order."""
    found: Messages = {}
    with next(bag.glob("*.mcap")).open("rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages(log_time_order=False):
            found.setdefault(channel.topic, []).append(message.data)
    return found


def run_beside(folder: Path, case: Case | None) -> Results:
    """Results of a run in lockstep, beside a stranger or alone."""
    config = config_for(folder, duration=DURATION, mode="lockstep", start_timeout=40.0)
    stranger = None if case is None else Attacker(config.domain, case)
    signal.alarm(LIMIT_S)
    try:
        return Runner(config, commands={"plant": PLANT}).run()
    finally:
        signal.alarm(0)
        if stranger is not None:
            stranger.close()


def outcome(case: Case, results: Results, expected: Messages) -> str:
    """What became of a run that came to its end."""
    assert results.bag is not None
    found = messages_of(results.bag)
    ticks = changed_by(case, results)
    same = expected if not ticks else before(expected, min(ticks))
    for topic, messages in same.items():
        own = found.get(topic, [])
        if own != messages and (not ticks or own[: len(messages)] != messages):
            return "falsified"
    for bag in results.earlier:  # each until a reset
        found = messages_of(bag)
        if any(found.get(topic, []) != messages[: len(found.get(topic, []))] for topic, messages in expected.items()):
            return "falsified"
        if case.node not in Run.open(bag).parameters["statistics"]["plant"].get("changes", ""):
            return "silent"
    recorder = results.statistics["recorder"]
    topic = f"/telescope/{case.topic}"
    if case.topic in LOOP and int(recorder.get(f"foreign_{topic}", 0)) and topic not in " ".join(results.failures):
        return "silent"
    return "told" if ticks or results.earlier else "unchanged"


def changed_by(case: Case, results: Results) -> list[int]:
    """Ticks of the changes that the bag tells to be of the stranger."""
    names = {case.node, UNKNOWN} if case.topic.endswith("change_state") else {case.node}
    told = [json.loads(values.get("changes", "[]")) for values in results.statistics.values()]
    return [int(row["tick"]) for rows in told for row in rows if case.topic in SERVICES and row.get("by") in names]


def before(expected: Messages, tick: int) -> Messages:
    """Messages of the ticks before this one."""
    end = min(stamp_of(data) for data in expected[f"/telescope/{TOPICS[0].name}"]) + tick * TICK_NS
    return {topic: [data for data in messages if stamp_of(data) < end] for topic, messages in expected.items()}


def judge(folder: Path, case: Case, expected: Messages) -> tuple[str, str]:
    """Outcome of a case, and what was said."""
    try:
        results = run_beside(folder, case)
    except HungError:
        return "hung", ""
    except (RunError, ValueError) as error:
        named = any(name in str(error) for name in (case.node, case.topic, *case.topic.split("/change_state")[:-1]))
        return ("refused" if named else "unnamed"), str(error)
    return outcome(case, results, expected), "; ".join([*results.warnings, *results.failures])


def _hang(number: int, frame: object) -> None:
    raise HungError


def main(cases: int, first: int = 0, minutes: float = 1e9) -> int:
    """Perform the cases of some seeds; the exit code."""
    signal.signal(signal.SIGALRM, _hang)
    end, counts, errors = time.monotonic() + 60 * minutes, Counter[str](), []
    with tempfile.TemporaryDirectory() as scratch:
        expected = messages_of(run_beside(_folder(scratch, "undisturbed"), None).bag or Path())
        for seed in range(first, first + cases):
            if time.monotonic() > end:
                break
            case = case_of(seed)
            kind, said = judge(_folder(scratch, str(seed)), case, expected)
            counts[kind] += 1
            if kind not in GOOD:
                errors.append(seed)
            sys.stdout.write(f"{seed} {kind}: {case}: {said}\n")
            sys.stdout.flush()
    table = ", ".join(f"{kind} {count}" for kind, count in counts.most_common())
    sys.stdout.write(f"{sum(counts.values())} cases: {table}; seeds of errors: {errors or 'none'}\n")
    return 1 if errors else 0


def _folder(parent: str, name: str) -> Path:
    folder = Path(parent, name)
    folder.mkdir()
    return folder


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]), *(int(text) for text in sys.argv[2:])))
