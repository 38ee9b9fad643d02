"""Damaged files, hostile names and odd numbers: one line, exit code 2 or a verdict, never a traceback."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml

from los_design.synthesis.store import design_file
from pointing_analysis.indices.synthetic import write_bag
from pointing_analysis.read.mcap.bag_metadata import METADATA_NAME
from pointing_analysis.read.run import Run

pytestmark = pytest.mark.usefixtures("without_pictures")

Call = Callable[..., tuple[int, str, str]]


def one_line(err: str) -> bool:
    return (
        err.startswith("los-testbed: ") and err.count("\n") == 1 and "Traceback" not in err and "unexpected" not in err
    )


@pytest.mark.parametrize(
    "info",
    [
        None,
        "text",
        {"relative_file_paths": None},
        {"relative_file_paths": [3]},
        {"relative_file_paths": {"a": 1}},
        {"relative_file_paths": ["../outside.mcap"]},
        {"relative_file_paths": ["a\0b"]},
        {"relative_file_paths": ["x" * 300]},
        {"relative_file_paths": ["\ud800"]},
        {"relative_file_paths": ["bag_0.mcap", "bag_0.mcap"]},
    ],
    ids=str,
)
def test_an_odd_metadata_yaml_is_told_and_the_file_beside_it_read(bag: Path, info: object) -> None:
    text = yaml.safe_dump({"rosbag2_bagfile_information": info})
    (bag / "metadata.yaml").write_text(text)
    run = Run.open(bag)
    assert len(run["truth/los"]) == 3000
    odd = not isinstance(info, dict) or "relative_file_paths" in info
    assert any("metadata.yaml" in problem for problem in run.problems) == odd


def parameters(path: Path, **values: object) -> Path:
    los = [[1e-9 * i, 0.0] for i in range(3000)]
    return write_bag(path, {"truth/los": los}, parameters=values)


ODD_STATISTICS = [7, [1], {"plant": {"ticks": "many"}}, {"plant": {"ticks": "1e999", "missed_ticks": "nan"}}]


@pytest.mark.parametrize("value", ODD_STATISTICS, ids=str)
def test_statistics_of_another_type_are_left_out(call: Call, tmp_path: Path, value: object) -> None:
    code, out, err = call("analyse", parameters(tmp_path / "odd", statistics=value, loop="fsm"), "--json")
    assert (code, err.count("Traceback")) == (0, 0)
    assert json.loads(out.splitlines()[-1])["ticks"] == 3000


@pytest.mark.further
def test_every_command_prints_names_with_brackets_as_they_are(call: Call, bag: Path, tmp_path: Path) -> None:
    """Topics of a bag, sources of a budget, folders of outputs."""
    from mcap.writer import Writer

    (tmp_path / "[").mkdir()

    with (tmp_path / "[/topic].mcap").open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2")
        schema = writer.register_schema("a/msg/[/b]", "ros2msg", b"float64 x\nfloat64 y\n")
        channel = writer.register_channel("/[/red]:x:\x1b[31m", "cdr", schema)
        for i in range(30):
            writer.add_message(channel, i * 10**7, b"\0\1\0\0" + bytes(16), i * 10**7, i)
        writer.finish()
    code, out, err = call("bag", "topics", "[/topic].mcap")
    assert code == 0 and "/[/red]:x:" in out and "topic].mcap" in out and "\x1b" not in out, err
    budget = (Path(__file__).parents[4] / "pointing_analysis" / "budget" / "budget_testbed.toml").read_text()
    (tmp_path / "b.toml").write_text(budget.replace("[sources.loop]", '[sources."[/red]"]'))
    code, out, err = call("budget", "b.toml", "--output=[/b].html")
    assert code == 0 and "[/red]" in out and "[/b].html" in out, err
    code, out, err = call("bag", "repair", bag, "--output=[/red]new")
    assert code == 0 and "[/red]new" in out.replace("\n", ""), err


RUN = ["run", "--mode=inprocess", "--duration=2"]
CERTIFY = ["design", "certify", "--output=new"]
SHIPPED = design_file("k-fsm")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["analyse", "{bag}", "--transient=1e308"], ["--transient", "1e+308"]),
        (["report", "{bag}", "--from=nan"], ["--from", "nan"]),
        (["report", "{bag}", "--from=2", "--to=1"], ["--to", "--from = 2"]),
        (["control", "start", "--timeout=nan"], ["--timeout", "nan"]),
        (["control", "start", "--domain=999"], ["domain", "232", "999"]),
        (["control", "stage", "[/x]"], ["loop", "[/x]"]),
        (["control", "fault", "noise", "2020-01-01"], ["VALUE", "2020-01-01"]),
        (["control", "fault", "noise", "9" * 400], ["VALUE", "digits"]),
        (["replay", "{bag}", "--domain=999"], ["domain", "232", "999"]),
        (["replay", "{bag}", "--domain=" + "9" * 400], ["domain must be between 0 and 232", "got 999"]),
        (["replay", "{bag}", "--to-ros", "--timeout=inf"], ["--timeout", "inf"]),
        (["run", "--set=seed=.inf"], ["seed", "inf"]),
        (["run", "--set=seed=1.5"], ["seed", "whole number", "1.5"]),
        (["run", "--set=seed"], ["NAME=VALUE", "'seed'"]),
        (["run", "--set=durtion=1"], ["unknown parameter 'durtion'", "duration"]),
        (["run", "--duration=0.0015"], ["whole number of milliseconds"]),
        (["run", "--set=loop=pma"], ["loop", "none, isolator, fsm, fsm+pma", "'pma'"]),
        (["run", "--set=noise=1"], ["noise", "true or false", "1"]),
        (["run", "--no-such-option"], ["--no-such-option"]),
        (["run", "--set=wheel_speed=" + "[" * 100], ["wheel_speed", "nested"]),
        (["run", "--output={bag}"], ["exists already"]),
        (["run", "--output=" + "x" * 300], ["name of at most"]),
        (["campaign", "--samples=99999999999"], ["--samples", "99999999999"]),
        (["stages", "--samples=-1"], ["--samples", "-1"]),
        (["design", "k-fsm", "--time-limit=nan"], ["--time-limit", "nan"]),
        (["design", "k-fsm", "--output=no/such/folder/k.json"], ["folder of --output", "no/such"]),
        (["analyse", "{bag}", "--output={bag}"], ["must be a file"]),
        (["plant", "figures", "--output={bag}/metadata.yaml"], ["must be a folder"]),
        (["design", "figures", "--output={bag}/metadata.yaml"], ["must be a folder"]),
        (["design", "figures", "--samples=-1"], ["--samples", "-1"]),
        (["design", "k-fsm", "--loop-delay=-1"], ["--loop-delay must be between 0 and 1 s, got -1"]),
        (["design", "k-fsm", "--output=k.csv"], ["--output must end in .json, got k.csv"]),
        (["export", "fmu", "--output=unit.zip"], ["--output must end in .fmu, got unit.zip"]),
        (["budget", "--output=b.docx"], ["--output must end in .html or .htm, got b.docx"]),
        (["design", "k-fsm"], ["--output must be given: a file for the design"]),
        (["design", "all"], ["--output must be given: a folder for the designs"]),
        (["design", "k-fsm", f"--output={SHIPPED}"], ["--output must not be a shipped design"]),
        (["design", "all", f"--output={SHIPPED.parent}"], ["--output must not be a shipped design"]),
        (["design", "k-fsm", "--order=9"], ["--order must be between 0 and 8, got 9"]),
        (["design", "k-pma", "--order=3"], ["order must be 4 with a loop delay, at least 0 without, got 3"]),
        (["design", "verify", "--samples=-3"], ["--samples must be between 0 and 1e+06, got -3"]),
        ([*CERTIFY, "--stage=isolator"], ["--stage"]),
        ([*CERTIFY, "--stage=fsm", "--figure=force"], ["--figure"]),
        ([*CERTIFY, "--level=0"], ["--level"]),
        ([*CERTIFY, "--scheduler=tcp://127.0.0.1:1", "--tls-ca-file=ca.pem"], ["tls"]),
        ([*CERTIFY, "--gap=nan"], ["--gap"]),
        ([*CERTIFY, "--time-limit=-1"], ["--time-limit"]),
        (["stages", "--scenario=storm"], ["design", "both", "storm"]),
        (["stages", "--k-fsm=none.json"], ["none.json"]),
        (["campaign", "--samples=0"], ["samples must be 1 or more, got 0"]),
        (["campaign", "--depth=deep"], ["depth must be one of time, model, got 'deep'"]),
        (["campaign", "--duration=0.015"], ["duration must be at least the window of 0.02 s, got 0.015 s"]),
        (["campaign", "--resume"], ["--output must be given with --resume, got none"]),
        (["campaign", "--scenario=ramp"], ["design, imbalance, worst_case or none in a campaign, got ramp"]),
        (["campaign", "--designs=none"], ["designs must hold k_fsm.json and k_pma.json, got no none"]),
        ([*RUN, "--theta=1", "--tau=0.1"], ["theta or tau", "got both"]),
        ([*RUN, "--wheel-speed", "1", "2", "-3", "2000"], ["wheel_speed (wheel 4)", "-1047.2 and 1047.2 rad/s"]),
        ([*RUN, "--wheel-speed", "1", "2"], ["wheel_speed must hold 4 numbers", "got 2"]),
        ([*RUN, "--omega-2=1"], ["omega_2 must be between 2.5175 and 2.7825 rad/s", "got 1 rad/s"]),
        ([*RUN, "--theta=0", "--theta-rate=1", "--ramp-duration=5"], ["theta", "got 5 rad at the end of the ramp"]),
        ([*RUN, "--sample=-1"], ["sample", "not negative", "-1"]),
        ([*RUN, "--case=wrst"], ["no case 'wrst'", "did you mean worst?"]),
    ],
    ids=lambda value: " ".join(value)[:60],
)
def test_a_mistake_is_told_before_any_work(call: Call, bag: Path, arguments: list[str], words: list[str]) -> None:
    before = sorted(path for path in bag.parent.rglob("*"))
    code, out, err = call(*(a.format(bag=bag) if "{bag}" in a else a for a in arguments))
    assert code == 2 and out == "" and one_line(err), err
    for word in words:
        assert word in err
    assert sorted(path for path in bag.parent.rglob("*")) == before


def nested(depth: int) -> str:
    return "[" * depth + "]" * depth


@pytest.mark.parametrize(
    ("entry", "keys", "words"),
    [
        *((text, {}, ["odd.json"]) for text in ("9" * 400, nested(100_000), "1e999")),
        ("NaN", {}, ["odd.json", "finite", "nan"]),
        ("0.0", {"A": [[0.5]]}, ["odd.json", "matrix B", "1 x 22", "2 x 22"]),
        ("0.0", {"inputs": [{"name": "u", "size": 22}]}, ["odd.json", "inputs must be accel_Ip[6]", "u[22]"]),
        ("0.0", {"dt": 0.002}, ["odd.json", "sampling period must be 0.001 s, got 0.002"]),
        ("0.0", {"format": "something"}, ["odd.json", "not a controller file"]),
    ],
    ids=range(8),
)
def test_a_controller_that_cannot_be_used_is_named_by_its_file(
    call: Call, made: Path, tmp_path: Path, entry: str, keys: dict[str, object], words: list[str]
) -> None:
    content = json.loads((made / "k_fsm.json").read_text()) | keys
    content["D"][0][0] = "ODD"
    (tmp_path / "odd.json").write_text(json.dumps(content).replace('"ODD"', entry))
    code, _, err = call("run", "--mode=inprocess", "--k-fsm=odd.json", f"--k-pma={made / 'k_pma.json'}")
    assert code == 2 and one_line(err) and all(word in err for word in words)
    assert [path.name for path in tmp_path.iterdir()] == ["odd.json"]


def test_a_changed_letter_in_the_metadata_is_told_everywhere(call: Call, bag: Path, tmp_path: Path) -> None:
    file = bag / "bag_0.mcap"
    data = file.read_bytes()
    at = data.rfind(b"inprocess", 0, data.rfind(b"statistics"))
    file.write_bytes(data[:at] + b"inprocuss" + data[at + 9 :])
    assert data != file.read_bytes()
    for command in ("analyse", "report"):
        code, out, _ = call(command, bag, "--json")
        assert code == 0
        content = json.loads(out.splitlines()[-1])
        content = content if command == "analyse" else content["runs"][0]
        assert content["mode"] == "inprocess", "the other record holds"
        assert any(METADATA_NAME in problem and "hash" in problem for problem in content["problems"])
    assert "does not match its hash" in (bag / "report.html").read_text()


def test_a_failed_report_leaves_nothing_and_the_old_one(bag: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from pointing_analysis.report import report

    (bag / "report.html").write_text("old")
    before = sorted(bag.iterdir())

    def fail(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(KeyboardInterrupt):
        report.write_report([Run.open(bag)], bag / "report.html")
    assert sorted(bag.iterdir()) == before and (bag / "report.html").read_text() == "old"


LONG, DEEP = "x" * 300, "d/" * 2500 + "x"


@pytest.mark.parametrize(
    "line",
    [
        "analyse {}.csv --unit=rad --rate=10",
        "report {}",
        "bag repair {}",
        "bag info {}",
        "bag verify bag --public-key={}",
        "replay bag --k-fsm={}",
        "budget {}",
        "design check-proof {}",
        "export c --designs={}",
        "campaign --designs={}",
        "run --mode=inprocess --config={}",
        "run --mode=inprocess --cases={} --case=a",
    ],
)
@pytest.mark.parametrize("name", [LONG, DEEP], ids=["long name", "long path"])
def test_a_path_that_cannot_exist_is_a_mistake(call: Call, bag: Path, line: str, name: str) -> None:
    before = sorted(bag.parent.rglob("*"))
    code, out, err = call(*(word.format(name) for word in line.split()))
    assert code == 2 and out == "" and one_line(err), err
    assert sorted(bag.parent.rglob("*")) == before


def test_a_requirement_of_a_stage_that_does_not_exist_is_refused(call: Call, bag: Path, tmp_path: Path) -> None:
    text = "prob(|APE| < 1 mas) >= 0.5 at 95 % confidence"
    (tmp_path / "mine.toml").write_text(f'base = "reference"\n[[requirement]]\ntext = "{text}"\nloop = ["fsm_pma"]\n')
    code, _, err = call("analyse", bag, "--requirements", "mine.toml")
    assert code == 2 and one_line(err)
    assert "mine.toml: requirement[0]: loop must be one of none, isolator, fsm, fsm+pma, got 'fsm_pma'" in err


LIE = "bag is whole"


@pytest.mark.further
@pytest.mark.parametrize(
    "line",
    ["analyse BAG", "bag info BAG", "bag verify BAG", "bag topics BAG", "analyse BAG --los nothing", "report BAG"],
)
def test_no_line_begins_with_the_rest_of_a_name(call: Call, tmp_path: Path, line: str) -> None:
    """A line break in the name of a file begins no line of its own on the screen: it could say anything."""
    named = tmp_path / f"night\n{LIE}"
    write_bag(named, {"truth/los": 1e-8 * np.random.default_rng(2).standard_normal((7000, 2))}, dt=1e-3)
    _, out, err = call(*(named if word == "BAG" else word for word in line.split()))
    lines = (out + err).splitlines()
    assert lines and not any(text.strip().startswith(LIE) for text in lines), lines
