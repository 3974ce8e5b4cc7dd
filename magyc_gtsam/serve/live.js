// The live run: where the samples come from, and what they show while the vehicle turns.
"use strict";

const live = { kind: "udp", drawn: null, trusted: null, sound: null, spec: null, move: "", state: "" };
const WORDS = {
  udp: 'Lines of JSON in datagrams: {"time": s, "magnetic_field": [x, y, z], "angular_rate": [x, y, z]}.',
  mavlink: "HIGHRES_IMU, RAW_IMU or SCALED_IMU: udpin:HOST:PORT, udpout:HOST:PORT or tcp:HOST:PORT.",
  serial: "Lines of JSON, what MotionCal reads (Raw:), or an autopilot's MAVLink.",
  file: "An MCAP file of the folder that a recorder still writes.",
  ros2: "MagneticField and Imu topics, where the server was started with ROS 2 set up.",
};

async function chooseSource(kind) {
  live.kind = kind;
  for (const button of document.querySelectorAll("[data-kind]")) button.setAttribute("aria-pressed", button.dataset.kind === kind);
  for (const label of document.querySelectorAll("#source-fields label")) label.hidden = !label.dataset.for.split(" ").includes(kind);
  $("#source-words").textContent = WORDS[kind];
  if (kind === "file") $("#growing").replaceChildren(...known.logs.filter((each) => /\.mcap$/i.test(each.name)).map((each) => element("option", { value: each.key, textContent: each.name })));
  if (kind === "serial") {
    const { ports } = await ask("/api/ports");
    if (live.kind !== kind) return; // another was chosen in the meantime
    $("#ports").replaceChildren(...ports.map((name) => element("option", { value: name })));
    const port = $("#serial-port");
    if (!port.value && document.activeElement !== port) port.value = ports[0] || ""; // not between what somebody types
    if (!ports.length) $("#source-words").textContent = "No serial port is listed: plug the device in and tap Serial again, or write its name, such as /dev/ttyUSB0.";
  }
}

function sourceAsked() {
  const baud = Number($("#baud").value);
  return {
    udp: { kind: "udp", port: Number($("#udp-port").value), everywhere: $("#everywhere").checked },
    mavlink: { kind: "mavlink", address: $("#mavlink-address").value.trim() },
    serial: { kind: $("#serial-speaks").value, port: $("#serial-port").value.trim(), baud },
    file: { kind: "file", log: $("#growing").value },
    ros2: { kind: "ros2" },
  }[live.kind];
}

async function order(what, more = {}) {
  complain("");
  try { // after a tap it may sound; a device without sound, or whose sound another program holds, calibrates all the same
    live.sound = live.sound || new AudioContext();
    live.sound.resume().catch(() => {});
  } catch {
    live.sound = null;
  }
  return ask("/api/live", { body: { do: what, ...more } });
}

/** Heard and felt: the verdict has changed to trusted. */
function signal() {
  if (navigator.vibrate && navigator.userActivation.hasBeenActive) navigator.vibrate([200, 100, 200]);
  if (!live.sound) return;
  [660, 880].forEach((pitch, k) => {
    const [tone, volume] = [live.sound.createOscillator(), live.sound.createGain()];
    const from = live.sound.currentTime + 0.22 * k;
    tone.frequency.value = pitch;
    volume.gain.setValueAtTime(0.2, from);
    volume.gain.exponentialRampToValueAtTime(0.001, from + 0.35);
    tone.connect(volume).connect(live.sound.destination);
    tone.start(from);
    tone.stop(from + 0.36);
  });
}

function drawLive({ live: run }) {
  const [going, over] = [run.state === "running", run.state === "frozen" || run.state === "failed"];
  $("#source").hidden = going || (over && !live.another && run.latest !== null);
  $("#running").hidden = !going && !(over && run.latest !== null && !live.another);
  $("#go-on").hidden = !over || run.latest !== null;
  $("#go-on").textContent = `Continue the last run (${run.source.replace(/^.*\//, (head) => (head.includes("://") ? head : ""))})`;
  $("#freeze").hidden = !going;
  $("#continue").hidden = going;
  $("#another").hidden = going;
  $("#live-result").hidden = !run.result || !run.latest || !run.latest.calibration || going;
  live.result = run.result;
  if (run.state === "failed" && live.state !== "failed" && live.state) complain(run.messages[run.messages.length - 1] || "the live run failed");
  if (run.state !== live.state && live.state && over) refresh();
  live.state = run.state;
  if (!$("#running").hidden) drawRun(run, going);
}

function drawRun(run, going) {
  const now = run.latest;
  const picture = now && now.picture;
  const waits = !now || now.duration === 0;
  const trusted = Boolean(now && now.converged);
  if (trusted && live.trusted === false && going) signal(); // null after a reload: nothing has changed
  live.trusted = trusted;
  const head = $("#live-verdict");
  head.className = trusted ? "good" : waits ? "" : "bad";
  const [title, text, origin] = head.children;
  title.textContent = trusted ? "It may be trusted" : waits ? "Waiting for samples" : "Not yet";
  const weak = now && now.sentence !== "converged" ? now.sentence : "";
  const said = waits ? (now && now.source.waiting_for) || run.messages[0] || "" : (now && now.problem) || (trusted ? `More directions make it better still. ${going ? "Freeze when you have enough." : "Continue to add them."}` : weak);
  text.textContent = asDoneHere(said);
  const time = now ? `${now.duration < 120 ? `${now.duration.toFixed(0)} s` : `${(now.duration / 60).toFixed(1)} min`} · ` : "";
  origin.textContent = `${going ? "" : "Frozen · "}${time}${now ? `${now.source.name} · ${now.source.sentence}` : run.source}${now && now.left_out ? ` · ${now.left_out} left out` : ""}`;
  for (const section of document.querySelectorAll("#running > section")) section.hidden = !picture || !picture.points.length;
  if (!picture || !picture.points.length) return;

  const sentence = picture.next ? picture.next.sentence : "All that a turn can show was seen.";
  $("#move .worth").textContent = sentence[0].toUpperCase() + sentence.slice(1);
  if (sentence !== live.move || !$("#vehicle").children.length) drawVehicle($("#vehicle"), picture.next);
  live.move = sentence;
  $("#weak").textContent = now.changes.length ? `The hard iron has changed ${now.changes.length} time${now.changes.length > 1 ? "s" : ""}.` : "Axes are those of the sensor; turns follow the right hand: thumb along the axis, fingers the way to turn.";
  const seen = picture.cells.filter(Boolean).length;
  $("#covered").textContent = `${seen} of ${picture.cells.length}`;
  drawSeen(picture);
  drawBand(picture.residual);
  const rows = now.rows || [];
  $("#live-rows").replaceChildren(...(rows.length ? parameters(rows) : [element("p", { className: "soft", textContent: "None yet." })]));
}

function drawSeen(picture) {
  const spec = {
    kind: "sphere", radius: 1, outlines: [], now: picture.now,
    clouds: [{ colour: picture.rough ? "raw" : "calibrated", points: packed(picture.points.flat()) }],
    cells: { longitudes: 10, latitudes: 6, seconds: packed(picture.cells) },
  };
  const figure = $("#live-sphere");
  if (live.drawn) live.drawn.update(spec);
  else if (figure.querySelector(".plot").clientWidth) live.drawn = drawSphere(figure, spec);
  const map = $("#map");
  if (!map.children.length) map.append(...picture.cells.map(() => element("i")));
  const band = Math.min(5, Math.floor(3 * (picture.now[2] + 1)));
  const sector = Math.floor(10 * (Math.atan2(picture.now[1], picture.now[0]) / (2 * Math.PI) + 0.5)) % 10;
  picture.cells.forEach((each, k) => {
    const [row, column] = [5 - Math.floor(k / 10), k % 10];
    map.children[10 * row + column].className = `${each ? "seen" : ""} ${k === 10 * band + sector ? "now" : ""}`;
  });
}

/** The mean residual of the last seconds, within what noise and calibration explain or beyond it. */
function drawBand(residual) {
  $("#band").hidden = !residual;
  if (!residual) {
    $("#residual").textContent = "Shown as soon as there is a calibration.";
    return;
  }
  const wide = 3 * residual.limit_ut;
  const share = (value) => `${50 + (50 * Math.max(-wide, Math.min(wide, value))) / wide}%`;
  const [limit, mark] = $("#band").children;
  limit.style.cssText = `left:${share(-residual.limit_ut)};right:${share(-residual.limit_ut)}`;
  mark.style.left = share(residual.mean_ut);
  $("#band").className = residual.disturbed ? "bad" : "";
  const [mean, allowed, rms] = [residual.mean_ut, residual.limit_ut, residual.rms_ut].map((v) => minus(v.toPrecision(2)));
  $("#residual").textContent = residual.disturbed
    ? `Disturbed: the field differs by ${mean} µT, more than the ${allowed} µT that noise and calibration explain. Check for iron or current nearby.`
    : `Undisturbed: mean difference ${mean} µT over the last seconds, within ±${allowed} µT; scatter of the samples ${rms} µT.`;
}

for (const button of document.querySelectorAll("[data-kind]")) button.addEventListener("click", () => chooseSource(button.dataset.kind));
$("#begin").addEventListener("click", async () => {
  const reading = { magnetic_unit: $("#live-magnetic").value, angular_unit: $("#live-angular").value };
  const source = sourceAsked();
  await order("start", { source, reading: source.kind === "mavlink" ? {} : reading });
  live.another = false;
  closeResult();
});
$("#freeze").addEventListener("click", () => order("freeze"));
for (const id of ["continue", "go-on"]) $(`#${id}`).addEventListener("click", () => order("go on"));
$("#another").addEventListener("click", () => { live.another = true; $("#running").hidden = true; $("#source").hidden = false; });
$("#live-result").addEventListener("click", () => openResult(live.result));
new ResizeObserver(() => { if (live.drawn && $("#live-sphere .plot").clientWidth) live.drawn.resize($("#live-sphere .plot").clientWidth); }).observe($("#live-sphere .plot"));
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => live.drawn && live.drawn.redraw());
chooseSource("udp");
