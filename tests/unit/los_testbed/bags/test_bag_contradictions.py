"""A bag whose content was altered and has right checksums: its digests refute it, and every command says so."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from fuzz.record_mutations import places, put_together, taken_apart
from los_testbed.bags.repair import repair_bag
from los_testbed.config.exit_codes import ExitCode
from support.forged_bags import forge

from pointing_analysis.read.mcap.records import OP_MANIFEST
from pointing_analysis.read.run import Run
from pointing_analysis.requirements.summary import summarise

pytestmark = pytest.mark.usefixtures("without_pictures")


def test_the_altered_messages_are_not_used_and_nothing_is_judged(bag: Path) -> None:
    before = Run.open(bag)["truth/los"]
    forge(bag)
    run = Run.open(bag)
    assert len(run.contradictions) == 1 and run.contradictions[0] in run.problems
    left = run["truth/los"]
    rows = np.searchsorted(before.stamp, left.stamp)
    assert len(left) == 2000 and np.array_equal(left.values, before.values[rows])
    assert len(run["los_estimate"]) == 3000, "what agrees with its checksum is used"
    found = summarise(run)
    assert found.verdicts and {verdict.status for verdict in found.verdicts} == {"not judged"}
    assert all("contradicts its own digests" in verdict.note for verdict in found.verdicts)


@pytest.mark.parametrize("command", ["analyse", "report", "replay", "bag repair"])
def test_each_command_says_it_and_ends_with_its_exit_code(
    bag: Path, call: Callable[..., tuple[int, str, str]], command: str
) -> None:
    forge(bag)
    code, out, err = call(*command.split(), bag, "--json")
    assert code == ExitCode.CONTRADICTION
    content = json.loads(out.splitlines()[-1])
    [text] = (content["runs"][0] if command == "report" else content)["contradictions"]
    assert "does not match the digest in its manifest" in text and text in " ".join(err.split())
    if command in ("analyse", "report"):
        assert text in (bag / "report.html").read_text()


def test_a_budget_takes_no_such_bag(bag: Path, call: Callable[..., tuple[int, str, str]]) -> None:
    forge(bag)
    text = 'unit = "mas"\n[[requirement]]\ntext = "prob(|APE_x| < 10 mas) >= 0.9 at 95 % confidence"\n'
    source = '[sources.a]\ntype = "measured"\nbag = "bag"\ntransient = 0.5\n'
    (bag.parent / "budget.toml").write_text(text + source)
    code, _, err = call("budget", bag.parent / "budget.toml")
    assert code == 2 and "bag must agree with its own digests" in err and err.count("\n") == 1


def test_the_repaired_bag_repeats_it(bag: Path) -> None:
    forge(bag)
    result = repair_bag(bag, bag.parent / "new")
    assert result.contradictions == Run.open(bag).contradictions == Run.open(bag.parent / "new").contradictions
    assert any("truth/los: 1000 of 3000 recorded messages are lost" in text for text in result.sentences())


def test_exchanged_manifests_refute_nothing(bag: Path) -> None:
    file = bag / "bag_0.mcap"
    found = taken_apart(file.read_bytes())
    first, second, *_ = places(found, OP_MANIFEST)
    found[first], found[second] = found[second], found[first]
    file.write_bytes(put_together(found, True))
    run = Run.open(bag)
    assert not run.losses and len(run["truth/los"]) == 3000
