"""Strangers beside runs in lockstep: ``make attacks MINUTES=30 SEED=0`` or ``make attacks CASES=200 SEED=0``.

    PYTHONPATH=tests python tests/support/attack_campaign.py [--minutes=10] [--cases=200] [--seed=0]

It ends after so many minutes or cases. The seed is that of the first case, random without the option, and the next case
has the next one: each seed gives a case: topic or service, name, stamps, rate, size and time of
arrival of a stranger. The bag of the run beside it is compared with that of an undisturbed run of the same seed,
message by message, and the counts of the run with those of that one. Outcomes:

- unchanged: the same messages and counts, and whoever sent on a topic of the loop is reported;
- told: the same messages up to a request that changed, ended or began the run again, and the bag tells who asked (of a
  transition of the life cycle: that somebody did);
- refused: the run did not begin or did not end, with a line that names the stranger or its topic.

All others are found errors: falsified (another message or count), silent (no line about messages that were refused),
unnamed (an end without the reason), hung. A table of the outcomes is printed at the end, also when a signal ends the
campaign. Exit code: 0 without errors, 1 with errors, 130 without errors until a signal came.

The nodes and the stranger are copies of one process that has their imports (`node_template`), each a process of its
own as ever: a case is a fifth of a start of Python, and the time goes into the run.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import random
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import attacker
from attacker import CLOCK, EARLY, REQUESTS, SERVICES, SILENT, STAMPS, Attacker, Case
from los_testbed.bags.cdr import stamp_of
from los_testbed.config.topics import NODES, PROGRESS_TOPIC, TOPICS, TRUTH_LOS
from los_testbed.nodes.support.requesters import UNKNOWN
from los_testbed.run.processes import node_process
from los_testbed.run.results import Results, RunError
from los_testbed.run.runner import Runner
from mcap.reader import make_reader
from node_template import NodeTemplate
from ros_runs import PLANT, config_for

from pointing_analysis.read.run import Run
from titop_plant.interface import TICK_NS

DURATION = 0.6
LIMIT_S = 150
"""Wall time of a run; an undisturbed one takes some seconds."""

NAMES = ("stranger", "/"), *((name, "/telescope") for name in NODES)
LOOP = tuple(topic.name for topic in TOPICS)
OTHERS = PROGRESS_TOPIC, "plant/diagnostics", "recorder/diagnostics"
OWNERS = {topic.name: topic.publisher for topic in TOPICS} | {name: name.split("/")[0] for name in OTHERS}
GOOD = "unchanged", "told", "refused"

Messages = dict[str, list[bytes]]


class HungError(Exception):
    """A run took longer than its limit."""


def case_of(seed: int) -> Case:
    """The case of a seed."""
    chance = random.Random(seed)
    topic = chance.choice([*LOOP, *LOOP, *OTHERS, *OTHERS, *SERVICES, CLOCK, SILENT])
    name, space = chance.choice(NAMES)
    if topic in OWNERS and chance.random() < 0.3:
        name, space = OWNERS[topic], "/telescope"
    service = topic in SERVICES
    return Case(
        topic=topic,
        name="stranger" if service else name,
        namespace="/" if service else space,
        stamps=chance.choice(STAMPS),
        rate=chance.choice([5.0, 50.0]) if service else chance.choice([10 ** chance.uniform(1.0, 3.9), 1000.0]),
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
    if not ticks and not results.earlier and (set(found) != set(expected) or counts_of(results) != counted(expected)):
        return "falsified"
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
    topic, said = f"/telescope/{case.topic}", (*results.warnings, *results.failures)
    if case.topic in LOOP and int(recorder.get(f"foreign_{topic}", 0)) and topic not in " ".join(said):
        return "silent"
    return "told" if ticks or results.earlier else "unchanged"


def counts_of(results: Results) -> tuple[int, int, int]:
    """Ticks, recorded messages and lost samples that a run tells of itself."""
    recorder = results.statistics["recorder"]
    ticks = results.statistics["plant"]["ticks"]
    return int(ticks), int(recorder["messages"]), int(recorder["samples_lost"])


def counted(expected: Messages) -> tuple[int, int, int]:
    """The same, counted in the bag of an undisturbed run."""
    return len(expected[f"/telescope/{TRUTH_LOS.name}"]), sum(len(found) for found in expected.values()), 0


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


def main(cases: int, first: int = 0, minutes: float = math.inf) -> int:
    """Perform the cases of some seeds until there are so many, the time is over or a signal comes; the exit code."""
    came: list[int] = []
    signal.signal(signal.SIGALRM, _hang)
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda number, _: came.append(number))
    begin, table, errors = time.monotonic(), dict[str, Counter[str]](), list[int]()
    with tempfile.TemporaryDirectory() as scratch:
        expected = messages_of(run_beside(_folder(scratch, "undisturbed"), None).bag or Path())
        for seed in range(first, first + cases) if cases else itertools.count(first):
            if came or time.monotonic() > begin + 60 * minutes:
                break
            case, folder = case_of(seed), _folder(scratch, str(seed))
            kind, said = judge(folder, case, expected)
            shutil.rmtree(folder)
            table.setdefault(kind_of(case), Counter())[kind] += 1
            if kind not in GOOD:
                errors.append(seed)
            sys.stdout.write(f"{seed} {kind}: {case}: {said}\n")
            sys.stdout.flush()
    sys.stdout.write(text_of(table))
    words = f"seeds of errors: {errors}" if errors else "nothing found"
    if came:
        words += f"; ended by {signal.Signals(came[0]).name} before the time was over"
    done, took = sum(row.total() for row in table.values()), (time.monotonic() - begin) / 60
    sys.stdout.write(f"first seed {first}, {done} cases in {took:.1f} min: {words}\n")
    return 1 if errors else 130 if came else 0


def kind_of(case: Case) -> str:
    """Row of the table that a case is counted in."""
    if case.topic in SERVICES:
        return "requests"
    if case.topic in (CLOCK, SILENT):
        return case.topic
    own = case.topic in OWNERS and case.node == f"/telescope/{OWNERS[case.topic]}"
    return f"{'topics of the loop' if case.topic in LOOP else 'progress and reports'}, {'own' if own else 'other'} name"


def text_of(table: dict[str, Counter[str]]) -> str:
    """How many cases of each kind had each outcome."""
    outcomes = [*GOOD, *sorted({kind for row in table.values() for kind in row} - set(GOOD))]
    lines = [f"\n{'stranger':34}{'cases':>10}" + "".join(f"{kind:>12}" for kind in outcomes)]
    for name, row in [*sorted(table.items()), ("all", sum(table.values(), Counter[str]()))]:
        lines.append(f"{name:34}{row.total():10d}" + "".join(f"{row[kind]:12d}" for kind in outcomes))
    return "\n".join(lines) + "\n"


def _folder(parent: str, name: str) -> Path:
    folder = Path(parent, name)
    folder.mkdir()
    return folder


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--cases", type=int, default=0)
    parser.add_argument("--minutes", type=float, default=math.inf)
    parser.add_argument("--seed", type=int, default=random.SystemRandom().randrange(10**6))
    given = parser.parse_args()
    copies = NodeTemplate()
    for module in (node_process, attacker):
        module.subprocess = copies  # type: ignore[attr-defined]
    try:
        code = main(given.cases, given.seed, given.minutes)
    finally:
        copies.close()
    sys.exit(code)
