// The sensor on its vehicle, and the turns of the next move about its axes, by the right-hand rule.
"use strict";

const SVG = "http://www.w3.org/2000/svg";

function drawVehicle(place, move) {
  const svg = document.createElementNS(SVG, "svg");
  svg.setAttribute("viewBox", "-2.1 -1.75 4.2 3.3");
  svg.setAttribute("role", "img");
  svg.setAttribute("aria-label", move ? move.sentence : "the vehicle");
  const at = (p) => OBLIQUE.slice(0, 2).map((row, k) => (k ? -1 : 1) * (row[0] * p[0] + row[1] * p[1] + row[2] * p[2]));
  const path = (points, options) => {
    const made = document.createElementNS(SVG, "path");
    made.setAttribute("d", points.map((p, k) => `${k ? "L" : "M"}${at(p).map((v) => v.toFixed(3)).join(" ")}`).join("") + (options.closed ? "Z" : ""));
    for (const [name, value] of Object.entries({ fill: "none", "stroke-linecap": "round", "stroke-width": 0.03, ...options.look })) made.setAttribute(name, value);
    svg.append(made);
  };
  const word = (text, p, colour) => {
    const made = document.createElementNS(SVG, "text");
    const [x, y] = at(p);
    for (const [name, value] of Object.entries({ x, y, fill: colour, "font-size": 0.22, "text-anchor": "middle", "dominant-baseline": "middle", "font-weight": 600 })) made.setAttribute(name, value);
    made.textContent = text;
    svg.append(made);
  };
  const body = { fill: "color-mix(in srgb, var(--calibrated) 30%, var(--card))", stroke: "var(--soft)" };
  const [l, w, h] = [0.85, 0.42, 0.2];
  const nose = [l + 0.4, 0, 0];
  // Seen from above, in front and the left: the faces that are in sight, the far ones first.
  path([[-l, w, -h], [l, w, -h], [l, w, h], [-l, w, h]], { closed: true, look: body });
  path([[-l, -w, h], [l, -w, h], [l, w, h], [-l, w, h]], { closed: true, look: body });
  path([[l, w, h], nose, [l, w, -h]], { closed: true, look: body });
  path([[l, -w, h], [l, w, h], nose], { closed: true, look: body });
  path([[l, -w, -h], [l, -w, h], nose], { closed: true, look: body });
  for (const [name, p] of [["x", [1.75, 0, 0]], ["y", [0, 1.3, 0]], ["z", [0, 0, 1.25]]]) {
    path([p.map((v) => 0.6 * v), p], { look: { stroke: "var(--soft)" } });
    word(name, p.map((v) => 1.1 * v), "var(--ink)");
  }
  const turns = move ? [...(move.axis ? [["xyz".indexOf(move.axis), Math.sign(move.degrees), "var(--raw)", `1. ${Math.abs(move.degrees)}°`]] : []), [2, 1, "var(--second)", move.axis ? "2. once" : "once"]] : [];
  for (const [axis, way, colour, text] of turns) {
    const [a, b] = [(axis + 1) % 3, (axis + 2) % 3];
    const radius = [0.72, 1.15, 1.25][axis];
    const along = [1.35, 0.85, 0.75][axis];
    const point = (t, r = radius) => {
      const p = [0, 0, 0];
      p[axis] = along;
      p[a] = r * Math.cos(t);
      p[b] = r * Math.sin(t);
      return p;
    };
    const angles = Array.from({ length: 41 }, (_, k) => way * (-0.6 + (k / 40) * 4.6));
    path(angles.map((t) => point(t)), { look: { stroke: colour, "stroke-width": 0.07 } });
    const end = angles[40];
    path([point(end - way * 0.28, radius * 1.16), point(end + way * 0.06), point(end - way * 0.28, radius * 0.84)], { look: { stroke: colour, "stroke-width": 0.07, "stroke-linejoin": "round" } });
    word(text, point(end + way * 0.55, radius * 1.25), colour);
  }
  place.replaceChildren(svg);
}
