// Charts over time and other variables, drawn by uPlot from the numbers in each figure.
"use strict";

const colourOf = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
const faded = (colour, share) => colour + Math.round(255 * share).toString(16).padStart(2, "0");
const minus = (text) => String(text).replace(/-(?=[\d.])/g, "−");

function numbers(packed) {
  if (packed === null || packed === undefined) return null;
  const bytes = Uint8Array.from(atob(packed), (c) => c.charCodeAt(0));
  return new Float32Array(bytes.buffer);
}

const orNull = (values) => Array.from(values, (v) => (Number.isNaN(v) ? null : v));
const WHOLE = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10000];
/** Labels of a time axis in UTC, by the step between them (s): ISO dates, 24 hours. */
const DATES = [
  [31536000, "{YYYY}", null, null, null, null, null, null, 1],
  [2419200, "{YYYY}-{MM}", null, null, null, null, null, null, 1],
  [86400, "{MM}-{DD}", "\n{YYYY}", null, null, null, null, null, 1],
  [60, "{HH}:{mm}", "\n{YYYY}-{MM}-{DD}", null, "\n{MM}-{DD}", null, null, null, 1],
  [1, "{HH}:{mm}:{ss}", "\n{YYYY}-{MM}-{DD}", null, "\n{MM}-{DD}", null, null, null, 1],
  [0.001, ":{ss}.{fff}", "\n{YYYY}-{MM}-{DD} {HH}:{mm}", null, "\n{MM}-{DD} {HH}:{mm}", null, "\n{HH}:{mm}", null, 1],
];
const MINUTES = [60, 120, 300, 600, 1200, 1800, 3600];
const HOURS = [1800, 3600, 7200, 10800, 21600, 43200, 86400];

function rounded(value, span) {
  if (value === null || value === undefined) return "–";
  const digits = Math.max(0, Math.min(4, 2 - Math.floor(Math.log10(span || 1))));
  return minus(value.toFixed(digits));
}

/** uPlot's columns: x, then for each series its values and, where it has them, the lowest and highest. */
function columns(spec) {
  const data = [orNull(numbers(spec.x)).map((x) => x + (spec.dates || 0))];
  const series = [{}];
  const bands = [];
  const groups = [];
  for (const each of spec.series) {
    const stroke = () => colourOf(each.colour);
    const style = {
      line: { stroke, width: 1.5, points: { show: false } },
      dashed: { stroke, width: 1.5, dash: [6, 4], points: { show: false } },
      dots: { stroke, paths: () => null, points: { show: true, size: 4, width: 0, fill: () => faded(colourOf(each.colour), 0.6) } },
      bars: { stroke, fill: () => faded(colourOf(each.colour), 0.5), width: 1, paths: uPlot.paths.bars({ size: [1] }), points: { show: false } },
      errors: { stroke, paths: () => null, points: { show: true, size: 6, width: 0, fill: stroke } },
      marked: { stroke, width: 1.5, points: { show: true, size: 5, width: 0, fill: stroke } },
    }[each.style || "line"];
    const group = [series.length];
    if (each.y) {
      data.push(orNull(numbers(each.y)));
      series.push({ label: each.label, ...style, spanGaps: false });
    } else {
      group.pop();
    }
    if (each.low) {
      const first = series.length;
      data.push(orNull(numbers(each.high)), orNull(numbers(each.low)));
      series.push({ width: 0, points: { show: false } }, { width: 0, points: { show: false } });
      const share = each.style === "errors" ? 0 : each.y ? 0.25 : 0.18;
      bands.push({ series: [first, first + 1], fill: () => faded(colourOf(each.colour), share) });
      group.push(first, first + 1);
    }
    groups.push(group);
  }
  return { data, series, bands, groups };
}

/** A bar from the lowest to the highest at each point. */
function errorBars(u, spec, groups) {
  const { ctx, bbox } = u;
  ctx.save();
  ctx.beginPath();
  ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
  ctx.clip();
  ctx.lineWidth = 1.5 * devicePixelRatio;
  spec.series.forEach((each, i) => {
    if (each.style !== "errors" || !each.low || !u.series[groups[i][0]].show) return;
    const [, high, low] = groups[i].map((row) => u.data[row]);
    ctx.strokeStyle = colourOf(each.colour);
    u.data[0].forEach((x, k) => {
      if (high[k] === null || high[k] === undefined) return;
      const left = u.valToPos(x, "x", true);
      ctx.beginPath();
      ctx.moveTo(left, u.valToPos(high[k], "y", true));
      ctx.lineTo(left, u.valToPos(low[k], "y", true));
      ctx.stroke();
    });
  });
  ctx.restore();
}

function axis(label, extra) {
  const ink = () => colourOf("soft");
  return {
    stroke: ink, grid: { stroke: () => faded(colourOf("grid"), 1), width: 1 }, ticks: { stroke: () => colourOf("grid"), width: 1 },
    font: "12px system-ui, sans-serif", labelFont: "12px system-ui, sans-serif", labelSize: 16, label,
    values: (u, ticks) => ticks.map((v) => (v === null ? "" : minus(extra && extra.divide ? +(v / extra.divide).toFixed(4) : +v.toPrecision(6)))),
    ...(extra && extra.axis),
  };
}

/** Dashed level, and stretches that are shaded. */
function decorations(spec) {
  return {
    drawAxes: [(u) => {
      const { ctx, bbox } = u;
      ctx.save();
      ctx.beginPath();
      ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
      ctx.clip();
      for (const [start, end] of spec.spans || []) {
        const left = u.valToPos(start, "x", true);
        ctx.fillStyle = faded(colourOf("disturbed"), 0.25);
        ctx.fillRect(left, bbox.top, Math.max(u.valToPos(end, "x", true) - left, 1), bbox.height);
      }
      ctx.setLineDash([6, 4]);
      ctx.strokeStyle = colourOf("disturbed");
      for (const mark of spec.marks || []) {
        const left = u.valToPos(mark + (spec.dates || 0), "x", true);
        ctx.beginPath();
        ctx.moveTo(left, bbox.top);
        ctx.lineTo(left, bbox.top + bbox.height);
        ctx.stroke();
      }
      ctx.strokeStyle = colourOf("soft");
      for (const level of spec.levels || []) {
        const y = u.valToPos(level, "y", true);
        ctx.beginPath();
        ctx.moveTo(bbox.left, y);
        ctx.lineTo(bbox.left + bbox.width, y);
        ctx.stroke();
      }
      ctx.restore();
    }],
  };
}

const timeCharts = new Set();

function drawLines(figure, spec) {
  const place = figure.querySelector(".plot");
  const { data, series, bands, groups } = columns(spec);
  const xs = data[0];
  const divide = spec.divide || 1;
  const readout = figure.querySelector(".readout");
  const range = spec.ylim ? { range: () => spec.ylim } : spec.log ? { distr: 3 } : {};
  const options = {
    width: place.clientWidth, height: spec.height || 230, legend: { show: false }, series, bands,
    scales: { x: { time: spec.dates !== undefined, distr: spec.logx ? 3 : 1, ...(spec.xlim ? { range: (u, a, b) => (u.zoomed ? [a, b] : spec.xlim) } : {}) }, y: range },
    axes: [
      axis(spec.xlabel, { divide, axis: spec.dates !== undefined ? { values: DATES, space: 70 } : spec.names ? { incrs: WHOLE } : divide > 1 ? { incrs: divide > 60 ? HOURS : MINUTES } : {} }),
      axis(spec.ylabel, { axis: { size: 58 } }),
    ],
    ...(spec.dates !== undefined ? { tzDate: (seconds) => uPlot.tzDate(new Date(seconds * 1e3), "UTC") } : {}),
    cursor: { y: false, points: { size: 6 }, drag: { x: true, y: false, setScale: !spec.strip } },
    hooks: {
      ...decorations(spec),
      draw: [(u) => errorBars(u, spec, groups)],
      setScale: [(u, key) => { if (key === "x") u.zoomed = true; }],
      setCursor: [(u) => {
        const at = u.cursor.idx;
        if (at === null || at === undefined || u.cursor.left < 0) { readout.textContent = ""; return; }
        const parts = [spec.names ? spec.names[at] : `${spec.xname || spec.xlabel.split(" (")[0]} ${rounded(xs[at] / divide, (xs[xs.length - 1] - xs[0]) / divide / 10)}`];
        groups.forEach((group, i) => {
          if (!u.series[group[0]].show || !spec.series[i].y || !spec.series[i].label) return;
          parts.push(`${spec.series[i].label} ${rounded(data[group[0]][at], u.scales.y.max - u.scales.y.min)}`);
        });
        readout.textContent = parts.join(" · ");
      }],
      ...(spec.strip ? { setSelect: [(u) => chosen(figure, spec, u)] } : {}),
    },
  };
  const u = new uPlot(options, data, place);
  u.zoomed = false;
  figure.plot = u;
  for (const button of figure.querySelectorAll(".keys button")) {
    button.addEventListener("click", () => {
      const shown = button.getAttribute("aria-pressed") !== "true";
      button.setAttribute("aria-pressed", shown);
      for (const row of groups[+button.dataset.series]) u.setSeries(row, { show: shown });
    });
  }
  place.addEventListener("dblclick", () => { u.zoomed = false; });
  if (spec.time) timeCharts.add(figure);
  return { resize: (width) => u.setSize({ width, height: spec.height || 230 }), redraw: () => u.redraw(false, true) };
}

/** The interval that was dragged, in the words of the command line; the other charts over time show it. */
function chosen(figure, spec, u) {
  const bar = figure.querySelector(".interval");
  if (u.select.width < 2) {
    bar.hidden = true;
    for (const other of timeCharts) if (other !== figure && other.plot) other.plot.setScale("x", { min: null, max: null });
    return;
  }
  const [start, end] = [u.select.left, u.select.left + u.select.width].map((x) => u.posToVal(x, "x"));
  bar.hidden = false;
  bar.querySelector("code").textContent = `--start ${start.toFixed(1)} --end ${end.toFixed(1)}`;
  for (const other of timeCharts) if (other !== figure && other.plot) other.plot.setScale("x", { min: start, max: end });
}
