"""Configuration: every mistake is one line that says what was expected and what came."""

import pytest
from los_testbed.config.run_config import RunConfig, physical_hash, read_yaml


@pytest.mark.parametrize("rate", [1, 12.5, 40, 1000])
def test_camera_rates_that_divide_the_loop_rate(rate):
    assert RunConfig(camera_rate=float(rate)).frame_ticks * rate == 1000


@pytest.mark.parametrize(
    ("text", "words"), [("[1, 2", "must be YAML"), *((t, "must hold names") for t in ("- a\n- b\n", "just words", ""))]
)
def test_a_file_that_is_no_configuration(tmp_path, text, words):
    (tmp_path / "bad.yaml").write_text(text)
    with pytest.raises(ValueError, match=f"bad.yaml {words}"):
        read_yaml(tmp_path / "bad.yaml")


def test_the_plant_hash_depends_on_physics_only():
    base = RunConfig()
    assert physical_hash(base) == physical_hash(RunConfig(duration=3.0, mode="inprocess", loop="fsm"))
    changed = [RunConfig(seed=2), RunConfig(theta=0.1), RunConfig(noise=False), RunConfig(loop="none")]
    assert len({physical_hash(c) for c in [base, *changed]}) == 5
