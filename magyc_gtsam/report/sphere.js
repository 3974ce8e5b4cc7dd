// Points about a sphere that can be turned: drag, arrow keys or the buttons; the wheel with Ctrl zooms.
"use strict";

const multiply = (a, b) => a.map((row) => [0, 1, 2].map((j) => row[0] * b[0][j] + row[1] * b[1][j] + row[2] * b[2][j]));
const about = {
  x: (t) => [[1, 0, 0], [0, Math.cos(t), -Math.sin(t)], [0, Math.sin(t), Math.cos(t)]],
  y: (t) => [[Math.cos(t), 0, Math.sin(t)], [0, 1, 0], [-Math.sin(t), 0, Math.cos(t)]],
};
// Rows: what points to the right, upwards and to the viewer.
const VIEWS = { x: [[0, 1, 0], [0, 0, 1], [1, 0, 0]], y: [[-1, 0, 0], [0, 0, 1], [0, 1, 0]], z: [[0, 1, 0], [-1, 0, 0], [0, 0, 1]] };
const OBLIQUE = multiply(about.x(0.45), multiply(about.y(-0.6), VIEWS.x));

function drawSphere(figure, spec) {
  const place = figure.querySelector(".plot");
  const canvas = document.createElement("canvas");
  canvas.tabIndex = 0;
  canvas.setAttribute("aria-label", "Turn by dragging or with the arrow keys");
  place.append(canvas);
  const unpacked = (each) => ({ ...each, points: numbers(each.points), shown: true });
  const counted = (found) => found && { ...found, seconds: numbers(found.seconds), shown: true };
  let clouds = spec.clouds.map(unpacked);
  let cells = counted(spec.cells);
  let view = OBLIQUE;
  let zoom = 1;
  let size = 0;

  /** The fitted ellipsoids, without those whose points are hidden. */
  const outlines = () => (spec.outlines || []).filter((o) => !clouds.some((c) => c.colour === o.colour && !c.shown));

  /** The middle of what is shown, and the radius of a ball about it that holds all of it, however it is turned. */
  function extent() {
    const boxes = clouds.filter((c) => c.shown && c.points.length);
    if (!boxes.length) return { middle: [0, 0, 0], reach: 1.3 * spec.radius };
    const low = [Infinity, Infinity, Infinity];
    const high = [-Infinity, -Infinity, -Infinity];
    for (const cloud of boxes) {
      for (let k = 0; k < cloud.points.length; k++) {
        low[k % 3] = Math.min(low[k % 3], cloud.points[k]);
        high[k % 3] = Math.max(high[k % 3], cloud.points[k]);
      }
    }
    const aboutZero = boxes.some((c) => c.colour === "calibrated") || (cells && cells.shown);
    if (aboutZero) {
      for (let k = 0; k < 3; k++) { low[k] = Math.min(low[k], -spec.radius); high[k] = Math.max(high[k], spec.radius); }
    }
    const middle = low.map((l, k) => (l + high[k]) / 2);
    const away = (x, y, z) => Math.hypot(x - middle[0], y - middle[1], z - middle[2]);
    let reach = aboutZero ? away(0, 0, 0) + 1.2 * spec.radius : 0;
    for (const { points } of boxes) {
      for (let k = 0; k < points.length; k += 3) reach = Math.max(reach, away(points[k], points[k + 1], points[k + 2]));
    }
    // Fitted ellipsoids too, unless one is so large that the points would vanish.
    const most = 2 * reach;
    for (const { matrix, centre } of outlines()) {
      reach = Math.max(reach, Math.min(most, away(...centre) + Math.max(...matrix.map((row) => Math.hypot(...row)))));
    }
    return { middle, reach: Math.max(1.05 * reach, 1e-9) };
  }

  function draw() {
    const ratio = window.devicePixelRatio || 1;
    canvas.width = size * ratio;
    canvas.height = size * ratio;
    canvas.style.width = canvas.style.height = `${size}px`;
    const ctx = canvas.getContext("2d");
    ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
    ctx.clearRect(0, 0, size, size);
    const { middle, reach } = extent();
    const scale = (zoom * size) / 2 / reach;
    const seen = (x, y, z) => {
      const p = [x - middle[0], y - middle[1], z - middle[2]];
      const [right, up, near] = view.map((row) => row[0] * p[0] + row[1] * p[1] + row[2] * p[2]);
      return [size / 2 + scale * right, size / 2 - scale * up, near];
    };
    if (cells && cells.shown) paintCells(ctx, seen);
    for (const outline of outlines()) drawOutline(ctx, seen, outline);
    for (const cloud of clouds) {
      if (!cloud.shown) continue;
      ctx.fillStyle = colourOf(cloud.colour);
      for (let k = 0; k < cloud.points.length; k += 3) {
        const [x, y, near] = seen(cloud.points[k], cloud.points[k + 1], cloud.points[k + 2]);
        ctx.globalAlpha = near > 0 ? 0.75 : 0.25;
        ctx.fillRect(x - 1.2, y - 1.2, 2.4, 2.4);
      }
      ctx.globalAlpha = 1;
    }
    if (spec.now) {
      const [x, y, near] = seen(...spec.now);
      ctx.strokeStyle = colourOf("ink");
      ctx.globalAlpha = near > 0 ? 1 : 0.35;
      ctx.lineWidth = 3;
      ctx.beginPath();
      ctx.arc(x, y, 8, 0, 2 * Math.PI);
      ctx.stroke();
      ctx.lineWidth = 1;
      ctx.globalAlpha = 1;
    }
    ctx.font = "13px system-ui, sans-serif";
    ctx.textAlign = "center";
    ctx.textBaseline = "middle";
    for (const [name, x, y, z] of [["x", 1, 0, 0], ["y", 0, 1, 0], ["z", 0, 0, 1]]) {
      const end = 1.15 * spec.radius;
      const [x0, y0] = seen(0, 0, 0);
      const [x1, y1] = seen(end * x, end * y, end * z);
      ctx.strokeStyle = colourOf("soft");
      ctx.beginPath();
      ctx.moveTo(x0, y0);
      ctx.lineTo(x1, y1);
      ctx.stroke();
      ctx.fillStyle = colourOf("ink");
      ctx.fillText(name, x1 + 0.06 * (x1 - x0), y1 + 0.06 * (y1 - y0));
    }
    figure.dataset.view = view.flat().map((v) => v.toFixed(3)).join(" ");
    figure.dataset.zoom = zoom.toFixed(3);
  }

  function paintCells(ctx, seen) {
    const { longitudes, latitudes, seconds } = cells;
    const most = Math.log(1 + Math.max(...seconds));
    const corner = (i, j) => {
      const s = -1 + (2 * i) / latitudes;
      const c = Math.sqrt(Math.max(0, 1 - s * s)) * spec.radius;
      const t = -Math.PI + (2 * Math.PI * j) / longitudes;
      return [c * Math.cos(t), c * Math.sin(t), s * spec.radius];
    };
    for (let i = 0; i < latitudes; i++) {
      for (let j = 0; j < longitudes; j++) {
        const time = seconds[i * longitudes + j];
        const normal = corner(i + 0.5, j + 0.5);
        const near = view[2][0] * normal[0] + view[2][1] * normal[1] + view[2][2] * normal[2];
        if (near < 0) continue;
        ctx.beginPath();
        for (const [a, b] of [[i, j], [i, j + 1], [i + 1, j + 1], [i + 1, j]]) ctx.lineTo(...seen(...corner(a, b)).slice(0, 2));
        ctx.closePath();
        ctx.fillStyle = time > 0 ? faded(colourOf("visited"), 0.15 + (0.45 * Math.log(1 + time)) / most) : faded(colourOf("grid"), 0.35);
        ctx.fill();
      }
    }
  }

  /** Three great circles of {matrix u + centre}. */
  function drawOutline(ctx, seen, { matrix, centre, colour }) {
    ctx.strokeStyle = colourOf(colour);
    ctx.lineWidth = 1;
    for (const [a, b] of [[0, 1], [0, 2], [1, 2]]) {
      ctx.beginPath();
      for (let k = 0; k <= 72; k++) {
        const u = [0, 0, 0];
        u[a] = Math.cos((k * Math.PI) / 36);
        u[b] = Math.sin((k * Math.PI) / 36);
        ctx.lineTo(...seen(...matrix.map((row, r) => centre[r] + row[0] * u[0] + row[1] * u[1] + row[2] * u[2])).slice(0, 2));
      }
      ctx.stroke();
    }
  }

  function turn(right, up) {
    view = multiply(about.x(up), multiply(about.y(right), view));
    draw();
  }

  canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
  canvas.addEventListener("pointermove", (event) => {
    if (event.buttons) turn(event.movementX / 120, event.movementY / 120);
  });
  canvas.addEventListener("wheel", (event) => {
    if (!event.ctrlKey) return;
    event.preventDefault();
    zoom = Math.min(20, Math.max(0.5, zoom * Math.exp(-event.deltaY / 400)));
    draw();
  }, { passive: false });
  canvas.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1] }[event.key];
    if (step) { event.preventDefault(); turn(...step); }
  });
  for (const button of figure.querySelectorAll("button[data-view]")) {
    button.addEventListener("click", () => { view = VIEWS[button.dataset.view]; zoom = 1; draw(); });
  }
  for (const button of figure.querySelectorAll("button[data-series]")) {
    button.addEventListener("click", () => {
      const shown = button.getAttribute("aria-pressed") !== "true";
      button.setAttribute("aria-pressed", shown);
      (button.dataset.series === "cells" ? cells : clouds[+button.dataset.series]).shown = shown;
      draw();
    });
  }
  const resize = (width) => { size = Math.min(width, 420); draw(); };
  resize(place.clientWidth);
  /** Other points, cells and present direction, seen from where it is looked at. */
  const update = (next) => {
    clouds = next.clouds.map(unpacked);
    cells = counted(next.cells);
    spec.now = next.now;
    draw();
  };
  return { resize, redraw: draw, update };
}
