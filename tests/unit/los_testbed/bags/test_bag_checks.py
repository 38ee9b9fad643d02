"""Commands ``bag info``, ``verify``, ``sign`` and others on whole, damaged and altered bags, and their exit codes."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from cryptography.hazmat.primitives import serialization as pem
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey
from fuzz.record_mutations import places, put_together, taken_apart
from los_testbed.bags.cdr import codec_for
from los_testbed.bags.repair import repair_bag
from los_testbed.bags.writer import BagWriter
from los_testbed.config.topics import TRUTH_LOS
from support.forged_bags import forge, forge_with_manifest, with_metadata, without_digest

from pointing_analysis.command.exit_codes import ExitCode
from pointing_analysis.indices.synthetic import write_bag
from pointing_analysis.read.mcap.records import OP_CHUNK, OP_MANIFEST, RefutedBagError
from pointing_analysis.read.run import Run
from pointing_analysis.requirements.summary import summarise
from titop_plant.interface import TICK_NS

Call = Callable[..., tuple[int, str, str]]
REFERENCE = Path(__file__).parents[4] / "bags" / "reference"


def told(call: Call, *arguments: object) -> tuple[int, dict[str, Any]]:
    """Exit code and JSON of a command."""
    code, out, _ = call(*arguments, "--json")
    return code, json.loads(out.splitlines()[-1])


def states(content: dict[str, Any]) -> dict[str, str]:
    return {row["name"]: row["state"] for row in content["checks"]}


@pytest.fixture
def keys(tmp_path: Path) -> tuple[Path, Path, Path]:
    """Files of a private key, its public key, and another public key."""
    private, other = Ed25519PrivateKey.generate(), Ed25519PrivateKey.generate()
    form = (pem.Encoding.PEM, pem.PrivateFormat.PKCS8, pem.NoEncryption())
    (tmp_path / "key.pem").write_bytes(private.private_bytes(*form))
    for name, key in (("public.pem", private), ("other.pem", other)):
        content = key.public_key().public_bytes(pem.Encoding.PEM, pem.PublicFormat.SubjectPublicKeyInfo)
        (tmp_path / name).write_bytes(content)
    return tmp_path / "key.pem", tmp_path / "public.pem", tmp_path / "other.pem"


def test_what_is_no_private_key_is_told_in_one_sentence(bag: Path, call: Call, tmp_path: Path) -> None:
    secret = Ed25519PrivateKey.generate().private_bytes(
        pem.Encoding.PEM, pem.PrivateFormat.PKCS8, pem.BestAvailableEncryption(b"x")
    )
    empty = b"-----BEGIN PRIVATE KEY-----\nAAAA\n-----END PRIVATE KEY-----\n"
    for content, found in ((secret, "one with a password"), (empty, "no key that can be decoded")):
        (tmp_path / "key.pem").write_bytes(content)
        code, _, err = call("bag", "sign", bag, "--key", tmp_path / "key.pem")
        assert code == 2 and err.endswith(f"without password, got {tmp_path / 'key.pem'}: {found}\n")


def test_a_whole_bag_is_whole(bag: Path, call: Call) -> None:
    code, content = told(call, "bag", "verify", bag)
    assert code == 0 and content["whole"] and not content["problems"]
    assert set(states(content).values()) == {"agrees", "none"} and states(content)["signature"] == "none"
    assert content["messages"]["/telescope/truth/los"] == 3000
    assert RefutedBagError.code == ExitCode.CONTRADICTION


def test_bags_without_digest_or_manifests_are_read_and_said_to_be_so(bag: Path, call: Call, tmp_path: Path) -> None:
    without_digest(bag)
    code, content = told(call, "bag", "verify", bag)
    assert code == 0 and states(content)["digest of the file"] == "none"
    assert states(content)["digests of chunks"] == "agrees"
    words = " ".join(call("bag", "verify", bag)[1].split())
    assert "complete; no digest can be read at the end of the file: what is beside its chunks" in words
    other = write_bag(tmp_path / "other", {"truth/los": Run.open(REFERENCE)["truth/los"].values})
    code, content = told(call, "bag", "verify", other)
    assert code == 0 and states(content)["digests of chunks"] == "none"


@pytest.mark.parametrize(
    ("attack", "name"), [(forge, "digests of chunks"), (forge_with_manifest, "digest of the file")]
)
def test_an_altered_bag_contradicts_itself(bag: Path, call: Call, attack: Callable[[Path], None], name: str) -> None:
    attack(bag)
    code, content = told(call, "bag", "verify", bag)
    assert code == ExitCode.CONTRADICTION and content["contradictions"] and states(content)[name] == "contradicts"
    assert states(content)["checksums"] == "agrees"


def test_a_chunk_that_checksums_correct_is_damage_and_no_alteration(bag: Path, call: Call) -> None:
    """One bit of the packed data: the manifest has the checksum of each record, by which it is found."""
    file, values = bag / "bag_0.mcap", Run.open(bag)["truth/los"].values.copy()
    data = bytearray(file.read_bytes())
    data[data.find(b"\x28\xb5\x2f\xfd") + 200] ^= 1  # of the first chunk, behind its magic number
    file.write_bytes(bytes(data))
    code, content = told(call, "bag", "verify", bag)
    found = states(content)
    assert code == 1 and found["checksums"] == "damaged" and not content["contradictions"]
    if found["lost messages"] == "agrees":
        assert any("corrected by its checksums" in text for text in content["problems"])
        assert np.array_equal(Run.open(bag)["truth/los"].values, values)


def test_a_damaged_and_a_cut_bag_are_not_whole(bag: Path, call: Call) -> None:
    file = bag / "bag_0.mcap"
    good = file.read_bytes()
    file.write_bytes(good[: len(good) // 2] + bytes(3000) + good[len(good) // 2 + 3000 :])
    code, content = told(call, "bag", "verify", bag)
    assert code == ExitCode.FAILED and not content["contradictions"] and states(content)["checksums"] == "damaged"
    assert states(content)["lost messages"] == "damaged" and content["lost"]
    file.write_bytes(good[: len(good) // 2])
    code, content = told(call, "bag", "verify", bag)
    assert code == ExitCode.FAILED and not content["contradictions"] and states(content)["end of the data"] == "damaged"


def test_other_counts_in_metadata_yaml_contradict_the_file(bag: Path, call: Call) -> None:
    file = bag / "metadata.yaml"
    file.write_text(file.read_text().replace("message_count: 150\n", "message_count: 149\n"))
    code, content = told(call, "bag", "verify", bag)
    assert code == ExitCode.CONTRADICTION and states(content)["counts"] == "contradicts"
    assert any("metadata.yaml counts 149 messages, 150 can be read" in text for text in content["contradictions"])


def test_a_signature_finds_a_digest_made_anew(bag: Path, call: Call, keys: tuple[Path, Path, Path]) -> None:
    private, public, other = keys
    before = (bag / "bag_0.mcap").read_bytes()
    assert told(call, "bag", "verify", bag, "--public-key", public)[0] == ExitCode.CONTRADICTION, (
        "no signature is there"
    )
    assert call("bag", "sign", bag, "--key", private)[0] == 0
    assert (bag / "bag_0.mcap").read_bytes() == before
    assert told(call, "bag", "verify", bag, "--public-key", public)[0] == 0
    assert told(call, "bag", "verify", bag, "--public-key", other)[0] == ExitCode.CONTRADICTION
    forge_with_manifest(bag, digested=True)
    assert told(call, "bag", "verify", bag)[0] == 0, "the digest alone does not find it"
    code, content = told(call, "bag", "verify", bag, "--public-key", public)
    assert code == ExitCode.CONTRADICTION and states(content)["signature"] == "contradicts"


def test_damage_does_not_hide_behind_a_signature(bag: Path, call: Call, keys: tuple[Path, Path, Path]) -> None:
    """A chunk is altered and its manifest destroyed: the digest at the end is still the signed one."""
    private, public, _ = keys
    assert call("bag", "sign", bag, "--key", private)[0] == 0
    forge(bag)
    file = bag / "bag_0.mcap"
    found = taken_apart(file.read_bytes())
    at = places(found, OP_CHUNK)[1] - 1
    found[at] = (found[at][0], bytes(50) + found[at][1][50:])
    file.write_bytes(put_together(found, True))
    code, content = told(call, "bag", "verify", bag, "--public-key", public)
    assert code != 0 and states(content)["signature"] == "damaged"


@pytest.fixture
def split(bag: Path, tmp_path: Path) -> Path:
    """The recording goes on in a second file, as other recorders write it."""
    times = 10**9 * 60 + TICK_NS * np.arange(1500)
    statistics = {node: dict(values) for node, values in Run.open(bag).parameters["statistics"].items()}
    statistics["recorder"]["messages"] = str(int(statistics["recorder"]["messages"]) + len(times))
    with_metadata(bag, statistics=json.dumps(statistics))
    codec = codec_for(TRUTH_LOS)
    messages = [np.frombuffer(bytes(codec.encode(int(time), np.zeros(2))), np.uint8) for time in times]
    with BagWriter(tmp_path / "later", {}) as writer:
        writer.write(TRUTH_LOS.path, times[:900], times[:900], np.array(messages[:900]))
        writer.end_chunk()
        writer.write(TRUTH_LOS.path, times[900:], times[900:], np.array(messages[900:]))
    (tmp_path / "later" / "later_0.mcap").rename(bag / "bag_1.mcap")
    description = yaml.safe_load((bag / "metadata.yaml").read_text())
    about = description["rosbag2_bagfile_information"]
    about["relative_file_paths"] = ["bag_0.mcap", "bag_1.mcap"]
    about["message_count"] += len(times)
    for topic in about["topics_with_message_count"]:
        if topic["topic_metadata"]["name"] == TRUTH_LOS.path:
            topic["message_count"] += len(times)
    (bag / "metadata.yaml").write_text(yaml.safe_dump(description))
    return bag


def exchanged(bag: Path) -> None:
    """The two files change places."""
    (bag / "bag_0.mcap").rename(bag / "other")
    (bag / "bag_1.mcap").rename(bag / "bag_0.mcap")
    (bag / "other").rename(bag / "bag_1.mcap")


def taken_away(bag: Path) -> None:
    (bag / "bag_1.mcap").unlink()


def forged_digest(bag: Path) -> None:
    """The first file with another line of sight, manifest and digest made anew."""
    later = bag / "bag_1.mcap"
    later.rename(bag.parent / "aside")
    forge_with_manifest(bag, digested=True)
    (bag.parent / "aside").rename(later)


@pytest.mark.parametrize("attack", [exchanged, taken_away, forged_digest])
def test_one_signature_binds_all_files_of_a_bag(
    split: Path, call: Call, keys: tuple[Path, Path, Path], attack: Callable[[Path], None]
) -> None:
    private, public, other = keys
    code, content = told(call, "bag", "verify", split)
    assert code == 0, content
    assert call("bag", "sign", split, "--key", private)[0] == 0
    assert [file.name for file in split.glob("*.sig")] == ["bag_0.mcap.sig"]
    code, content = told(call, "bag", "verify", split, "--public-key", public)
    assert code == 0 and states(content)["signature"] == "agrees"
    assert told(call, "bag", "verify", split, "--public-key", other)[0] == ExitCode.CONTRADICTION
    attack(split)
    code, content = told(call, "bag", "verify", split, "--public-key", public)
    assert code == ExitCode.CONTRADICTION and states(content)["signature"] == "contradicts"


@pytest.mark.parametrize("attack", [forge, lambda bag: (bag / "bag_0.mcap").write_bytes(b"\x89MCAP0\r\n")])
def test_what_is_not_whole_is_not_signed(
    bag: Path, call: Call, keys: tuple[Path, Path, Path], attack: Callable[[Path], object]
) -> None:
    attack(bag)
    code, _, err = call("bag", "sign", bag, "--key", keys[0])
    assert code == 2 and "must" in err and not list(bag.glob("*.sig"))


def test_keys_of_other_kinds_are_refused_in_one_line(bag: Path, call: Call, keys: tuple[Path, Path, Path]) -> None:
    private, public, _ = keys
    odd = private.with_name("odd.pem")
    key = X25519PrivateKey.generate()
    odd.write_bytes(key.private_bytes(pem.Encoding.PEM, pem.PrivateFormat.PKCS8, pem.NoEncryption()))
    for option, line in (("--key", "sign"), ("--public-key", "verify")):
        for file in (odd, public if line == "sign" else private, bag / "metadata.yaml", bag / "nothing"):
            code, _, err = call("bag", line, bag, option, file)
            assert code == 2 and err.count("\n") == 1 and f"{option} must be" in err, err


def test_a_run_signs_its_bag(call: Call, made: Path, keys: tuple[Path, Path, Path]) -> None:
    run = ["run", "--mode", "inprocess", "--duration", "3", "--plant", "simple_telescope:SimpleTelescope"]
    run += ["--k-fsm", str(made / "k_fsm.json"), "--k-pma", str(made / "k_pma.json"), "--no-report"]
    code, out, err = call(*run, "--output", "signed", "--sign-key", keys[0])
    assert code == 0 and "signature signed/signed_0.mcap.sig" in out, err
    assert told(call, "bag", "verify", "signed", "--public-key", keys[1])[0] == 0
    code, _, err = call(*run, "--output", "unsigned", "--sign-key", "no.pem")
    assert code == 2 and "--sign-key must be" in err and not Path("unsigned").exists()


def test_info_describes_a_bag_of_this_testbed(bag: Path, call: Call) -> None:
    code, content = told(call, "bag", "info", bag)
    assert code == 0 and (content["start_ns"], content["duration_s"]) == (10**9, 2.999)
    assert content["topics"]["/telescope/camera/los"] == {"type": "geometry_msgs/msg/Vector3Stamped", "messages": 150}
    assert content["messages"] == sum(topic["messages"] for topic in content["topics"].values()) == 24_150
    assert content["run"]["loop"] == "fsm+pma" and content["run"]["seed"] == 1
    assert set(content["hashes"]) == {"parameters_hash"}, "its plant is not the telescope"
    files = Run.open(bag).attachments
    sums = {name: about["sha256"] for name, about in content["attachments"].items()}
    assert sums == {name: hashlib.sha256(data).hexdigest() for name, data in files.items()}
    assert content["sha256"]["bag_0.mcap"] == hashlib.sha256((bag / "bag_0.mcap").read_bytes()).hexdigest()
    _, out, _ = call("bag", "info", bag)
    assert "2.999 s" in out and "/telescope/camera/los" in out and "1970-01-01 00:00:01 UTC" in out


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
