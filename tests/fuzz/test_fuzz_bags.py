"""Damaged bags: nothing but what was recorded, at least what other readers get, an exact report, no better verdict."""

from __future__ import annotations

import resource
import shutil
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from fuzz.fuzz_profile import examples
from fuzz.mutations import MUTATIONS, Content, Key, Mutation, messages, others_find, others_get, without_checksum
from hypothesis import given
from hypothesis import strategies as st
from los_testbed.bags.repair import repair_bag
from los_testbed.config.run_config import RunConfig
from los_testbed.run.loop.simulate import run_in_process
from support.simple_telescope import SimpleTelescope, write_controllers

from pointing_analysis.read.mcap.records import BagError
from pointing_analysis.read.run import Run
from pointing_analysis.requirements.summary import Summary, summarise
from pointing_analysis.requirements.verdict import parse

LIMIT_S, LIMIT_MB = 20.0, 1000.0
REQUIREMENTS = tuple(
    parse(text)
    for text in (
        "prob(|APE| < 10 arcsec) >= 0.5 at 60 % confidence",
        "prob(|RPE(20 ms)| < 400 mas) >= 0.7 at 60 % confidence",
        "prob(|RPE(20 ms)| < 1 mas) >= 0.9 at 90 % confidence",
    )
)


@dataclass(frozen=True)
class Original:
    """The whole bag: its folder, bytes, messages, and verdicts."""

    folder: Path
    data: bytes
    content: dict[Key, Content]
    summary: Summary

    def __repr__(self) -> str:
        return "Original(...)"


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Original:
    folder = tmp_path_factory.mktemp("fuzz")
    config = RunConfig(duration=1.5, mode="inprocess", **write_controllers(folder))
    run_in_process(config, folder / "bag", SimpleTelescope())
    data = (folder / "bag" / "bag_0.mcap").read_bytes()
    found = summarise(Run.open(folder / "bag"), requirements=REQUIREMENTS)
    return Original(folder, data, messages(data), found)


def damaged(original: Original, changes: list[Mutation]) -> Path:
    data = original.data
    for change in changes:
        data = change(data)
    target = original.folder / "damaged"
    shutil.rmtree(target, ignore_errors=True)
    shutil.copytree(original.folder / "bag", target)
    (target / "bag_0.mcap").write_bytes(data)
    return target


@given(changes=st.lists(MUTATIONS, min_size=1, max_size=3))
@examples(15)
def test_repair_gives_what_was_recorded_and_says_what_is_lost(original: Original, changes: list[Mutation]) -> None:
    bag, new = damaged(original, changes), original.folder / "new"
    shutil.rmtree(new, ignore_errors=True)
    start_time = time.process_time()
    others = others_get((bag / "bag_0.mcap").read_bytes(), original.content)
    ours = time.process_time()
    try:
        result = repair_bag(bag, new)
    except BagError:
        assert not others and not new.exists()
        return
    assert time.process_time() - ours < LIMIT_S + (ours - start_time)
    found = messages((new / "new_0.mcap").read_bytes())
    assert all(original.content[key] == content for key, content in found.items())
    if len(found) < others:
        data = (bag / "bag_0.mcap").read_bytes()
        best = max(others_find(data, original.content), key=len)
        others -= without_checksum(data, original.data, best - found.keys())
    assert len(found) >= others
    missing: dict[str, int] = {}
    for topic, _ in original.content.keys() - found.keys():
        missing[topic] = missing.get(topic, 0) + 1
    said = {loss.topic: loss.missing for loss in result.losses}
    known = {topic: count for topic, count in missing.items() if any(topic == key[0] for key in found) or topic in said}
    assert said == known
    assert not any(path.name.startswith(".") for path in original.folder.iterdir())


ORDER = {"not compliant": 0, "not judged": 0, "not enough data": 1, "compliant": 2}


@given(changes=st.lists(MUTATIONS, min_size=1, max_size=3))
@examples(12)
def test_no_verdict_is_better_than_that_of_the_whole_bag(original: Original, changes: list[Mutation]) -> None:
    bag = damaged(original, changes)
    try:
        run = Run.open(bag)
        found = summarise(run, requirements=REQUIREMENTS)
    except BagError:
        return
    for before, after in zip(original.summary.verdicts, found.verdicts):
        assert after.status != "compliant" or before.status == "compliant"
        assert before.status != "compliant" or after.status != "not compliant"
    whole = Run.open(original.folder / "bag")
    for name in run.topics:
        left, all_of_it = run[name], whole[name]
        if not len(left):  # the message that tells how many values the arrays of this topic have is lost
            continue
        rows = np.searchsorted(all_of_it.stamp, left.stamp)
        assert np.array_equal(all_of_it.stamp[rows], left.stamp)
        assert np.array_equal(all_of_it.values[rows], left.values, equal_nan=True)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024 < LIMIT_MB
