"""Wheels, sdists and the colcon workspace: complete, run outside the tree, without ROS and with it; one version."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import xml.etree.ElementTree as ElementTree
import zipfile
from pathlib import Path

import los_testbed
import pytest
import yaml
from support import packages
from support.installed_wheel import ANALYSIS, LFTKIT, ROOT, environment, run, sdist_and_wheel
from support.packages import files_of
from support.ros_runs import private_domain

import lftkit

PROJECT, LIBRARY = packages.PROJECT["project"], packages.LIBRARY["project"]
TOP = sorted({name.split(".")[0] for name in packages.PROJECT["tool"]["setuptools"]["packages"]})
HEAVY = (
    "rclpy",
    "numba",
    "mcap",
    "typer",
    "jinja2",
    "pydantic",
    "matplotlib",
    "rich",
    "yaml",
    "los_testbed",
    "titop_plant",
)
"""What neither the distribution lftkit needs nor its import loads."""


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    return sdist_and_wheel(tmp_path_factory.mktemp("distribution"))


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    return sdist_and_wheel(tmp_path_factory.mktemp("library"), LFTKIT)


@pytest.fixture(scope="module")
def analysis(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    return sdist_and_wheel(tmp_path_factory.mktemp("analysis"), ANALYSIS)


Distribution = tuple[Path, Path]


@pytest.fixture(scope="module")
def without_ros(
    built: Distribution, library: Distribution, analysis: Distribution, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    folder = tmp_path_factory.mktemp("core") / "env"
    return environment(folder, [library[1], analysis[1], built[1]], PROJECT["dependencies"])


@pytest.fixture(scope="module")
def lftkit_alone(library: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return environment(tmp_path_factory.mktemp("alone") / "env", [library[1]], LIBRARY["dependencies"])


def test_the_version_is_written_down_once() -> None:
    version = los_testbed.__version__
    assert re.fullmatch(r"\d+\.\d+\.\d+", version)
    assert "version" in PROJECT["dynamic"] and "version" not in PROJECT
    assert f"<version>{version}</version>" in (ROOT / "ros_ws/src/los_testbed/package.xml").read_text("utf-8")
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text("utf-8"))
    assert str(citation["version"]) == version
    assert {"cff-version", "message", "title", "authors"} <= set(citation)
    assert f"## [{version}]" in (ROOT / "CHANGELOG.md").read_text("utf-8")


def test_the_wheel_of_the_library_has_its_files_and_no_other(library: tuple[Path, Path]) -> None:
    sdist, wheel = library
    assert f"lftkit-{lftkit.__version__}" in sdist.name and f"lftkit-{lftkit.__version__}" in wheel.name
    inside = {name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name}
    folder = ROOT / "lftkit"
    assert inside == {
        f"lftkit/{path.relative_to(folder).as_posix()}"
        for path in files_of(folder, "*")
        if path.suffix in (".py", ".json", ".typed")
    }
    with tarfile.open(sdist) as archive:
        names = {name.split("/", 1)[-1] for name in archive.getnames()}
    assert {"LICENSE", "README.md", "pyproject.toml"} <= names


def test_the_library_alone_needs_no_testbed(lftkit_alone: Path, tmp_path: Path) -> None:
    """In an environment with its dependencies only: every module is imported, an example runs."""
    code = (
        "import sys, pkgutil, importlib, lftkit, json\n"
        "for module in pkgutil.walk_packages(lftkit.__path__, 'lftkit.'):\n"
        "    if not module.name.endswith('.plots'):\n"
        "        importlib.import_module(module.name)\n"
        f"print(json.dumps([n for n in {HEAVY} if n in sys.modules]), lftkit.__file__)\n"
    )
    done = run(lftkit_alone / "python", "-c", code, folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("[] ") and str(lftkit_alone.parent) in done.stdout
    others = tuple(name for name in HEAVY if name != "matplotlib")  # python-control needs it
    found = f"import importlib.util as u; print([n for n in {others} if u.find_spec(n)])"
    assert run(lftkit_alone / "python", "-c", found, folder=tmp_path).stdout == "[]\n"
    done = run(lftkit_alone / "python", str(ROOT / "examples/multi_requirement_pid.py"), folder=tmp_path)
    assert done.returncode == 0, done.stderr


def test_the_analysis_alone_judges_a_table_and_a_bag(
    library: Distribution, analysis: Distribution, tmp_path: Path
) -> None:
    """In an environment without the testbed, its models, ROS and numba: every module, the command, its exit codes."""
    folder, inside = ROOT / "pointing_analysis", set(zipfile.ZipFile(analysis[1]).namelist())
    files = {f"pointing_analysis/{path.relative_to(folder).as_posix()}" for path in files_of(folder) if path.is_file()}
    assert files <= inside and "pointing_analysis/py.typed" in inside
    programs = environment(tmp_path / "env", [library[1], analysis[1]], packages.ANALYSIS["project"]["dependencies"])
    code = (
        "import sys, pkgutil, importlib, importlib.util as u, pointing_analysis\n"
        "for module in pkgutil.walk_packages(pointing_analysis.__path__, 'pointing_analysis.'):\n"
        "    importlib.import_module(module.name)\n"
        "print([n for n in ('los_testbed', 'titop_plant', 'los_design', 'numba', 'rclpy') if u.find_spec(n)])\n"
    )
    assert run(programs / "python", "-c", code, folder=tmp_path).stdout == "[]\n"
    rows = [f"{k / 1000},{(k * 7919) % 13},{(k * 104729) % 11}" for k in range(6000)]
    (tmp_path / "los.csv").write_text("\n".join(["t,x,y", *rows]) + "\n")
    text = '[[requirement]]\nname = "APE"\ntext = "prob(|APE| < {} mas) >= 0.9 at 90 % confidence"\n'
    for limit, codes in ((1000, {0}), (1, {7})):
        (tmp_path / "mission.toml").write_text(text.format(limit))
        options = ("--los", "x,y", "--unit", "mas", "--requirements", "mission.toml", "--gate", "--output", "r.html")
        done = run(programs / "pointing-analysis", "analyse", "los.csv", *options, folder=tmp_path)
        assert done.returncode in codes and "APE" in done.stdout, done.stderr
    bag = str(ROOT / "bags/reference")
    run(programs / "pointing-analysis", "report", "los.csv", "--los", "x,y", "--unit", "mas", folder=tmp_path)
    assert (tmp_path / "report.html").stat().st_size > 10_000
    done = run(programs / "pointing-analysis", "analyse", bag, "--json", folder=tmp_path)
    assert done.returncode == 0 and json.loads(done.stdout.splitlines()[-1])["ticks"] == 4100, done.stderr
    wrong = run(programs / "pointing-analysis", "analyse", "no.csv", folder=tmp_path)
    assert wrong.returncode == 2 and len(wrong.stderr.splitlines()) == 1


@pytest.mark.slow
def test_the_library_passes_its_tests_and_examples_without_the_repository(
    library: tuple[Path, Path], tmp_path: Path
) -> None:
    """An environment with ``lftkit[test]``, the tests of lftkit and what they use of ``tests``, and nothing else."""
    extra = LIBRARY["optional-dependencies"]["test"]
    programs = environment(tmp_path / "env", [library[1]], LIBRARY["dependencies"] + extra)
    for part in ("conftest.py", "support", "oracles", "fixtures", "unit/lftkit"):
        source, target = ROOT / "tests" / part, tmp_path / "tests" / part
        target.parent.mkdir(parents=True, exist_ok=True)
        if source.is_dir():
            shutil.copytree(source, target, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(source, target)
    options = ("-q", "-m", "not slow", "-o", "pythonpath=tests tests/support", "-o", "markers=slow")
    done = run(programs / "python", "-m", "pytest", *options, "tests", folder=tmp_path, timeout=3600)
    assert done.returncode == 0, done.stdout[-3000:]
    for name in ("two_mass_spring_benchmark", "robust_mass_spring_damper", "multi_requirement_pid"):
        done = run(programs / "python", str(ROOT / f"examples/{name}.py"), folder=tmp_path)
        assert done.returncode == 0, done.stderr


def test_the_wheel_from_the_sdist_has_every_file_of_the_packages(built: tuple[Path, Path]) -> None:
    sdist, wheel = built
    assert los_testbed.__version__ in sdist.name and los_testbed.__version__ in wheel.name
    inside = set(zipfile.ZipFile(wheel).namelist())
    folders = {name: ROOT / name for name in TOP if name != "los_testbed"}
    folders["los_testbed"] = ROOT / "ros_ws/src/los_testbed/los_testbed"
    expected = {
        f"{name}/{path.relative_to(folder).as_posix()}"
        for name, folder in folders.items()
        for path in files_of(folder, "*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert not expected - inside
    assert {f"{name}/py.typed" for name in TOP} <= inside
    with tarfile.open(sdist) as archive:
        names = {name.split("/", 1)[-1] for name in archive.getnames()}
    assert {"CITATION.cff", "CHANGELOG.md", "LICENSE", "README.md"} <= names


def test_the_wheel_runs_outside_the_tree_without_ros(without_ros: Path, tmp_path: Path) -> None:
    program = without_ros / "los-testbed"
    assert run(program, "--version", folder=tmp_path).stdout == f"los-testbed {los_testbed.__version__}\n"
    options = ("--mode", "inprocess", "--duration", "2", "--output", "bag", "--json")
    done = run(program, "run", *options, folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout.splitlines()[-1])["ticks"] == 2000
    assert (tmp_path / "bag" / "report.html").stat().st_size > 100_000
    chosen = run(program, "run", "--duration", "1", folder=tmp_path)
    assert chosen.returncode == 0, chosen.stderr
    assert chosen.stderr.startswith("auto: ROS 2 is not installed in this environment: run in one process\n")
    missing = run(program, "run", "--mode", "realtime", "--duration", "1", folder=tmp_path)
    assert missing.returncode == 2 and "pip install 'los-testbed[ros]'" in missing.stderr
    where = run(without_ros / "python", "-c", "import lftkit, los_testbed; print(lftkit.__file__)", folder=tmp_path)
    assert str(without_ros.parent) in where.stdout


@pytest.mark.slow
@pytest.mark.ros
def test_the_wheel_runs_outside_the_tree_with_ros(
    built: Distribution, library: Distribution, analysis: Distribution, tmp_path: Path
) -> None:
    pytest.importorskip("rclpy")
    needed = PROJECT["dependencies"] + PROJECT["optional-dependencies"]["ros"]
    programs = environment(tmp_path / "env", [library[1], analysis[1], built[1]], needed)
    options = ("--mode", "lockstep", "--duration", "2", "--output", "bag", "--json", "--no-report")
    domain = ("--domain", str(private_domain()))
    done = run(programs / "los-testbed", "run", *domain, *options, folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout.splitlines()[-1])["ticks"] == 2000


TITLE = "against the wheels"
RUN = "los-testbed run --domain free"
SHORT_RUN = " --duration 2 --no-report --max-missed 100 --output {}"
SEEN = "import los_testbed, lftkit; print(los_testbed.__file__)"


def recipe() -> str:
    """The lines below the comment, up to the next empty one."""
    text = (ROOT / "ros_ws/README.md").read_text("utf-8")
    (found,) = re.findall(rf"^    # {TITLE}[^\n]*\n((?:    [^\n]+\n)+)", text, flags=re.MULTILINE)
    return re.sub(r"^    ", "", found, flags=re.MULTILINE)


@pytest.fixture
def repository(tmp_path: Path) -> Path:
    """The workspace beside a copy of the environment of these tests, in which the recipe installs packages."""
    pytest.importorskip("rclpy")
    asked = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--dest", str(tmp_path), "colcon-core"]
    if shutil.which("bash") is None or subprocess.run(asked, capture_output=True, check=False).returncode:
        pytest.skip("no package index that has colcon can be reached")
    folder = tmp_path / "repository"
    folder.mkdir()
    for entry in ROOT.iterdir():
        if not entry.name.startswith(".") and entry.name not in ("ros_ws", "build"):
            (folder / entry.name).symlink_to(entry)
    made = shutil.ignore_patterns("build", "install", "log", "__pycache__")
    shutil.copytree(ROOT / "ros_ws", folder / "ros_ws", ignore=made)
    shutil.copytree(sys.prefix, folder / ".venv", symlinks=True, copy_function=linked)
    for script in (folder / ".venv/bin").iterdir():
        if script.is_file() and not script.is_symlink() and sys.prefix.encode() in (text := script.read_bytes()):
            mode = script.stat().st_mode
            script.unlink()
            script.write_bytes(text.replace(sys.prefix.encode(), str(folder / ".venv").encode()))
            script.chmod(mode)
    return folder


def linked(source: str, target: str) -> None:
    """A second name of a file where that is possible: pip replaces files, and writes into none."""
    try:
        os.link(source, target)
    except OSError:
        shutil.copy2(source, target)


def test_the_workspace_is_built_tested_sourced_and_flown(repository: Path) -> None:
    """The nodes of the run are those that colcon has installed; no line fails, no test of the package fails."""
    lines = recipe()
    assert lines.count(RUN) == 1 and "source install/setup.bash" in lines
    bag = repository / "bag"
    script = lines.replace(RUN, RUN + SHORT_RUN.format(bag)) + f"python -c '{SEEN}'\nfind install -name '*.sh'\n"
    done = subprocess.run(
        ["bash", "-e", "-o", "pipefail", "-c", script], cwd=repository, capture_output=True, text=True, check=False
    )
    told = done.stdout + done.stderr
    assert done.returncode == 0, told
    (suite,) = ElementTree.parse(repository / "ros_ws/build/los_testbed/pytest.xml").getroot()
    assert int(suite.get("tests", 0)) >= 5 and (suite.get("errors"), suite.get("failures")) == ("0", "0"), told
    assert "install/los_testbed/share/los_testbed/hook/ament_prefix_path.sh" in done.stdout
    imported = re.findall(r"^.*/los_testbed/__init__\.py$", done.stdout, flags=re.MULTILINE)
    assert len(imported) == 1 and imported[0].startswith(str(repository / "ros_ws/install")), told
    assert (bag / "metadata.yaml").is_file(), told
