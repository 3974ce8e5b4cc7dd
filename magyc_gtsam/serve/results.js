// Results: listed, and one of them with its verdict, numbers and what can be copied.
"use strict";

const KINDS = { calibrate: "calibration", gap: "gap", compare: "comparison", history: "history", live: "live" };

function drawResults() {
  const rows = known.results.map((each) => element("li", {}, element("button", { type: "button", onclick: () => openResult(each.key) },
    element("span", { className: each.trusted === null ? "" : each.trusted ? "good" : "bad", textContent: `${each.logs || each.key}` }),
    element("span", { className: "soft", textContent: `${KINDS[each.kind]} · ${new Date(each.time * 1000).toLocaleString()}${each.sentence ? ` · ${each.sentence.replace(/^[✔✘] /, "")}` : ""}` }))));
  $("#results").replaceChildren(...(rows.length ? rows : [element("li", { className: "soft", textContent: "No results yet. Every result is kept in the folder and listed here." })]));
}

async function refresh() {
  const state = await ask("/api/state");
  [known.logs, known.results] = [state.logs, state.results];
  drawLogs();
  drawResults();
  return state;
}

function parameters(rows) {
  const three = rows.filter((row) => row.length === 4);
  const table = element("div", { className: "wide" }, element("table", { className: "rows" },
    element("thead", {}, element("tr", {}, ...["", "x", "y", "z"].map((text) => element("th", { textContent: text })))),
    ...three.map(([name, ...values]) => element("tr", {}, element("th", { textContent: name }), ...values.map((text) => element("td", { textContent: minus(text).replace(" ± ", " ±\u00a0") }))))));
  return [table, ...rows.filter((row) => row.length === 2).map(([name, value]) => element("p", { textContent: `${name}: ${minus(value)}` }))];
}

function exported(key, { name, file, text }) {
  const copy = element("button", { type: "button", textContent: "Copy", onclick: () => copied(copy, text) });
  const there = file ? `/results/${key}/${encodeURIComponent(file)}` : URL.createObjectURL(new Blob([text], { type: "text/plain" }));
  const keep = element("a", { className: "button", href: there, download: file || `${name}.txt`, textContent: "Download" });
  return element("div", { className: "export" }, element("div", { className: "row" }, element("b", { textContent: name }), copy, keep),
    element("details", {}, element("summary", { textContent: file || "Text" }), element("pre", { textContent: text })));
}

/** What a sentence for a terminal asks for, as it is done here; where it cannot be, that the command line can. */
function asDoneHere(text) {
  const here = text.replace("run `magyc-gtsam gap`", "press Gap").replace(" (--start, --end)", " (drag over the charts)")
    .replace("begin a new --state", "begin a new run (Freeze, then New run)")
    .replace(/--([a-z][a-z-]*)/g, (option, name) => {
      const field = $(`#reading [name=${name.replaceAll("-", "_")}]`);
      return field ? `“${field.labels[0].firstChild.textContent.trim()}”` : option;
    });
  const lacks = [...here.matchAll(/--([a-z][a-z-]*)/g)].some(([, name]) => !$(`#${name}`));
  return lacks ? `${here.replace(/\.$/, "")}; not all of these options are on this page, use the command line` : here;
}

/** With a capital and a full stop. */
const asSentence = (text) => (text ? `${text[0].toUpperCase()}${text.slice(1).replace(/\.$/, "")}.` : "");

async function openResult(key) {
  await showResult(key);
  go({ result: key });
  $("#result").scrollIntoView({ block: "start" });
}

function closeResult() {
  $("#result").hidden = true;
  go({ result: "" });
}

async function showResult(key) {
  const found = await ask(`/api/results/${key}`);
  const [title, ...rest] = asDoneHere(found.sentence || "Done").replace(/^[✔✘] /, "").split(": ");
  const interval = found.interval ? `, ${found.interval[0] ?? "start"} to ${found.interval[1] ?? "end"} s` : "";
  const head = element("header", { className: found.trusted ? "good" : found.trusted === false ? "bad" : "" }, element("h1", { textContent: title }), element("p", { textContent: asSentence(rest.join(": ")) }),
    element("p", { className: "soft origin", textContent: `${found.logs || key}${interval} · ${KINDS[found.kind]} · ${new Date(found.time * 1000).toLocaleString()}` }));
  const actions = element("div", { className: "actions" },
    found.page ? element("a", { className: "button main", href: `/results/${key}/report.html`, target: "_blank", rel: "noopener", textContent: "Open the report" }) : null,
    element("button", { type: "button", className: "quiet", textContent: "Close", onclick: closeResult }));
  const listed = new Set(found.exports.map((each) => each.file));
  const others = found.files.filter((file) => !listed.has(file) && file !== "report.html" && file !== "serve.json");
  const texts = found.exports.length || others.length ? element("section", {}, element("h2", { textContent: found.exports.length ? "To copy" : "Files" }), ...found.exports.map((each) => exported(key, each)),
    ...(others.length ? [element("p", { className: "soft", textContent: "Other files: " }, ...others.flatMap((file) => [element("a", { href: `/results/${key}/${encodeURIComponent(file)}`, download: file, textContent: file }), " "]))] : [])) : null;
  const numbers = found.rows.length ? element("section", {}, element("h2", { textContent: "Parameters" }), ...parameters(found.rows)) : null;
  const [details, most] = [found.details || [], 4]; // as on a terminal
  const remarks = [...(found.notes || []), ...details.slice(0, most), ...(details.length > most ? [`and ${details.length - most} more, in the report`] : [])];
  const notes = remarks.length ? element("section", {}, element("h2", { textContent: "Notes" }), element("ul", {}, ...remarks.map((text) => element("li", { textContent: asDoneHere(text) })))) : null;
  $("#result").replaceChildren(head, actions, ...[notes, numbers, texts].filter(Boolean));
  $("#result").hidden = false;
}
