"""Who hears a run: on LOCALHOST nothing leaves the loopback interface, on SUBNET the next host takes part.

A campaign is not heard either.
"""

import contextlib
import json
import os
import subprocess
import sys
from pathlib import Path

import observed_host
import pytest
from ros_runs import config_for, private_domain
from two_hosts import NotPermittedError, veth_pair

LOOPBACK = "0100007F"
"""127.0.0.1 as /proc/net writes it."""
NETWORK = "7F"
"""End of the addresses of the loopback network, 127.0.0.0/8."""
SECONDS = {"LOCALHOST": "3.5", "SUBNET": "60"}
"""An ordinary node announces itself when it starts and every 3 s; one that takes part leaves as soon as it has."""


def start(host, words, variables):
    """A program of `observed_host` on a host."""
    command = ["ip", "netns", "exec", host, sys.executable, str(Path(observed_host.__file__)), *words]
    return subprocess.Popen(command, env=variables, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@contextlib.contextmanager
def two_hosts():
    """Two hosts whose network cards are silent by themselves."""
    try:
        with veth_pair() as hosts:
            for name in hosts.names.values():  # otherwise the kernel announces IPv6 addresses by itself
                quiet = ["sysctl", "-qw", "net.ipv6.conf.all.disable_ipv6=1"]
                subprocess.run(["ip", "netns", "exec", name, *quiet], check=True)
            yield hosts.names
    except NotPermittedError as error:
        pytest.skip(f"network namespaces are not permitted: {error}")


def observe(names, folder, discovery):
    """A run on the first host while an ordinary node on the second one tries to take part."""
    config = folder / "config.json"
    config.write_text(json.dumps(config_for(folder, duration=60.0).to_mapping()))
    domain = str(private_domain())
    arguments = {
        "a": ["run", str(config), names["a"], str(folder)],
        "b": ["stranger", "10.99.0.1", domain, str(folder), SECONDS[discovery]],
    }
    variables = {**os.environ, "ROS_AUTOMATIC_DISCOVERY_RANGE": discovery, "ROS_LOG_DIR": str(folder)}
    variables["PYTHONPATH"] = os.pathsep.join(sys.path)
    started = {host: start(names[host], words, variables) for host, words in arguments.items()}
    try:
        answers = {}
        for host in ("b", "a"):
            out, errors = started[host].communicate(timeout=240)
            assert started[host].returncode == 0, errors
            answers[host] = json.loads(out)
    finally:
        for process in started.values():
            process.kill()
            process.communicate()
    return answers["a"], answers["b"]


@pytest.fixture(scope="module", params=["LOCALHOST", "SUBNET"])
def seen(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp(request.param)
    with two_hosts() as names:
        return observe(names, folder, request.param)


localhost = pytest.mark.parametrize("seen", ["LOCALHOST"], indirect=True)
subnet = pytest.mark.parametrize("seen", [pytest.param("SUBNET", marks=pytest.mark.slow)], indirect=True)


@localhost
def test_no_packet_leaves_this_machine(seen):
    host, _ = seen
    assert host["served"] == 2, "viewers could come"
    assert host["alone"] == {}
    assert "udp" not in host["with_stranger"], "not even as an answer to the stranger's announcements"


@localhost
def test_no_socket_listens_elsewhere(seen):
    sockets = seen[0]["sockets"]
    assert LOOPBACK in sockets and all(address.endswith(NETWORK) for address in sockets)


@localhost
def test_the_stranger_sees_nothing_and_its_commands_reach_no_gate(seen):
    host, stranger = seen
    assert stranger == {"heard": 0, "sent": observed_host.SENT, "nodes": []}
    assert not [name for name in host["plant"] if name.startswith("rejected_fsm") and "late" not in name]


@pytest.mark.slow
def test_no_packet_of_a_campaign_leaves_this_machine_and_no_socket_is_elsewhere(tmp_path):
    pytest.importorskip("distributed")
    with two_hosts() as names:
        process = start(names["a"], ["campaign", names["a"], str(tmp_path)], {**os.environ})
        out, errors = process.communicate(timeout=300)
    assert process.returncode == 0, errors
    assert json.loads(out) == {"packets": {}, "sockets": [LOOPBACK]}


@subnet
def test_on_a_network_the_same_stranger_takes_part(seen):
    """The other side of the tests above: these packets, sockets and commands are seen where they exist."""
    host, stranger = seen
    assert host["alone"]["udp"] > 0
    assert "00000000" in host["sockets"]
    assert stranger["heard"] > 0
    assert {"plant", "estimator", "controller", "recorder"} <= set(stranger["nodes"])
    assert 0 < int(host["plant"]["rejected_fsm_limit"]) <= stranger["sent"]
