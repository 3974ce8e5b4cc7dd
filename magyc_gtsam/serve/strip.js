// Strength of the field and turn rate over time, and the interval that is dragged on them.
"use strict";

const packed = (values) => {
  const bytes = new Uint8Array(new Float32Array(values.map((v) => (v === null ? NaN : v))).buffer);
  let text = "";
  for (let k = 0; k < bytes.length; k += 4096) text += String.fromCharCode(...bytes.subarray(k, k + 4096));
  return btoa(text);
};

const strip = { from: 0, to: 1, start: null, end: null, charts: [], asked: null };

/** Draw a log's strip; null clears it. */
function drawStrip(found) {
  const frame = $("#strip-charts");
  frame.replaceChildren();
  strip.asked = found;
  strip.charts = [];
  $("#strip").hidden = !found;
  if (!found) return choose(null, null);
  [strip.from, strip.to] = [found.start, found.end];
  const minutes = found.end - found.start > 180;
  const rows = [["Strength of the field", found.field, "raw"], ["Turn rate", found.rate, "second"]].filter((row) => row[1]);
  rows.forEach(([title, steps, colour], k) => {
    const figure = element("figure", { className: "chart" }, element("h3", { textContent: `${title} (${steps.unit})` }), element("div", { className: "plot" }), element("p", { className: "readout", hidden: true }));
    frame.append(figure);
    const drawn = drawLines(figure, {
      x: packed(steps.time), divide: minutes ? 60 : 1, xlabel: k === rows.length - 1 ? (minutes ? "Time (min)" : "Time (s)") : "", ylabel: "", height: k === rows.length - 1 ? 190 : 160,
      xlim: [found.start, found.end], series: [{ label: title, colour, y: packed(steps.mean), low: packed(steps.low), high: packed(steps.high) }],
    });
    figure.plot.hooks.draw.push(placeLayer); // uPlot applies a size later than it is set
    strip.charts.push({ figure, drawn });
  });
  frame.append(layer());
  const inside = (value) => (value > strip.from && value < strip.to ? value : null);
  choose(inside(strip.start), inside(strip.end)); // what was chosen before the log was read again
}

/** What takes the fingers: over all charts, as wide as their time axis. */
function layer() {
  const cuts = [element("div", { className: "cut" }), element("div", { className: "cut" })];
  const edges = ["start", "end"].map((name) => element("div", { className: "edge", tabIndex: 0, ariaLabel: `${name} of the interval`, role: "slider" }));
  const made = element("div", { id: "layer" }, ...cuts, ...edges);
  const seconds = (event) => {
    const box = made.getBoundingClientRect();
    const share = Math.min(1, Math.max(0, (event.clientX - box.left) / box.width));
    return Math.round((strip.from + share * (strip.to - strip.from)) * 10) / 10;
  };
  let anchor = null;
  made.addEventListener("pointerdown", (event) => {
    made.setPointerCapture(event.pointerId);
    const edge = edges.indexOf(event.target);
    anchor = edge < 0 ? seconds(event) : edge === 0 ? bounds()[1] : bounds()[0];
    made.dataset.moved = edge < 0 ? "" : "yes";
  });
  made.addEventListener("pointermove", (event) => {
    if (anchor === null) return;
    const at = seconds(event);
    if (!made.dataset.moved && Math.abs(at - anchor) < 0.01 * (strip.to - strip.from)) return;
    made.dataset.moved = "yes";
    choose(Math.min(at, anchor), Math.max(at, anchor));
  });
  const ended = () => { anchor = null; };
  made.addEventListener("pointerup", ended);
  made.addEventListener("pointercancel", ended);
  edges.forEach((edge, k) => edge.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (!step) return;
    event.preventDefault();
    const both = bounds();
    both[k] = Math.round(10 * Math.min(strip.to, Math.max(strip.from, both[k] + step * (event.shiftKey ? 10 : 1)))) / 10;
    if (both[0] < both[1]) choose(...both);
  }));
  return made;
}

const bounds = () => [strip.start ?? strip.from, strip.end ?? strip.to];

/** Take an interval, s; null for the end of the log that it is. */
function choose(start, end) {
  const near = (value, limit) => value === null || Math.abs(value - limit) < 0.051;
  [strip.start, strip.end] = [near(start, strip.from) ? null : start, near(end, strip.to) ? null : end];
  const [from, to] = bounds();
  $("#start").value = strip.asked ? from.toFixed(1) : "";
  $("#end").value = strip.asked ? to.toFixed(1) : "";
  placeLayer();
  document.dispatchEvent(new Event("interval"));
}

function placeLayer() {
  const made = $("#layer");
  if (!made || !strip.charts.length) return;
  const frame = $("#strip-charts").getBoundingClientRect();
  const boxes = strip.charts.map(({ figure }) => figure.plot.over.getBoundingClientRect());
  const [first, last] = [boxes[0], boxes[boxes.length - 1]];
  Object.assign(made.style, { left: `${first.left - frame.left}px`, width: `${first.width}px`, top: `${first.top - frame.top}px`, height: `${last.bottom - first.top}px` });
  const [a, b] = bounds().map((t) => (100 * (t - strip.from)) / (strip.to - strip.from || 1));
  const [before, after, start, end] = made.children;
  before.style.cssText = `left:0;width:${a}%`;
  after.style.cssText = `left:${b}%;right:0`;
  start.style.left = `${a}%`;
  end.style.left = `${b}%`;
  start.ariaValueText = `${bounds()[0]} s`;
  end.ariaValueText = `${bounds()[1]} s`;
}

new ResizeObserver(() => {
  for (const { figure, drawn } of strip.charts) {
    const width = figure.querySelector(".plot").clientWidth;
    if (width) drawn.resize(width);
  }
}).observe($("#strip-charts"));
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => strip.charts.forEach(({ drawn }) => drawn.redraw()));
for (const name of ["start", "end"]) {
  $(`#${name}`).addEventListener("change", () => {
    const [a, b] = [parseFloat($("#start").value), parseFloat($("#end").value)];
    if (a < b) choose(Math.max(a, strip.from), Math.min(b, strip.to));
    else choose(strip.start, strip.end);
  });
}
$("#whole").addEventListener("click", () => choose(null, null));
