"""A run on the page in a browser: values, stage, keyboard, widths; actions with and without the token."""

import json
import socket
import threading
import time
import urllib.error
import urllib.request
from typing import Any

import numpy as np
import pytest

pytest.importorskip("foxglove")
from foxglove_client import SUBPROTOCOL, never_reading
from los_testbed.run.processes.viewers import Live
from los_testbed.run.results import RunError
from los_testbed.run.runner import Runner
from ros_runs import PLANT, config_for
from support import axe, headless_browser

from pointing_analysis.indices.errors import RAD_PER_MAS
from pointing_analysis.read.run import Run
from titop_plant.interface import TICK_NS

pytestmark = [
    pytest.mark.timeout(1200),
    pytest.mark.skipif(headless_browser.browser() is None, reason="no chromium on this machine"),
]
READ = "JSON.stringify({start: document.body.dataset.start, tick: document.body.dataset.tick, " + ", ".join(
    f"'{name}': document.getElementById('{name}').textContent"
    for name in ("los-x", "los-y", "stage", "missed", "ticks", "connection", "answer")
)
READ += ", stageBefore: document.body.dataset.stageBefore})"


def read(page):
    return json.loads(page.value(READ))


def until(page, condition, limit=300.0):
    end = time.monotonic() + limit
    while not condition(found := read(page)):
        assert time.monotonic() < end, found
        time.sleep(0.05)
    return found


def post(address, body, token=None):
    """Status and error of an action."""
    url = address.split("#")[0] + "action"
    request = urllib.request.Request(url, body, {} if token is None else {"X-Token": token}, method="POST")
    try:
        with urllib.request.urlopen(request) as answer:
            return answer.status, json.load(answer)["error"]
    except urllib.error.HTTPError as error:
        return error.code, json.load(error)["error"]


def refusals(address):
    """Answers to requests that must be refused."""
    token = address.split("token=")[1]
    good = json.dumps({"name": "stage", "value": "isolator"}).encode()
    return {
        "no token": post(address, good),
        "wrong token": post(address, good, token[:-1] + "?"),
        "no JSON": post(address, b"stage", token),
        "no value": post(address, b'{"name": "stage"}', token),
        "range": post(address, json.dumps({"name": "camera_dropout", "value": 7}).encode(), token),
        "node": post(address, json.dumps({"name": "deactivate", "value": "plant"}).encode(), token),
        "state": post(address, json.dumps({"name": "start", "value": True}).encode(), token),
        "long": post_long(address, token),
    }


def post_long(address, token):
    """A body that is longer than any action: the server closes the connection or refuses it."""
    try:
        return post(address, b" " * 100_000, token)
    except (OSError, ValueError):
        return 400, "closed"


def use_page(page, found):
    """What a user does on the page, by keyboard as far as it goes."""
    found["early"] = until(page, lambda now: int(now.get("tick", 0)) > 1500 and now["ticks"] != "-")
    found["refused"] = refusals(found["address"])
    found["samples"] = [read(page)]
    for _ in range(8):
        time.sleep(0.1)
        found["samples"].append(read(page))
    page.value("document.querySelector('button[data-name=stage]').focus()")
    page.call("Input.dispatchKeyEvent", type="keyDown", key="Enter", text="\r", windowsVirtualKeyCode=13)
    page.call("Input.dispatchKeyEvent", type="keyUp", key="Enter", windowsVirtualKeyCode=13)
    found["stage"] = until(page, lambda now: now["stage"] == "isolator")
    found["answer"] = until(page, lambda now: now["answer"] not in ("", "asked"))["answer"]
    found["samples"].append(read(page))
    found["pressed"] = page.value("document.querySelector('button[data-value=\\'\"isolator\"\\']').ariaPressed")
    found["spectrum"] = page.value("document.querySelectorAll('.uplot').length")
    found["widths"], found["axe"] = {}, {}
    for width in (1280, 390):
        size = {"width": width, "height": 844, "deviceScaleFactor": 1, "mobile": width < 500}
        page.call("Emulation.setDeviceMetricsOverride", **size)
        time.sleep(0.5)
        found["widths"][width] = page.value("document.documentElement.scrollWidth")
        for scheme in ("light", "dark"):
            page.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
            found["axe"][width, scheme] = axe.findings_here(page)
        page.call("Emulation.setEmulatedMedia", features=[])
    rows = page.value("JSON.stringify([...document.querySelectorAll('button')].map(b => b.getBoundingClientRect()))")
    found["buttons"] = json.loads(rows)
    reached = []
    for _ in range(40):
        page.press("Tab", 9)
        reached.append(page.value("String(document.activeElement.dataset.name)"))
    found["reached"] = set(reached)
    page.value("document.querySelector('button[data-name=stop]').click()")
    found["last"] = until(page, lambda now: now["connection"] == "run over")
    found["errors"] = list(page.errors)


@pytest.fixture(scope="module")
def watched(tmp_path_factory):
    """One run with a browser and two viewers that never read."""
    folder = tmp_path_factory.mktemp("live")
    found: dict[str, Any] = {}

    def tell(foxglove, page):
        found.update(foxglove=foxglove, address=page)

    runner = Runner(config_for(folder, duration=300.0), commands={"plant": PLANT}, live=Live(port=0, tell=tell))
    results, errors = {}, []

    def run():
        try:
            results["run"] = runner.run()
        except BaseException as error:
            errors.append(error)

    thread = threading.Thread(target=run)
    thread.start()
    try:
        while not found and thread.is_alive():
            time.sleep(0.05)
        idle = [
            never_reading(found["foxglove"], "/", SUBPROTOCOL, subscribe_to=10),
            never_reading(found["address"], "/data"),
        ]
        with headless_browser.Page() as page:
            page.open(found["address"], 1280)
            use_page(page, found)
        thread.join()
        for connection in idle:
            connection.close()
    finally:
        if thread.is_alive():
            runner._nodes["plant"].interrupt()
            thread.join()
    assert not errors, errors
    return found, results["run"]


@pytest.mark.slow
def test_values_on_the_page_equal_those_of_the_bag(watched):
    found, results = watched
    truth = Run.open(results.bag)["truth/los"]
    compared = 0
    for sample in found["samples"]:
        (row,) = np.nonzero(truth.stamp == int(sample["start"]) + int(sample["tick"]) * TICK_NS)
        if len(row):  # neither reader is sure to have every tick
            shown = [float(sample["los-x"]), float(sample["los-y"])]
            assert np.allclose(shown, truth.values[row[0], :2] / RAD_PER_MAS, rtol=1e-3, atol=0)
            compared += 1
    assert compared >= 3


@pytest.mark.slow
def test_the_page_ends_with_the_counts_of_the_run(watched):
    found, results = watched
    assert found["last"]["missed"] == results.statistics["plant"]["missed_ticks"]
    assert found["last"]["ticks"] == results.statistics["plant"]["ticks"]
    assert not results.failures and not results.interrupted, "stopped by the page"
    assert not [line for line in results.warnings if "viewers" in line]


@pytest.mark.slow
def test_a_stage_is_switched_by_keyboard_and_seen_within_a_second(watched):
    found, results = watched
    run = Run.open(results.bag)
    changes = json.loads(run.parameters["statistics"]["controller"]["changes"])
    assert [(change["name"], change["value"]) for change in changes] == [("loop", "isolator")]
    assert found["answer"] == "stage isolator: accepted" and found["pressed"] == "true"
    first = run["truth/los"].stamp[0]
    last = (int(found["stage"]["start"]) - first) // TICK_NS + int(found["stage"]["stageBefore"])
    assert 1500 < last <= changes[0]["tick"] + 1000, "the last frame that showed the former stage"


@pytest.mark.slow
def test_the_page_has_no_errors_and_fits_a_desk_and_a_telephone(watched):
    found = watched[0]
    assert found["widths"][1280] <= 1280 and found["widths"][390] <= 390
    assert not {key: value for key, value in found["axe"].items() if value}
    assert found["errors"] == [] and found["spectrum"] >= 6
    assert all(box["height"] >= 44 and box["width"] >= 44 and box["right"] <= 390 for box in found["buttons"])
    assert {"stage", "noise", "disturbance", "deactivate", "activate", "start", "stop", "reset"} <= found["reached"]


@pytest.mark.slow
def test_actions_are_refused_without_the_token_and_with_values_that_do_not_fit(watched):
    refused = watched[0]["refused"]
    for name in ("no token", "wrong token"):
        assert refused[name] == (403, "token must be that of the printed address, got another one or none")
    assert all(refused[name][0] == 400 for name in refused if "token" not in name)
    assert refused["range"][1] == "camera_dropout must be between 0 and 1, got 7"
    assert refused["node"][1] == "node must be estimator or controller, got 'plant'"
    assert refused["state"][1] == "the run must be waiting for its start for start, got running"
    assert not any("\n" in text for _, text in refused.values())


def test_a_port_in_use_is_refused_before_the_run(tmp_path):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(RunError, match=f"live: live port must be free on 127.0.0.1, got {port}") as error:
            Runner(config_for(tmp_path), commands={"plant": PLANT}, live=Live(port=port)).run()
    assert error.value.code == 2
