"""The script of the page on a document of a few lines: what it says, and when its buttons are active."""

import json
import shutil
import subprocess
from pathlib import Path

import los_testbed.live
import pytest

SCRIPT = Path(los_testbed.live.__file__).with_name("static") / "page.js"
DOCUMENT = """
const fs = require("fs"), vm = require("vm");
const element = () => ({ textContent: "", className: "", dataset: {}, clientWidth: 300, clientHeight: 200,
  append() {}, replaceChildren() {}, setAttribute() {}, addEventListener() {},
  getContext: () => new Proxy({}, { get: () => () => ({}) }) });
const ids = {}, buttons = ["stage", "noise"].map((name) => ({ ...element(), dataset: { name, value: "true" } }));
const told = [];
let socket, reconnects = 0;
const page = {
  document: { documentElement: {}, body: element(), getElementById: (id) => (ids[id] ||= element()),
    querySelectorAll: () => buttons, createElement: element },
  getComputedStyle: () => ({ getPropertyValue: () => "" }),
  location: { hash: "#token=a", protocol: "http:", host: "h" },
  URLSearchParams, uPlot: class { setData() {} destroy() {} setSize() {} }, ResizeObserver: class { observe() {} },
  WebSocket: class { constructor() { socket = this; } }, setTimeout: () => { reconnects += 1; },
};
page.window = page;
vm.createContext(page);
vm.runInContext(fs.readFileSync(process.argv[2], "utf8"), page);
const frame = (own) => socket.onmessage({ data: JSON.stringify({ run: 1, start: "0", tick: 5, over: false, stage: "fsm",
  settings: { noise: true }, samples: { ticks: [], los: [[], []], fsm: [], pma: [] }, ...own }) });
for (const [kind, content] of JSON.parse(process.argv[3])) {
  if (kind === "frame") frame(content); else socket.onclose(content);
  told.push([ids.connection.textContent, buttons.filter((button) => !button.disabled).length]);
}
console.log(JSON.stringify({ told, reconnects }));
"""
LOST, CLOSED = ("closed", {"code": 1006}), ("closed", {"code": 1000})


def page_after(folder, *events):
    """What the page says after each event, with the number of active buttons; how often it connects again."""
    if (node := shutil.which("node")) is None:
        pytest.skip("no node on this machine")
    (folder / "page.cjs").write_text(DOCUMENT)
    words = [node, str(folder / "page.cjs"), str(SCRIPT), json.dumps(events)]
    done = subprocess.run(words, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


RUNNING, OVER = ["running", 2], ["run over", 0]


@pytest.mark.parametrize(
    ("events", "told", "reconnects"),
    [
        (
            [("frame", {"tick": -1}), ("frame", {}), ("frame", {"over": True}), CLOSED],
            [["waiting for the run", 2], RUNNING, OVER, OVER],
            0,
        ),
        ([("frame", {}), CLOSED], [RUNNING, OVER], 0),  # a server that ends in order has ended its run
        ([("frame", {}), LOST, ("frame", {})], [RUNNING, ["connection lost", 0], RUNNING], 1),
    ],
)
def test_without_a_run_or_a_connection_the_page_says_so_and_its_buttons_are_inactive(
    tmp_path, events, told, reconnects
):
    assert page_after(tmp_path, *events) == {"told": told, "reconnects": reconnects}
