// Draws each figure when it comes into view, and again where the width, the colours or the paper change.
"use strict";

const drawn = new Map();
const PAPER = { wide: 690, ordinary: 330 };

function draw(figure) {
  if (drawn.has(figure) || !figure.querySelector(".plot").clientWidth) return;
  const spec = JSON.parse(figure.querySelector("script[type='application/json']").textContent);
  drawn.set(figure, (spec.kind === "sphere" ? drawSphere : drawLines)(figure, spec));
}

const figures = [...document.querySelectorAll("figure.chart")];
const seen = new IntersectionObserver((entries) => {
  for (const entry of entries) if (entry.isIntersecting) draw(entry.target);
}, { rootMargin: "600px" });
const sized = new ResizeObserver((entries) => {
  for (const { target } of entries) {
    const figure = target.closest("figure");
    if (drawn.has(figure) && target.clientWidth && !document.documentElement.classList.contains("paper")) drawn.get(figure).resize(target.clientWidth);
  }
});
for (const figure of figures) {
  seen.observe(figure);
  sized.observe(figure.querySelector(".plot"));
}
for (const details of document.querySelectorAll("details")) {
  details.addEventListener("toggle", () => details.querySelectorAll("figure.chart").forEach(draw));
}
/** What a link leads to is opened. */
function openTarget() {
  const target = location.hash && document.getElementById(location.hash.slice(1));
  if (target && target.tagName === "DETAILS") { target.open = true; target.scrollIntoView(); }
}
addEventListener("hashchange", openTarget);
openTarget();
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => drawn.forEach((each) => each.redraw()));

addEventListener("beforeprint", () => {
  document.documentElement.classList.add("paper");
  for (const figure of figures) {
    draw(figure);
    const each = drawn.get(figure);
    if (each) each.resize(figure.classList.contains("wide-chart") ? PAPER.wide : PAPER.ordinary);
    if (each) each.redraw();
  }
});
addEventListener("afterprint", () => {
  document.documentElement.classList.remove("paper");
  drawn.forEach((each, figure) => { each.resize(figure.querySelector(".plot").clientWidth); each.redraw(); });
});

for (const button of document.querySelectorAll("button.copy")) {
  button.addEventListener("click", async () => {
    const block = document.getElementById(button.dataset.block);
    try {
      await navigator.clipboard.writeText(block.textContent);
      button.textContent = "Copied";
    } catch {
      getSelection().selectAllChildren(block);
      button.textContent = document.execCommand("copy") ? "Copied" : "Selected: press Ctrl+C";
    }
    setTimeout(() => { button.textContent = "Copy"; }, 2000);
  });
}
