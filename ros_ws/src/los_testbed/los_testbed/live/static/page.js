"use strict";
// Shows the frames of the server (live/frames.py) and posts actions. The token is the fragment of the address.
(() => {
  const SPAN_S = 5, HISTORY_S = 300, NORMAL = 1000, LEVELS = ["OK", "WARN", "ERROR", "STALE"];
  const COLOURS = ["--blue", "--orange", "--ok", "--bad"];
  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const token = new URLSearchParams(location.hash.slice(1)).get("token") || "";
  const at = (id) => document.getElementById(id);
  const show = (id, value) => { at(id).textContent = value; };
  const digits = (value) => Number(value).toPrecision(4);

  let fixed = { authority: { fsm: 1, pma: 1 } }, run = 0, over = false, lastTicks = 0, lastMissed = 0, lastTick = -1;
  const recent = { t: [], x: [], y: [], fsm: [], pma: [] };
  const rpe = { t: [], largest: [] }, loop = { t: [], median: [], p999: [], missed: [] };
  let limits = [];

  function chart(id, names, options = {}) {
    const box = at(id);
    const series = names.map((label, i) => ({ label, stroke: () => colour(label.startsWith("limit") ? "--bad" : COLOURS[i % COLOURS.length]), width: 1, ...(options.each || {}) }));
    const faint = { stroke: () => colour("--line"), width: 1 };
    const decades = (u, splits, axis) => splits.map((v) => (axis && options.y && !Number.isInteger(Math.log10(v)) ? null : v));
    const powers = (u, splits) => splits.map((v) => (v === null ? "" : v.toExponential(0)));
    const lines = { stroke: () => colour("--ink"), grid: { ...faint, filter: decades }, ticks: { ...faint, filter: decades } };
    const plot = new uPlot({
      width: Math.max(box.clientWidth, 200), height: 220, cursor: { drag: { x: false, y: false } },
      scales: { x: { time: false, ...(options.x || {}) }, y: options.y || {} },
      axes: [{ label: options.xlabel || "time [s]", ...lines }, { size: 64, ...lines, ...(options.y ? { values: powers } : {}) }],
      series: [{ label: options.xlabel || "time [s]" }, ...series],
    }, [[], ...names.map(() => [])], box);
    new ResizeObserver(() => plot.setSize({ width: Math.max(box.clientWidth, 200), height: 220 })).observe(box);
    return plot;
  }

  let charts = null, rpeNames = "";
  function makeCharts() {
    charts = {
      los: chart("plot-los", ["x", "y"]),
      spectrum: chart("plot-spectrum", ["both axes"], { xlabel: "frequency [Hz]", x: { distr: 3 }, y: { distr: 3 } }),
      latency: chart("plot-latency", ["median", "99.9 %"]),
      missed: chart("plot-missed", ["missed ticks"]),
      actuators: chart("plot-actuators", ["mirror", "force"]),
    };
  }

  function rpeChart(shown) {
    const names = ["largest", ...shown.map((l) => `limit: ${l.name}`)];
    if (charts.rpe && rpeNames === names.join()) return;
    if (charts.rpe) charts.rpe.destroy();
    rpeNames = names.join();
    charts.rpe = chart("plot-rpe", names);
  }

  function clear() {
    for (const group of [recent, rpe, loop]) for (const key of Object.keys(group)) group[key] = [];
    lastTicks = lastMissed = 0;
  }

  function largest(columns, i) {
    let most = null;
    for (const column of columns) if (column[i] !== null) most = Math.max(most === null ? 0 : most, Math.abs(column[i]));
    return most;
  }

  function addSamples(samples) {
    const share = (value, authority) => (value === null ? null : (100 * value) / authority);
    samples.ticks.forEach((tick, i) => {
      recent.t.push(tick / 1000);
      recent.x.push(samples.los[0][i]);
      recent.y.push(samples.los[1][i]);
      recent.fsm.push(share(largest(samples.fsm, i), fixed.authority.fsm));
      recent.pma.push(share(largest(samples.pma, i), fixed.authority.pma));
    });
    if (!recent.t.length) return;
    const from = recent.t[recent.t.length - 1] - SPAN_S;
    const old = recent.t.findIndex((t) => t >= from);
    if (old > 0) for (const key of Object.keys(recent)) recent[key].splice(0, old);
    for (let i = samples.ticks.length - 1; i >= 0; i--) {
      if (samples.los[0][i] === null) continue;
      show("los-x", digits(samples.los[0][i]));
      show("los-y", digits(samples.los[1][i]));
      show("time", (samples.ticks[i] / 1000).toFixed(3));
      document.body.dataset.tick = samples.ticks[i];
      break;
    }
  }

  function drawCloud() {
    const canvas = at("cloud"), scale = window.devicePixelRatio || 1;
    const w = canvas.clientWidth, h = canvas.clientHeight;
    if (canvas.width !== Math.round(w * scale)) { canvas.width = Math.round(w * scale); canvas.height = Math.round(h * scale); }
    const pen = canvas.getContext("2d");
    pen.setTransform(scale, 0, 0, scale, 0, 0);
    pen.clearRect(0, 0, w, h);
    let reach = 1e-9;
    recent.x.forEach((x, i) => { if (x !== null) reach = Math.max(reach, Math.abs(x), Math.abs(recent.y[i])); });
    const circles = limits.filter((l) => l.index === "APE" && l.limit < 4 * reach);
    for (const c of circles) reach = Math.max(reach, c.limit);
    const unit = (0.46 * Math.min(w, h)) / reach, cx = w / 2, cy = h / 2;
    pen.fillStyle = colour(COLOURS[0]);
    recent.x.forEach((x, i) => { if (x !== null) pen.fillRect(cx + x * unit - 1, cy - recent.y[i] * unit - 1, 2, 2); });
    pen.strokeStyle = colour(COLOURS[3]);
    for (const c of circles) { pen.beginPath(); pen.arc(cx, cy, c.limit * unit, 0, 2 * Math.PI); pen.stroke(); }
    if (!recent.x.some((x) => x !== null)) { show("cloud-legend", "no samples yet"); return; }
    show("cloud-legend", `circles: ${circles.map((c) => `${c.name} ${c.limit} mas`).join(", ") || "none in range"}; half height ${Number(digits(reach))} mas`);
  }

  function drawStar({ window: n, counts }) {
    const canvas = at("star-pixels"), pen = canvas.getContext("2d");
    at("star").hidden = false;
    if (canvas.width !== n) canvas.width = canvas.height = n;
    const least = Math.min(...counts), most = Math.max(...counts), picture = pen.createImageData(n, n);
    counts.forEach((count, i) => {  // row 0 is at -y: the last line of the picture
      const at4 = 4 * ((n - 1 - Math.floor(i / n)) * n + (i % n));
      const grey = Math.round((255 * (count - least)) / Math.max(most - least, 1));
      picture.data.set([grey, grey, grey, 255], at4);
    });
    pen.putImageData(picture, 0, 0);
    show("star-legend", `${least} to ${most} counts, black to white, ${n} x ${n} pixels`);
  }

  function addIndices(indices) {
    const list = at("indices");
    list.replaceChildren(...indices.flatMap((index) => {
      const name = document.createElement("dt"), value = document.createElement("dd");
      name.textContent = index.name;
      name.title = index.text;
      value.textContent = `${digits(index.largest)} of ${index.limit} mas`;
      value.className = index.within >= index.probability ? "ok" : "bad";
      return [name, value];
    }));
    const relative = indices.filter((index) => index.index === "RPE");
    const ours = relative.filter((index) => index.quantity === relative[0].quantity);  // of one curve
    limits = indices;
    if (!ours.length || !recent.t.length) return;
    rpe.t.push(recent.t[recent.t.length - 1]);
    rpe.largest.push(ours[0].largest);
    while (rpe.t[0] < rpe.t[rpe.t.length - 1] - HISTORY_S) { rpe.t.shift(); rpe.largest.shift(); }
    rpeChart(ours);
    charts.rpe.setData([rpe.t, rpe.largest, ...ours.map((l) => rpe.t.map(() => l.limit))]);
  }

  function addNodes(nodes) {
    at("nodes").replaceChildren(...Object.entries(nodes).map(([name, node]) => {
      const row = document.createElement("tr");
      for (const text of [name, LEVELS[node.level] || "?", node.message]) {
        const cell = document.createElement("td");
        cell.textContent = text;
        row.append(cell);
      }
      row.children[1].className = node.level === 0 ? "status ok" : node.level === 2 ? "status bad" : "status";
      return row;
    }));
    const plant = nodes.plant && nodes.plant.values;
    if (!plant || plant.ticks === undefined) return;
    const ticks = Number(plant.ticks), missed = Number(plant.missed_ticks);
    const kind = plant.latency_median_us === undefined ? "turnaround" : "latency";
    show("missed", plant.missed_ticks);
    show("ticks", plant.ticks);
    show("latency-median", plant[`${kind}_median_us`]);
    show("latency-p999", plant[`${kind}_p999_us`]);
    if (ticks <= lastTicks) return;
    loop.t.push(ticks / 1000);
    loop.median.push(Number(plant[`${kind}_median_us`]));
    loop.p999.push(Number(plant[`${kind}_p999_us`]));
    loop.missed.push(missed - lastMissed);
    [lastTicks, lastMissed] = [ticks, missed];
    if (loop.t.length > HISTORY_S) for (const key of Object.keys(loop)) loop[key].shift();
    charts.latency.setData([loop.t, loop.median, loop.p999]);
    charts.missed.setData([loop.t, loop.missed]);
  }

  function press(frame) {
    const now = { stage: frame.stage, ...frame.settings };
    for (const button of document.querySelectorAll("button[data-name]")) {
      if (!(button.dataset.name in now)) continue;
      button.setAttribute("aria-pressed", String(JSON.parse(button.dataset.value) === now[button.dataset.name]));
    }
  }

  // Text of the connection; the buttons send requests only while a run is active.
  function connection(text, kind, active = false) {
    at("connection").textContent = text;
    at("connection").className = `status ${kind}`;
    for (const button of document.querySelectorAll("button[data-name]")) button.disabled = !active;
  }

  function end() {
    over = true;
    connection("run over", "");
    show("answer", "");
  }

  function take(frame) {
    if (frame.fixed) {
      fixed = frame.fixed;
      show("run", `${fixed.namespace}, ${fixed.mode}, scenario ${fixed.scenario}, ${fixed.duration} s`);
    }
    if (frame.run !== run) { run = frame.run; clear(); }
    document.body.dataset.start = frame.start;
    if (at("stage").textContent !== frame.stage) {
      show("stage", frame.stage);
      document.body.dataset.stageBefore = lastTick;
    }
    lastTick = frame.tick;
    press(frame);
    addSamples(frame.samples);
    if (frame.nodes) addNodes(frame.nodes);
    if (frame.image) drawStar(frame.image);
    if (frame.indices) addIndices(frame.indices);
    if (frame.spectrum) {
      charts.spectrum.setData([frame.spectrum.frequency || [], frame.spectrum.density || []]);
      show("spectrum-note", frame.spectrum.reason || "");
    }
    charts.los.setData([recent.t, recent.x, recent.y]);
    charts.actuators.setData([recent.t, recent.fsm, recent.pma]);
    drawCloud();
    if (frame.over) end();
    else connection(frame.tick < 0 ? "waiting for the run" : "running", "ok", true);
  }

  function connect() {
    const socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/data`);
    socket.onmessage = (message) => take(JSON.parse(message.data));
    socket.onclose = (closed) => {
      if (closed.code === NORMAL) end();
      if (over) return;
      connection("connection lost", "bad");
      setTimeout(connect, 2000);
    };
  }

  async function act(button) {
    const answer = at("answer");
    answer.className = "";
    show("answer", "asked");
    try {
      const response = await fetch("/action", {
        method: "POST", headers: { "X-Token": token },
        body: JSON.stringify({ name: button.dataset.name, value: JSON.parse(button.dataset.value) }),
      });
      const { error } = await response.json();
      if (over) return;
      answer.className = error ? "bad" : "";
      show("answer", error || `${button.dataset.name} ${button.textContent}: accepted`);
    } catch (error) {
      if (over) return;
      answer.className = "bad";
      show("answer", "no answer from the server");
    }
  }

  makeCharts();
  for (const button of document.querySelectorAll("button[data-name]")) button.addEventListener("click", () => act(button));
  connect();
})();
