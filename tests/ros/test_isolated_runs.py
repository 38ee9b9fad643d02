"""Runs with a network of their own: nobody on this machine is on their domain, viewers come in all the same."""

import json
import os
import re
import shutil
import subprocess
import sys
import urllib.request
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("foxglove")
from attack_campaign import messages_of, run_beside
from attacker import EARLY, Attacker, Case
from los_testbed.run.processes.isolation import isolated_network
from los_testbed.run.processes.viewers import Live
from los_testbed.run.runner import Runner
from observed_host import local_addresses
from ros_runs import PLANT, config_for

DURATION = 0.6


@pytest.fixture(autouse=True)
def permitted():
    try:
        with isolated_network():
            pass
    except ValueError as error:
        pytest.skip(f"user namespaces are not permitted: {error}")


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run in lockstep with a server for viewers, beside a second controller that was there before it."""
    folder = tmp_path_factory.mktemp("isolated")
    seen: dict[str, Any] = {}
    config = config_for(folder, duration=DURATION, mode="lockstep")

    def progress(ticks):
        if "page" not in seen:
            seen["page"] = urllib.request.urlopen(seen["address"]).read().decode()
            seen["processes"] = dict(runner.processes)
            seen["interfaces"] = {interfaces(number) for number in runner.processes.values()}
            seen["sockets"] = set().union(*(local_addresses(str(number)) for number in runner.processes.values()))

    live = Live(port=0, tell=lambda foxglove, page: seen.update(address=page))
    case = Case("fsm/command", "controller", "/telescope", "next", 2000.0, begin=EARLY, seconds=60.0)
    stranger = Attacker(config.domain, case)
    runner = Runner(config, progress, {"plant": PLANT}, live=live, isolated=True)
    try:
        seen["results"] = runner.run()
    finally:
        seen["stranger"] = stranger.close()
    return seen


def interfaces(number):
    return tuple(re.findall(r"(\S+):", Path(f"/proc/{number}/net/dev").read_text()))


def test_a_stranger_with_the_names_of_the_run_changes_nothing_and_is_not_even_seen(run, tmp_path):
    results = run["results"]
    assert messages_of(results.bag) == messages_of(run_beside(tmp_path, None).bag)
    assert not results.failures and not [line for line in results.warnings if "second publisher" in line]
    assert not [name for name in results.statistics["recorder"] if name.startswith(("foreign_", "misused_"))]


def test_a_stranger_hears_nothing(run):
    sent, heard = re.search(r"sent (\d+), heard (\d+)", run["stranger"]).groups()
    assert int(sent) > 100 and heard == "0"


def test_the_nodes_have_a_loopback_interface_and_no_other(run):
    assert set(run["processes"]) == {"plant", "estimator", "controller", "recorder", "live"}
    assert run["interfaces"] == {("lo",)}
    assert all(address.endswith("7F") for address in run["sockets"]) and run["sockets"]


def test_a_viewer_outside_gets_the_page(run):
    assert run["address"].startswith("http://127.0.0.1:") and "<html" in run["page"]


MAKE = """
import json, os, subprocess, sys
from los_testbed.run.processes.isolation import isolated_network
with isolated_network() as network:
    inside = network.command([sys.executable, "-c", sys.argv[1]])
    done = subprocess.run(inside, pass_fds=network.descriptors, check=True, capture_output=True, text=True)
print(json.dumps([len(network.descriptors), json.loads(done.stdout)]))
"""
INSIDE = """
import json, os, re
from pathlib import Path
links = [os.path.realpath(f"/proc/self/fd/{number}") for number in os.listdir("/proc/self/fd")]
print(json.dumps({
    "interfaces": re.findall(r"(\\S+):", Path("/proc/net/dev").read_text()),
    "user": os.getuid(),
    "namespaces": [link for link in links if "net:[" in link or "user:[" in link],
}))
"""


@pytest.mark.parametrize(
    ("rights", "counts"), [([], (1, 2)), (["setpriv", "--bounding-set=-sys_admin", "--inh-caps=-sys_admin"], (2,))]
)
def test_a_command_inside_has_the_same_user_and_no_descriptor_of_a_namespace(rights, counts):
    """Also of a user without the right to make a network: then in a user namespace as well."""
    if rights and (os.getuid() != 0 or shutil.which("setpriv") is None):
        pytest.skip("only root can give rights up, by setpriv")
    done = subprocess.run([*rights, sys.executable, "-c", MAKE, INSIDE], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    count, inside = json.loads(done.stdout)
    assert count in counts
    assert inside == {"interfaces": ["lo"], "user": os.getuid(), "namespaces": []}


PROGRAM = [sys.executable, "-m", "los_testbed.cli.app", "run", "--isolated"]


def test_where_namespaces_are_not_permitted_it_is_one_line_and_code_2(tmp_path):
    """In a user namespace in which no network can be made."""
    unshare = shutil.which("unshare")
    if unshare is None:
        pytest.skip("no unshare on this machine")
    script = 'echo 0 > /proc/sys/user/max_net_namespaces; exec "$0" "$@"'
    command = [unshare, "--user", "--map-root-user", "sh", "-c", script, *PROGRAM, "--mode=lockstep", "--duration=1.5"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    (line,) = [text for text in done.stderr.splitlines() if "los-testbed:" in text]
    assert (
        "--isolated must be permitted (user and network namespaces), got: unshare: the limit of /proc/sys/user" in line
    )
    assert done.returncode == 2 and "Traceback" not in done.stderr
    assert not list(tmp_path.rglob("*.mcap"))
