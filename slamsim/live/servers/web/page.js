"use strict";
/* The page of a live robot. It draws what the server sends, and sends what the user wants.
   Metres, radians; x to the right and y up, as in the map's frame. */

(() => {
const $ = id => document.getElementById(id);
const SEND_MS = 50;           // a held twist is repeated so often; it holds for 0.25 s
const DEAD_ZONE = 0.12;       // of a gamepad's stick: worn ones rest off their centre
const TAP_PX = 8;             // a pointer that moved less was a tap
const SILENT_MS = 5000;       // the server tells its state four times a second at least
const FARTHEST_PX_PER_M = 4, NEAREST_PX_PER_M = 600;

/* ---------- What is known of the robot ---------- */

const robot = { state: null, pose: null, map: null, path: null, scans: new Map(), goal: null };

function forget() {
  Object.assign(robot, { map: null, path: null, goal: null });
  robot.scans.clear();
}

/* ---------- Connection ---------- */

let socket = null, waitMs = 500, heardAt = 0, opened = false;

function connect() {
  opened = false;
  socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/live`);
  socket.binaryType = "arraybuffer";
  socket.onopen = () => { opened = true; waitMs = 500; heardAt = Date.now(); forget(); show_link("open"); };
  socket.onmessage = ({ data }) => {
    heardAt = Date.now();
    typeof data === "string" ? hear_text(JSON.parse(data)) : hear_binary(data);
  };
  socket.onclose = lost;
}

function lost() {
  release();
  show_link("lost");
  if (!opened) ask_why();
  setTimeout(connect, waitMs);
  waitMs = Math.min(waitMs * 2, 5000);
}

/* A browser does not say why a WebSocket was refused; the page itself is refused alike. */
async function ask_why() {
  const answer = await fetch("/", { cache: "no-store" }).catch(() => null);
  if (answer && answer.status === 401) location.reload();
}

function send(request) {
  if (socket.readyState !== WebSocket.OPEN) return;
  // Old twists are of no use: none are queued on a connection that does not take them.
  if (request.op === "drive" && socket.bufferedAmount > 1024) return;
  socket.send(JSON.stringify(request));
}

setInterval(() => {  // a connection may end without a word
  if (socket.readyState === WebSocket.OPEN && Date.now() - heardAt > SILENT_MS) {
    socket.onclose = null;
    socket.close();
    lost();
  }
}, 1000);

function hear_text(message) {
  if (message.type === "state") hear_state(message);
  else if (message.text) say(message.text, message.type === "error");
  if (message.type === "error" && message.op === "go_to") { robot.goal = null; redraw(); }
}

function hear_state(state) {
  if (robot.state && state.stamp_ns < robot.state.stamp_ns) forget();
  const before = robot.state;
  robot.state = state;
  robot.pose = state.pose && state.pose[1];
  const { goal, pose } = robot; // a robot elsewhere does not tell what became of its goal
  if (goal && pose && Math.hypot(goal.x - pose[0], goal.y - pose[1]) < 0.3) robot.goal = null;
  hear_goal(before?.goal, state.goal);
  show_state();
  redraw();
}

function hear_goal(before, now) {
  if (before !== "driving" || now === "driving") return;
  robot.goal = null;
  if (now === "reached") say("The robot has reached its goal.");
  if (now === "not reached") say("The robot could not reach its goal.", true);
}

function hear_binary(buffer) {
  const size = new DataView(buffer).getUint32(0, true);
  const head = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, size)));
  const at = 4 + size;
  if (head.type === "scan") robot.scans.set(head.frame, { ...head, steps: new Int16Array(buffer, at) });
  else if (head.type === "path") robot.path = new Float32Array(buffer, at);
  else if (head.type === "map") hear_map(head, buffer.slice(at));
  redraw();
}

let newestMap = 0;

async function hear_map(head, packed) {
  const number = ++newestMap;
  const plain = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const cells = new Uint8Array(await new Response(plain).arrayBuffer());
  if (number !== newestMap || cells.length !== head.width * head.height || !cells.length) return;
  robot.map = { ...head, cells };
  paint_map();
  let known = 0;
  for (const cell of cells) known += cell !== 255;
  $("area").textContent = `${(known * head.resolution_m ** 2).toFixed(1)} m²`;
  redraw();
}

/* ---------- Colours ---------- */

let colours = {};

function read_colours() {
  const style = getComputedStyle(document.documentElement);
  for (const name of ["unknown", "free", "wall", "grid", "scan", "path", "goal", "accent", "paper"])
    colours[name] = style.getPropertyValue(`--${name}`).trim();
  if (robot.map) paint_map();
  redraw();
}

const channels = hex => [1, 3, 5].map(at => parseInt(hex.slice(at, at + 2), 16));

/* Cells as a picture, north up. 0 to 100 goes from free to wall; unknown cells are clear. */
function paint_map() {
  const { width, height, cells } = robot.map;
  const canvas = robot.map.picture ??= new OffscreenCanvas(width, height);
  const pen = canvas.getContext("2d"), image = pen.createImageData(width, height);
  const table = new Uint32Array(256), bytes = new Uint8Array(table.buffer);
  const free = channels(colours.free), wall = channels(colours.wall);
  for (let cell = 0; cell <= 100; cell++)
    bytes.set([...free.map((c, i) => c + (wall[i] - c) * cell / 100), 255], 4 * cell);
  const pixels = new Uint32Array(image.data.buffer);
  for (let row = 0; row < height; row++)
    for (let column = 0, from = row * width, to = (height - 1 - row) * width; column < width; column++)
      pixels[to++] = table[cells[from++]];
  pen.putImageData(image, 0, 0);
}

/* ---------- View of the map ---------- */

const canvas = $("map"), pen = canvas.getContext("2d");
const view = { x: 0, y: 0, scale: 48, follow: true, aiming: false };
let width = 1, height = 1, asked = false;

const to_screen = (x, y) => [width / 2 + (x - view.x) * view.scale, height / 2 - (y - view.y) * view.scale];
const to_map = (px, py) => [view.x + (px - width / 2) / view.scale, view.y - (py - height / 2) / view.scale];

function redraw() {
  if (!asked) { asked = true; requestAnimationFrame(draw); }
}

function resize() {
  const ratio = Math.min(devicePixelRatio || 1, 2), box = canvas.getBoundingClientRect();
  [width, height] = [box.width, box.height];
  canvas.width = Math.round(width * ratio);
  canvas.height = Math.round(height * ratio);
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  draw();
}

function draw() {
  asked = false;
  if (view.follow && robot.pose) [view.x, view.y] = robot.pose;
  pen.clearRect(0, 0, width, height);
  if (robot.map) draw_map(robot.map);
  draw_grid();
  if (robot.path) draw_path(robot.path);
  for (const scan of robot.scans.values()) draw_scan(scan);
  if (robot.goal) draw_goal(robot.goal);
  if (robot.pose) draw_robot(robot.pose);
  draw_scale();
  $("empty").hidden = Boolean(robot.pose || robot.map);
}

function draw_map({ picture, x_m, y_m, yaw_rad, resolution_m }) {
  const pixel = resolution_m * view.scale;
  pen.save();
  pen.translate(...to_screen(x_m, y_m));
  pen.rotate(-yaw_rad);
  pen.scale(pixel, pixel);
  pen.imageSmoothingEnabled = pixel < 1;
  pen.imageSmoothingQuality = "high";
  pen.drawImage(picture, 0, -picture.height);
  pen.restore();
}

/* A round length that is between 60 and 150 pixels long. */
function round_length() {
  const least = 60 / view.scale, power = 10 ** Math.floor(Math.log10(least));
  return [1, 2, 5, 10].map(step => step * power).find(length => length >= least);
}

function draw_grid() {
  const step = round_length(), [left, top] = to_map(0, 0), [right, bottom] = to_map(width, height);
  pen.beginPath();
  for (let x = Math.ceil(left / step) * step; x < right; x += step) {
    const px = Math.round(to_screen(x, 0)[0]) + 0.5;
    pen.moveTo(px, 0); pen.lineTo(px, height);
  }
  for (let y = Math.ceil(bottom / step) * step; y < top; y += step) {
    const py = Math.round(to_screen(0, y)[1]) + 0.5;
    pen.moveTo(0, py); pen.lineTo(width, py);
  }
  pen.lineWidth = 1;
  pen.strokeStyle = colours.grid;
  pen.stroke();
}

function draw_path(points) {
  pen.beginPath();
  for (let i = 0; i < points.length; i += 2) pen.lineTo(...to_screen(points[i], points[i + 1]));
  if (robot.pose) pen.lineTo(...to_screen(robot.pose[0], robot.pose[1]));
  pen.lineWidth = 2;
  pen.lineJoin = "round";
  pen.strokeStyle = colours.path;
  pen.stroke();
}

function draw_scan({ steps, step_m, x_m, y_m }) {
  const size = view.scale > 30 ? 3 : 2, [x, y] = to_screen(x_m, y_m), step = step_m * view.scale;
  pen.fillStyle = colours.scan;
  for (let i = 0; i < steps.length; i += 2)
    pen.fillRect(x + steps[i] * step - size / 2, y - steps[i + 1] * step - size / 2, size, size);
}

function draw_goal({ x, y }) {
  const [px, py] = to_screen(x, y);
  pen.lineWidth = 2;
  pen.strokeStyle = pen.fillStyle = colours.goal;
  pen.beginPath(); pen.arc(px, py, 9, 0, 7); pen.stroke();
  pen.beginPath(); pen.arc(px, py, 3, 0, 7); pen.fill();
}

/* As large as its screen asks for, not as the robot is: no message says how large that is. */
function draw_robot([x, y, yaw]) {
  pen.save();
  pen.translate(...to_screen(x, y));
  pen.rotate(-yaw);
  pen.beginPath();
  pen.moveTo(14, 0); pen.lineTo(-10, 9); pen.lineTo(-5, 0); pen.lineTo(-10, -9); pen.closePath();
  pen.lineJoin = "round";
  pen.lineWidth = 4;
  pen.strokeStyle = colours.paper;
  pen.stroke();
  pen.fillStyle = colours.accent;
  pen.fill();
  pen.restore();
}

function draw_scale() {
  const length = round_length();
  $("scale-bar").style.width = `${length * view.scale}px`;
  $("scale-text").textContent = length < 1 ? `${+(length * 100).toFixed(3)} cm` : `${+length.toFixed(3)} m`;
}

/* ---------- Pan, zoom, go here ---------- */

function zoom(factor, px = width / 2, py = height / 2) {
  const [x, y] = to_map(px, py);
  view.scale = Math.min(Math.max(view.scale * factor, FARTHEST_PX_PER_M), NEAREST_PX_PER_M);
  const [left, top] = to_map(px, py);
  view.x += x - left;
  view.y += y - top;
  redraw();
}

function set_follow(on) {
  view.follow = on;
  $("follow").setAttribute("aria-pressed", on);
  redraw();
}

function set_aiming(on) {
  view.aiming = on;
  $("go").setAttribute("aria-pressed", on);
  canvas.classList.toggle("aiming", on);
}

function fit() {
  if (!robot.map) return;
  const { x_m, y_m, yaw_rad, resolution_m } = robot.map;
  const w = robot.map.width * resolution_m, h = robot.map.height * resolution_m;
  const cos = Math.cos(yaw_rad), sin = Math.sin(yaw_rad);
  view.x = x_m + (cos * w - sin * h) / 2;
  view.y = y_m + (sin * w + cos * h) / 2;
  view.scale = Math.min((width - 48) / w, (height - 48) / h, NEAREST_PX_PER_M);
  set_follow(false);
}

const fingers = new Map();
let moved_px = 0;

canvas.addEventListener("pointerdown", event => {
  canvas.setPointerCapture(event.pointerId);
  fingers.set(event.pointerId, [event.offsetX, event.offsetY]);
  if (fingers.size === 1) moved_px = 0;
  canvas.classList.add("dragged");
});

canvas.addEventListener("pointermove", event => {
  const last = fingers.get(event.pointerId);
  if (!last) return;
  const now = [event.offsetX, event.offsetY], others = [...fingers].filter(([id]) => id !== event.pointerId);
  moved_px += Math.hypot(now[0] - last[0], now[1] - last[1]);
  fingers.set(event.pointerId, now);
  if (moved_px < TAP_PX) return;
  if (others.length) {  // the other finger stays where it is on the map
    const [, [x, y]] = others[0];
    zoom(Math.hypot(now[0] - x, now[1] - y) / Math.max(Math.hypot(last[0] - x, last[1] - y), 1), x, y);
  } else {
    view.x -= (now[0] - last[0]) / view.scale;
    view.y += (now[1] - last[1]) / view.scale;
    set_follow(false);
  }
});

function lift(event) {
  const was_one = fingers.size === 1 && fingers.has(event.pointerId);
  fingers.delete(event.pointerId);
  if (!fingers.size) canvas.classList.remove("dragged");
  if (event.type !== "pointerup" || !was_one || moved_px >= TAP_PX || !view.aiming) return;
  const [x, y] = to_map(event.offsetX, event.offsetY);
  send({ op: "go_to", x_m: x, y_m: y });
  robot.goal = { x, y };
  set_aiming(false);
  redraw();
}

canvas.addEventListener("pointerup", lift);
canvas.addEventListener("pointercancel", lift);
canvas.addEventListener("wheel", event => {
  event.preventDefault();
  const lines = event.deltaMode === 1 ? 16 : 1;  // Firefox counts lines
  zoom(Math.exp(-event.deltaY * lines * 0.0015), ...(view.follow ? [] : [event.offsetX, event.offsetY]));
}, { passive: false });

$("closer").onclick = () => zoom(1.4);
$("wider").onclick = () => zoom(1 / 1.4);
$("fit").onclick = fit;
$("follow").onclick = () => set_follow(!view.follow);
$("go").onclick = () => set_aiming(!view.aiming);

/* ---------- Driving: each source gives [forward, left], from -1 to 1 ---------- */

const KEYS = { ArrowUp: [1, 0], KeyW: [1, 0], ArrowDown: [-1, 0], KeyS: [-1, 0],
  ArrowLeft: [0, 1], KeyA: [0, 1], ArrowRight: [0, -1], KeyD: [0, -1] };
const held = new Set();
let slowed = false, stick = null, driving = false;

function of_keys() {
  if (!held.size) return null;
  const sum = at => Math.sign([...held].reduce((total, code) => total + KEYS[code][at], 0));
  return [sum(0), sum(1)].map(part => part * (slowed ? 0.4 : 1));
}

function of_gamepad() {
  for (const pad of navigator.getGamepads?.() ?? []) {
    if (!pad || !pad.connected) continue;
    const live = value => Math.abs(value) < DEAD_ZONE ? 0 : value;
    const forward = -live(pad.axes[1] ?? 0), left = -live(pad.axes[2] ?? 0) || -live(pad.axes[0] ?? 0);
    if (forward || left) return [forward, left];
  }
  return null;
}

function drive() {
  const wanted = stick ?? of_keys() ?? of_gamepad();
  if (!wanted) {
    if (driving) halt();
    return;
  }
  if (document.hidden) return release();
  driving = true;
  robot.goal = null;
  const speed = Number($("fastest").value), turn = Math.min(Math.max(2 * speed, 0.5), 2);
  send({ op: "drive", speed_m_s: wanted[0] * speed, yaw_rate_rad_s: wanted[1] * turn });
}

function halt() {
  driving = false;
  send({ op: "drive", speed_m_s: 0, yaw_rate_rad_s: 0 });
}

function let_go() {
  held.clear();
  place_knob(null);
}

function release() {
  let_go();
  if (driving) halt();
}

function stop() {
  let_go();
  robot.goal = null;
  halt();
  redraw();
}

setInterval(drive, SEND_MS);
addEventListener("blur", release);
addEventListener("pagehide", release);
document.addEventListener("visibilitychange", () => document.hidden && release());
addEventListener("gamepadconnected", event => say(`Gamepad connected: ${event.gamepad.id}`));

addEventListener("keydown", event => {
  if (event.ctrlKey || event.metaKey || event.altKey || $("sure").open) return;
  if (event.code === "Escape") { set_aiming(false); return stop(); }
  const at = event.target.closest?.("button, a, select, input");
  if (event.code === "Space" && !at) { event.preventDefault(); return stop(); }
  slowed = event.shiftKey;
  if (!(event.code in KEYS) || at?.matches("select, input")) return;
  event.preventDefault();
  if (held.has(event.code)) return;
  held.add(event.code);
  drive();
});
addEventListener("keyup", event => {
  slowed = event.shiftKey;
  if (held.delete(event.code)) drive();
});
// A control that was clicked keeps no key to itself: arrows and space are for the robot.
addEventListener("pointerup", () => setTimeout(() => document.activeElement?.matches("button, input")
  && !$("sure").open && document.activeElement.blur()));
addEventListener("change", event => event.target.blur?.());

function place_knob(at) {
  stick = at;
  $("knob").style.transform = at ? `translate(${-at[1] * 40}px, ${-at[0] * 40}px)` : "";
}

function steer(event) {
  const box = $("stick").getBoundingClientRect(), reach = box.width / 2 - 20;
  let x = (event.clientX - box.left - box.width / 2) / reach, y = (event.clientY - box.top - box.height / 2) / reach;
  const long = Math.max(Math.hypot(x, y), 1);
  place_knob([-y / long, -x / long]);
}

$("stick").addEventListener("pointerdown", event => {
  event.preventDefault();
  $("stick").setPointerCapture(event.pointerId);
  steer(event);
  drive();
});
$("stick").addEventListener("pointermove", event => stick && steer(event));
for (const kind of ["pointerup", "pointercancel", "lostpointercapture"])
  $("stick").addEventListener(kind, () => { place_knob(null); drive(); });

/* ---------- Buttons ---------- */

const show_fastest = () => { $("fastest-text").textContent = `${Number($("fastest").value).toFixed(2)} m/s`; };
$("fastest").oninput = show_fastest;
$("stop").onclick = stop;
$("pause").onclick = () => send({ op: "pause", paused: !robot.state.paused });
$("step").onclick = () => send({ op: "step", seconds: 0.1 });
$("rate").onchange = event => send({ op: "rate", rate: event.target.value ? Number(event.target.value) : null });
$("record").onclick = () => send({ op: "record", on: robot.state.recording === null });
$("save").onclick = () => send({ op: "save_map" });
$("reset").onclick = () => $("sure").showModal();
$("sure").onclose = () => { if ($("sure").returnValue === "yes") send({ op: "reset" }); $("sure").returnValue = ""; };
for (const button of document.querySelectorAll("[data-mode]"))
  button.onclick = () => send({ op: "mode", mode: button.dataset.mode });

/* ---------- Words ---------- */

const TRACKING = { off: "Off", waiting: "Waiting for scans", tracking: "Tracking", searching: "Searching", lost: "Lost" };
const count = number => number.toLocaleString("en");
const signed = (number, digits) => (Math.abs(number) < 0.5 * 10 ** -digits ? 0 : number).toFixed(digits);

/* Only what changed: a screen reader and the layout are left in peace. */
function put(id, text) {
  if ($(id).textContent !== text) $(id).textContent = text;
}

function show_state() {
  const { state, pose } = robot, seconds = state.time_s;
  put("time", `${Math.floor(seconds / 60)}:${(seconds % 60).toFixed(1).padStart(4, "0")}`);
  put("factor", state.realtime_factor === null ? "" : `${state.realtime_factor.toFixed(2)} × real time`);
  put("speed", `${signed(state.speed_m_s ?? 0, 2)} m/s`);
  put("turn", `${signed(state.yaw_rate_rad_s ?? 0, 2)} rad/s`);
  if (pose) {
    put("place", `${signed(pose[0], 2)}, ${signed(pose[1], 2)} m`);
    put("heading", `${signed(pose[2] * 180 / Math.PI, 0)}°`);
  }
  put("tracking", TRACKING[state.tracking] ?? state.tracking);
  $("tracking").dataset.is = state.tracking;
  put("keyframes", count(state.keyframes));
  put("closures", count(state.closures));
  const share = 100 * state.late_windows / Math.max(state.windows, 1);
  put("late", `${count(state.late_windows)} (${share.toFixed(1)} %)`);
  put("clients", count(state.clients));
  show_controls(state);
}

function show_controls(state) {
  for (const button of document.querySelectorAll("[data-mode]"))
    button.setAttribute("aria-pressed", button.dataset.mode === state.mode);
  $("paused").hidden = !state.paused;
  put("pause", state.paused ? "Resume" : "Pause");
  $("step").disabled = !state.paused;
  $("recording").hidden = state.recording === null;
  put("record", state.recording === null ? "Start recording" : "Stop recording");
  $("record").setAttribute("aria-pressed", state.recording !== null);
  const rate = state.rate === null ? "" : String(state.rate);
  if (document.activeElement !== $("rate")) {
    if (![...$("rate").options].some(option => option.value === rate))
      $("rate").add(new Option(`${rate} ×`, rate), 0);
    $("rate").value = rate;
  }
  show_recordings(state.recordings);
  if (state.ended) show_banner(`The drive is over: ${state.ended}`);
  else if (document.body.dataset.link === "open") show_banner("");
}

function show_recordings(recordings) {
  const list = $("recordings"), ids = recordings.map(({ id }) => id).join();
  if (list.dataset.ids === ids) return;
  list.dataset.ids = ids;
  list.replaceChildren(...recordings.map(({ id, name }) => {
    const item = document.createElement("li"), link = document.createElement("a"), text = document.createElement("span");
    text.textContent = `Download ${name}`;
    link.className = "download";
    link.href = `/recording/${id}`;
    link.download = `${name}.zip`;
    link.append(text);
    item.append(link);
    return item;
  }));
}

function show_banner(text) {
  put("banner", text);
  $("banner").hidden = !text;
}

function show_link(link) {
  document.body.dataset.link = link;
  put("link", { open: "Connected", lost: "Offline" }[link]);
  $("panel").disabled = link !== "open";
  show_banner(link === "lost" ? "The connection to the robot is lost. Trying again." : "");
}

let hiding = 0;

function say(text, is_error = false) {
  put("toast", text);
  $("toast").hidden = false;
  clearTimeout(hiding);
  hiding = setTimeout(() => { $("toast").hidden = true; }, is_error ? 7000 : 4000);
}

/* ---------- Start ---------- */

matchMedia("(prefers-color-scheme: dark)").addEventListener("change", read_colours);
new ResizeObserver(resize).observe(canvas);
read_colours();
show_fastest();
connect();
})();
