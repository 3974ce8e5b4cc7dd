// What is asked of the server, and what it tells by itself.
"use strict";

const $ = (selector) => document.querySelector(selector);

/** An element with properties and children. */
function element(tag, properties = {}, ...children) {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...children.filter((child) => child !== null && child !== undefined));
  return made;
}

function complain(text) {
  $("#problem p").textContent = text;
  $("#problem").hidden = !text;
  if (text) $("#problem").scrollIntoView({ block: "nearest" });
}

/** What went wrong and is shown on the page. */
class Told extends Error {}
addEventListener("unhandledrejection", (event) => { if (event.reason instanceof Told) event.preventDefault(); });

/** The answer as an object; where the server refuses, what it said is shown and thrown. */
async function ask(address, options = {}) {
  if (options.body !== undefined) options = { method: "POST", ...options, body: JSON.stringify(options.body) };
  let answer;
  try {
    answer = await fetch(address, options);
  } catch {
    complain("The server does not answer. Is it still running?");
    throw new Told("no answer");
  }
  const text = await answer.text();
  let said = {};
  try { said = JSON.parse(text); } catch { said = { problem: text }; }
  if (!answer.ok) {
    complain(said.problem || answer.statusText);
    throw new Told(said.problem);
  }
  return said;
}

/** Send a file, and say how far it is; `started` gets what ends it. */
function send(file, progress, started) {
  return new Promise((resolve, reject) => {
    const request = new XMLHttpRequest();
    request.open("POST", `/api/logs?name=${encodeURIComponent(file.name)}`);
    request.responseType = "json";
    request.upload.onprogress = (event) => progress(event.loaded / event.total);
    const failed = (text) => { if (text) complain(text); reject(new Told(text)); };
    request.onload = () => request.status === 201 ? resolve(request.response) : failed(`${file.name}: ${(request.response && request.response.problem) || "refused"}`);
    request.onerror = () => failed(`${file.name}: the upload broke off; drop it again`);
    request.onabort = () => failed("");
    started(() => request.abort());
    request.send(file);
  });
}

const listeners = [];
/** Call `heard` with every state that the server sends. */
function listen(heard) { listeners.push(heard); }

let waited = 500;
function connect() {
  const socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/api/events`);
  socket.onmessage = (event) => {
    waited = 500;
    $("#link").hidden = true;
    const state = JSON.parse(event.data);
    for (const heard of listeners) heard(state);
  };
  socket.onclose = () => {
    $("#link").hidden = false;
    setTimeout(connect, waited);
    waited = Math.min(waited * 1.6, 5000);
  };
}

async function copied(button, text) {
  let done = false;
  try {
    await navigator.clipboard.writeText(text);
    done = true;
  } catch { // not over https, or not allowed
    const area = element("textarea", { value: text });
    document.body.append(area);
    area.select();
    done = document.execCommand("copy");
    area.remove();
  }
  const before = button.dataset.label || (button.dataset.label = button.textContent);
  button.textContent = done ? "Copied" : "Not copied";
  setTimeout(() => { button.textContent = before; }, 2000);
}

const sized = (bytes) => bytes < 1e6 ? `${Math.max(1, Math.round(bytes / 1e3))} kB` : `${(bytes / 1e6).toFixed(bytes < 1e7 ? 1 : 0)} MB`;

function show(tab) {
  for (const button of document.querySelectorAll("#tabs button")) button.setAttribute("aria-current", button.dataset.tab === tab);
  for (const panel of document.querySelectorAll("[data-panel]")) panel.hidden = panel.dataset.panel !== tab;
}

/** What the address says is looked at: {tab, log, result}. */
const place = () => Object.fromEntries(new URLSearchParams(location.hash.slice(1)));
function go(where) {
  const kept = Object.fromEntries(Object.entries({ ...place(), ...where }).filter(([, value]) => value));
  const address = `#${new URLSearchParams(kept)}`;
  if (address !== (location.hash || "#")) history.pushState(null, "", `${location.pathname}${location.search}${address}`);
}
