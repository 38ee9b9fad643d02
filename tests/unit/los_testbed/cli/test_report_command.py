"""``los-testbed report``: what it writes, and that bad bags give one clear line or a stated partial answer."""

import numpy as np
import pytest
from command_line import CommandLine, refused

from pointing_analysis.indices.synthetic import write_bag

pytestmark = pytest.mark.usefixtures("without_pictures")

MAS = np.pi / 648_000_000
RNG = np.random.default_rng(0)


@pytest.fixture
def call(tmp_path, monkeypatch, capsys):
    return CommandLine.below(tmp_path, monkeypatch, capsys, "report")


def los(seconds: float, scale: float = 5.0) -> np.ndarray:
    return scale * MAS * RNG.standard_normal((round(1000 * seconds), 2))


def test_what_the_run_said_beside_its_verdict_is_said_again(call, tmp_path) -> None:
    """As `run` and `analyse` do; of several bags with the name of the one that it is of."""
    told, quiet = (
        write_bag(tmp_path / name, {"truth/los": los(3)}, parameters={"loop": name, **more})
        for name, more in (("fsm", {"start_note": "no start <is> known"}), ("isolator", {}))
    )
    code, out, _ = call(told, "--output", "one.html")
    assert code == 0 and "note: no start <is> known" in out
    assert "no start &lt;is&gt; known" in (call.here / "one.html").read_text()
    code, out, _ = call(told, quiet, "--output", "two.html")
    assert code == 0 and "note: fsm: no start <is> known" in out


def test_not_a_bag(call, tmp_path, capsys) -> None:
    (tmp_path / "text.mcap").write_text("this is no bag at all, whatever its name says")
    (tmp_path / "empty").mkdir()
    (tmp_path / "los.csv").write_text("t,x,y\n0,1,2\n")
    for name, words in (
        ("text.mcap", ["text.mcap", "must begin with"]),
        ("empty", ["rosbag2 folder"]),
        ("los.csv", ["must be a bag", "got CSV", "analyse FILE --output PAGE"]),
    ):
        error = refused(capsys, "report", tmp_path / name)
        assert all(word in error for word in words) and not list(call.here.iterdir())
