// Logs: dropped, chosen, looked at, and what is run on them.
"use strict";

const known = { logs: [], results: [] };
let log = null; // the one that is looked at
// Jobs that this page has started and whose end it has not shown; a reload keeps them.
const mine = new Set(JSON.parse(sessionStorage.getItem("jobs") || "[]"));
let listed = []; // the jobs of all pages, as last told
const RUNS = { look: "Looking at", calibrate: "Calibrating from", gap: "Gap of", compare: "Comparing on", history: "History of" };

function drawLogs() {
  const rows = known.logs.map((each) => element("li", {},
    element("button", { type: "button", onclick: () => open(each) }, element("span", { textContent: each.name }), element("span", { className: "soft", textContent: `${sized(each.size)}${each.uploaded ? " · dropped here, kept for a day" : ""}` })),
    element("input", { type: "checkbox", value: each.key, ariaLabel: `${each.name} for a history`, onchange: drawSeveral })));
  $("#logs").replaceChildren(...rows);
  $("#folder").classList.toggle("empty", !rows.length);
  drawSeveral();
}

const chosen_logs = () => [...document.querySelectorAll("#logs input:checked")].map((box) => box.value);
function drawSeveral() {
  const count = chosen_logs().length;
  $("#several").hidden = count < 2;
  $("#several button").textContent = `History of these ${count} logs`;
}

/** Look at a log; the result of another is closed. */
function open(each) {
  const other = !log || log.key !== each.key;
  if (other) $("#result").hidden = true;
  go({ log: each.key, ...(other ? { result: "" } : {}) });
  showLog(each);
  $("#log").scrollIntoView({ block: "start" });
}

function showLog(each) {
  const same = log && log.key === each.key;
  log = each;
  $("#log").hidden = false;
  $("#log h2").textContent = each.name;
  $("#remove").hidden = !each.uploaded;
  if (!same) {
    $("#holds").textContent = "reading …";
    $("#content").hidden = true;
    drawStrip(null);
    for (const field of document.querySelectorAll("#reading [name]")) field.value = "";
  }
  run("look");
  drawCommand();
}

function closeLog() {
  log = null;
  $("#log").hidden = true;
}

const reading = () => Object.fromEntries([...document.querySelectorAll("#reading [name]")].map((field) => [field.name, field.value.trim()]).filter(([, value]) => value));

let looking = ""; // the last job that looks at the log; what earlier ones find no longer counts

async function run(kind, logs = [log.key]) {
  complain("");
  if (kind === "look") looking = "";
  const asked = { kind, logs, reading: reading() };
  if (kind !== "look" && kind !== "history" && strip.asked) Object.assign(asked, { start: strip.start, end: strip.end });
  const job = await ask("/api/jobs", { body: asked });
  if (kind === "look") looking = job.key;
  mine.add(job.key);
  keepMine();
  await showEnded(); // its end may have been told before its key
}

function drawCommand() {
  if (!log) return;
  const quoted = (text) => (/^[\w./:-]+$/.test(text) ? text : `'${text.replaceAll("'", "'\\''")}'`);
  const options = Object.entries(reading()).map(([name, value]) => `--${name.replace("_", "-")} ${quoted(value)}`);
  if (strip.start !== null) options.unshift(`--start ${strip.start}`);
  if (strip.end !== null) options.push(`--end ${strip.end}`);
  $("#as-command code").textContent = ["magyc-gtsam calibrate", quoted(log.name), ...options].join(" ");
}

/** What `magyc-gtsam info` says of a log. */
function drawLook(found) {
  const turned = found.turned === null ? "no gyroscope" : `turned by ${Math.round((found.turned * 180) / Math.PI)}° in total`;
  const long = found.duration > 120 ? `${(found.duration / 60).toFixed(1)} min` : `${found.duration.toFixed(1)} s`;
  $("#holds").textContent = [found.format, long, found.problem === null ? turned : `cannot be read: ${asDoneHere(found.problem)}`].join(" · ");
  $("#holds").className = found.problem === null ? "soft" : "caution";
  $("#reading").open = $("#reading").open || found.problem !== null;
  const head = ["source", "samples", "Hz", "serves as"];
  const rows = found.sources.map((each) => [each.name, each.count, each.rate === null ? "" : each.rate.toFixed(1), each.serves_as.join(", ")]);
  const table = element("table", {}, element("thead", {}, element("tr", {}, ...head.map((text) => element("th", { textContent: text })))),
    ...rows.map(([first, ...rest]) => element("tr", {}, element("th", { textContent: first }), ...rest.map((text) => element("td", { textContent: text })))));
  const notes = element("ul", {}, ...found.warnings.map((text) => element("li", { textContent: asDoneHere(text) })));
  $("#content div").replaceChildren(table, notes);
  $("#content").hidden = false;
  $("#sources").replaceChildren(...found.sources.map((each) => element("option", { value: each.name })));
  drawStrip(found.strip || null);
}

const active = (job) => ["waiting", "running"].includes(job.state);
const keepMine = () => sessionStorage.setItem("jobs", JSON.stringify([...mine]));

/** Rows of the jobs that run or wait; what has ended and was started here is looked at. */
async function drawJobs({ jobs }) {
  listed = jobs;
  const shown = jobs.filter((job) => active(job) && (job.kind !== "look" || job.left_s > 1));
  $("#jobs").hidden = !shown.length;
  $("#jobs").replaceChildren(...shown.map((job) => {
    const share = job.state === "running" && job.share > 0 ? Math.round(100 * job.share) : null;
    const left = job.left_s === null ? "" : `, about ${job.left_s < 90 ? `${Math.ceil(job.left_s)} s` : `${Math.ceil(job.left_s / 60)} min`} left`;
    const words = job.state === "waiting" ? `waiting: number ${job.ahead} in the queue (one job per core)` : `${job.stage || "starting"}${share === null ? "" : ` ${share} %`}${left}`;
    return element("div", { className: "job" }, element("p", {}, element("b", { textContent: `${RUNS[job.kind]} ${job.title}` }), element("br"), element("span", { className: "soft", textContent: words })),
      element("button", { type: "button", textContent: "Cancel", onclick: () => ask(`/api/jobs/${job.key}`, { method: "DELETE" }) }),
      element("progress", { max: 100, ...(share === null ? {} : { value: share }) }));
  }));
  await showEnded();
}

async function showEnded() {
  for (const job of listed.slice().reverse()) {
    if (active(job) || !mine.delete(job.key)) continue;
    keepMine();
    await ended(job);
  }
}

async function ended(job) {
  const here = job.kind !== "look" || (log && job.key === looking);
  if (job.state === "failed" && here) {
    if (job.kind === "look") $("#holds").textContent = `cannot be read: ${asDoneHere(job.message)}`;
    else complain(asDoneHere(job.message || "the job failed"));
  }
  if (job.state !== "done") return;
  if (job.kind === "look" && here) drawLook((await ask(`/api/jobs/${job.key}`)).output);
  if (job.kind !== "look" && job.result) {
    await refresh();
    await openResult(job.result);
  }
}

async function upload(files) {
  for (const file of files) {
    const bar = element("progress", { max: 1, value: 0 });
    const stop = element("button", { type: "button", textContent: "Cancel" });
    const row = element("div", { className: "job" }, element("p", { textContent: `${file.name}, ${sized(file.size)}` }), stop, bar);
    $("#uploads").append(row);
    try {
      const made = await send(file, (share) => { bar.value = share; }, (abort) => { stop.onclick = abort; });
      await refresh();
      open(made);
      if (files.length === 1) await run("calibrate");
    } catch (error) {
      if (error.message) console.info(error.message);
    } finally {
      row.remove();
    }
  }
}

$("#files").addEventListener("change", async (event) => {
  await upload([...event.target.files]);
  event.target.value = "";
});
addEventListener("dragover", (event) => { event.preventDefault(); document.body.classList.add("over"); });
addEventListener("dragleave", (event) => { if (!event.relatedTarget) document.body.classList.remove("over"); });
addEventListener("drop", (event) => {
  event.preventDefault();
  document.body.classList.remove("over");
  show("logs");
  upload([...event.dataTransfer.files]);
});
for (const button of document.querySelectorAll("[data-run]")) button.addEventListener("click", () => run(button.dataset.run));
$("#several button").addEventListener("click", () => run("history", chosen_logs()));
$("#again").addEventListener("click", () => run("look"));
$("#remove").addEventListener("click", async () => {
  await ask(`/api/logs/${log.key}`, { method: "DELETE" });
  closeLog();
  go({ log: "" });
  await refresh();
});
document.addEventListener("interval", drawCommand);
$("#reading").addEventListener("input", drawCommand);
$("#reading").addEventListener("change", () => run("look"));
