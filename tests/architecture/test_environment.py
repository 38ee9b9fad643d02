"""The locks of `environment/`, and how its script fills an environment from them."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from types import ModuleType

import pytest
from support.packages import PROJECT, ROOT
from support.scripts import script

ENVIRONMENT = ROOT / "environment"
EXTRAS: dict[str, list[str]] = PROJECT["project"]["optional-dependencies"]
RUN_EXTRAS = ("ros", "fast", "live")


def names(requirements: list[str]) -> set[str]:
    """Package names of requirements, as an index writes them."""
    return {re.match(r"[\w.-]+", line).group().lower().replace("_", "-").replace(".", "-") for line in requirements}  # type: ignore[union-attr]


def entries(lock: str) -> dict[str, set[str]]:
    """Pins of a lock, each with its hashes."""
    text = "\n".join(line for line in (ENVIRONMENT / lock).read_text().splitlines() if not line.startswith("#"))
    pins = re.split(r"\n(?=\S)", text.replace("\\\n", " "))
    return {pin.split(" --hash")[0].strip(): set(re.findall(r"--hash=(sha256:[0-9a-f]{64})", pin)) for pin in pins}


@pytest.fixture
def install() -> ModuleType:
    return script(ENVIRONMENT / "install.py")


@pytest.mark.parametrize("lock", ["run.lock", "everything.lock", "uv.lock"])
def test_a_lock_names_one_version_and_the_hashes_of_its_files(lock: str) -> None:
    for pin, hashes in entries(lock).items():
        assert re.match(r"[a-z0-9-]+==\S+", pin) and hashes, pin


def test_what_a_run_installs_is_a_part_of_everything() -> None:
    run, everything = entries("run.lock"), entries("everything.lock")
    versions = {pin.split(" ;")[0]: hashes for pin, hashes in everything.items()}
    assert [pin for pin, hashes in run.items() if versions.get(pin.split(" ;")[0]) != hashes] == []
    assert any(pin.startswith("setuptools==") and ";" not in pin for pin in run), "for the packages of this folder"
    assert len(run) < 0.6 * len(everything)
    assert names(PROJECT["project"]["dependencies"]) - {"lftkit", "pointing-analysis"} <= names(list(run))
    for extra, requirements in EXTRAS.items():
        assert names(requirements) <= names(list(everything))
        assert (names(requirements) <= names(list(run))) is (extra in RUN_EXTRAS), extra
    assert not names(list(run)) & {"mypy", "pytest", "jedi", "debugpy", "mkdocs", "pyarrow", "astropy", "pynastran"}


def test_ros_is_asked_for_only_where_its_wheels_are() -> None:
    marker = "sys_platform == 'linux' and platform_machine == 'x86_64'"
    assert all(line.endswith(f"; {marker}") for line in EXTRAS["ros"])
    for pin in entries("everything.lock"):
        assert not pin.startswith("ros-") or ("'x86_64'" in pin and "'linux'" in pin), pin


def test_uv_looks_where_pip_looks(install: ModuleType) -> None:
    listed = (
        ":env:.index-url='https://mirror/simple'\nglobal.index-url='https://other/simple'\n"
        "global.extra-index-url='file:///a/simple\\nhttps://b/simple'\ninstall.find-links='/wheels /more'\n"
        "global.find-links='/none'\nglobal.cert='/etc/a.crt'\nglobal.no-index='false'\nhash.algorithm='sha256'\n"
    )
    settings = install.pip_settings(listed)
    assert settings["index-url"] == "https://mirror/simple" and settings["find-links"] == "/wheels /more"
    assert "algorithm" not in settings
    variables = install.uv_variables(settings, {"SSL_CERT_FILE": "/own.crt", "UV_HTTP_TIMEOUT": "90"})
    assert variables["UV_DEFAULT_INDEX"] == "https://mirror/simple"
    assert variables["UV_INDEX"] == "file:///a/simple https://b/simple"
    assert variables["UV_FIND_LINKS"] == "/wheels,/more"
    assert not {"SSL_CERT_FILE", "UV_HTTP_TIMEOUT", "UV_NO_INDEX"} & set(variables), "what the user set stays"


@pytest.mark.parametrize("fault", ["no uv", "no index"])
def test_pip_installs_the_same_lock_where_uv_cannot(
    install: ModuleType, fault: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    ran: list[list[str]] = []

    def step(what: str, command: list[str], variables: dict[str, str] | None = None) -> None:
        ran.append(command)
        by_uv = Path(command[0]).name == "uv"
        if by_uv or (fault == "no uv" and any(part.endswith("uv.lock") for part in command)):
            raise install.StepFailed("first\nConnection refused")

    monkeypatch.setattr(install, "step", step)
    if fault == "no index":
        monkeypatch.setattr(install, "uv_program", lambda: (["uv", "pip", "install"], {}))
    install.install("run")
    packages, own = ran[-2:]
    assert packages[1:4] == ["-m", "pip", "install"] and packages[-1].endswith("run.lock")
    assert "--require-hashes" in packages and "--no-deps" in packages
    assert own[1:4] == ["-m", "pip", "install"] and {"./lftkit", "./pointing_analysis"} <= set(own)
    assert "uv did not: Connection refused; pip does it instead" in capsys.readouterr().out


def test_a_step_that_fails_shows_the_end_of_its_output(install: ModuleType) -> None:
    code = "print('WARNING: Location file:///x is ignored'); print('why'); raise SystemExit(3)"
    with pytest.raises(install.StepFailed) as caught:
        install.step("something", [sys.executable, "-c", code])
    assert str(caught.value) == "why"


def test_an_unknown_lock_is_refused(
    install: ModuleType, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["install.py", "all"])
    assert install.main() == 2
    assert capsys.readouterr().err == "argument must be one of run, everything, got 'all'\n"
