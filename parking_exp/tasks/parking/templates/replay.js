// Plays recorded episodes. Lengths are in metres, angles in radians; x points to the right, y up.
const byId = (id) => document.getElementById(id);
const degrees = (angle) => (angle * 180) / Math.PI;
const FOLLOWED_M = 32; // width of what is shown around the car
const STANDING_MPS = 0.1; // below, the car stands
const BEYOND_M = 15; // how much of a path that leaves the lot is shown

const CHARTS = [
  { key: "distance", title: "To the goal", unit: "m", digits: 2 },
  { key: "error", title: "Heading error", unit: "°", digits: 0 },
  { key: "speed", title: "Speed", unit: "m/s", digits: 1 },
  { key: "wheel", title: "Steering, left +", unit: "°", digits: 0, isControl: true },
  { key: "acceleration", title: "Acceleration", unit: "m/s²", digits: 1, isControl: true },
];

let scenes = []; // in the order of the list
let stepsPerSecond = 1;
let chosen = 0; // which scene
let time = 0; // in policy steps; what lies between two of them is interpolated
let playing = false;

// The recording -----------------------------------------------------------------------------------

async function unpack() {
  const bytes = Uint8Array.from(atob(byId("recording").textContent), (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return JSON.parse(await new Response(stream).text());
}

function sums(values) {
  let sum = 0;
  return values.map((value) => (sum += value));
}

function decode(values, series) {
  if (Array.isArray(values[0])) return values.map((row) => decode(row, series));
  let whole = values;
  for (let n = 0; n < series.differences; n++) whole = sums(whole);
  return whole.map((value) => value * series.unit);
}

function makeScene(plain, number, recording) {
  const scene = { ...plain };
  for (const [name, series] of Object.entries(recording.series)) scene[name] = decode(series.episodes[number], series);
  scene.last = scene.x.length - 1;
  const [goalX, goalY, goalHeading] = scene.goal;
  scene.distance = scene.x.map((x, step) => Math.hypot(x - goalX, scene.y[step] - goalY));
  scene.error = scene.heading.map((heading) => {
    const turn = heading - goalHeading;
    return Math.abs(degrees(Math.atan2(Math.sin(turn), Math.cos(turn))));
  });
  scene.wheel = scene.steering.map(degrees);
  scene.bounds = boundsOf(scene);
  return scene;
}

function boundsOf(scene) {
  const bounds = [Infinity, Infinity, -Infinity, -Infinity];
  const include = (x, y, reachX, reachY) => {
    bounds[0] = Math.min(bounds[0], x - reachX);
    bounds[1] = Math.min(bounds[1], y - reachY);
    bounds[2] = Math.max(bounds[2], x + reachX);
    bounds[3] = Math.max(bounds[3], y + reachY);
  };
  for (const [x, y, heading, length, width] of [scene.car, ...scene.slots, ...scene.walls, ...scene.parked_cars, ...scene.obstacles]) {
    const cos = Math.abs(Math.cos(heading)) / 2;
    const sin = Math.abs(Math.sin(heading)) / 2;
    include(x, y, length * cos + width * sin, length * sin + width * cos);
  }
  const [left, below, right, above] = bounds;
  const within = (value, low, high) => Math.max(low - BEYOND_M, Math.min(high + BEYOND_M, value));
  scene.x.forEach((x, step) => include(within(x, left, right), within(scene.y[step], below, above), 1, 1));
  return bounds;
}

// Values between two steps.
function valueAt(values) {
  const before = Math.floor(time);
  const after = Math.min(before + 1, values.length - 1);
  return values[before] + (values[after] - values[before]) * (time - before);
}

// Controls hold from one step to the next, where they are recorded.
const controlAt = (values) => values[Math.ceil(time)];

// The lot -----------------------------------------------------------------------------------------

function colours() {
  const style = getComputedStyle(document.documentElement);
  return (name) => style.getPropertyValue(`--${name}`).trim();
}

function trace(context, [x, y, heading, length, width]) {
  context.save();
  context.translate(x, y);
  context.rotate(heading);
  context.beginPath();
  context.rect(-length / 2, -width / 2, length, width);
  context.restore();
}

function fill(context, rectangle, colour) {
  context.fillStyle = colour;
  trace(context, rectangle);
  context.fill();
}

function drawCar(context, car, colour, dark, steering = 0) {
  const [x, y, heading, length, width] = car;
  const place = (ahead, side) => [
    x + ahead * Math.cos(heading) - side * Math.sin(heading),
    y + ahead * Math.sin(heading) + side * Math.cos(heading),
  ];
  fill(context, [x, y, heading, length, width], colour);
  fill(context, [...place(0.1 * length, 0), heading, 0.12 * length, 0.6 * width], dark);
  for (const side of [-0.37, 0.37]) {
    fill(context, [...place(-0.34 * length, side * width), heading, 0.18 * length, 0.15 * width], dark);
    fill(context, [...place(0.34 * length, side * width), heading + steering, 0.18 * length, 0.15 * width], dark);
  }
}

function drawGoal(context, [x, y, heading, length, width], colour, pixel) {
  fill(context, [x, y, heading, length, width], `color-mix(in srgb, ${colour} 22%, transparent)`);
  context.strokeStyle = colour;
  context.lineWidth = 2.5 * pixel;
  context.stroke();
  context.save();
  context.translate(x, y);
  context.rotate(heading);
  context.beginPath();
  context.moveTo(0.22 * length, -0.22 * width);
  context.lineTo(0.36 * length, 0);
  context.lineTo(0.22 * length, 0.22 * width);
  context.stroke();
  context.restore();
}

function drawPath(context, scene, colour, pixel) {
  context.lineWidth = 2.5 * pixel;
  context.lineCap = "round";
  const line = (fromX, fromY, toX, toY, step) => {
    context.strokeStyle = colour(scene.speed[step - 1] + scene.speed[step] < 0 ? "reverse" : "forward");
    context.globalAlpha = step <= Math.ceil(time) ? 1 : 0.3;
    context.beginPath();
    context.moveTo(fromX, fromY);
    context.lineTo(toX, toY);
    context.stroke();
  };
  for (let step = 1; step <= scene.last; step++) line(scene.x[step - 1], scene.y[step - 1], scene.x[step], scene.y[step], step);
  context.globalAlpha = 1;
}

function drawRays(context, scene, car, colour, pixel) {
  const [x, y, heading] = car;
  context.strokeStyle = colour;
  context.lineWidth = pixel;
  scene.rays.forEach((distances, ray) => {
    const angle = heading + (2 * Math.PI * ray) / scene.rays.length;
    const distance = valueAt(distances);
    context.beginPath();
    context.moveTo(x, y);
    context.lineTo(x + distance * Math.cos(angle), y + distance * Math.sin(angle));
    context.stroke();
  });
}

// Fit the canvas to its column and the view into the canvas; return the size of a pixel [m].
function prepare(canvas, context, scene, car) {
  const [left, below, right, above] = scene.bounds;
  const margin = 1;
  const whole = [right - left + 2 * margin, above - below + 2 * margin];
  canvas.style.aspectRatio = `${whole[0]} / ${whole[1]}`;
  const ratio = devicePixelRatio || 1;
  canvas.width = Math.round(canvas.clientWidth * ratio);
  canvas.height = Math.round(canvas.clientHeight * ratio);
  let [width, height] = whole;
  let middle = [(left + right) / 2, (below + above) / 2];
  if (byId("follow").checked) {
    width = FOLLOWED_M;
    height = (FOLLOWED_M * whole[1]) / whole[0];
    middle = [car[0], car[1]];
  }
  const scale = Math.min(canvas.width / width, canvas.height / height);
  context.setTransform(scale, 0, 0, -scale, canvas.width / 2 - scale * middle[0], canvas.height / 2 + scale * middle[1]);
  return ratio / scale;
}

function draw() {
  const scene = scenes[chosen];
  const canvas = byId("lot");
  const context = canvas.getContext("2d");
  const [, , , length, width] = scene.car;
  const car = [valueAt(scene.x), valueAt(scene.y), valueAt(scene.heading), length, width];
  const pixel = prepare(canvas, context, scene, car);
  const colour = colours();
  context.strokeStyle = colour("line");
  context.lineWidth = pixel;
  for (const slot of scene.slots) {
    trace(context, slot);
    context.stroke();
  }
  drawGoal(context, scene.goal, colour("goal"), pixel);
  for (const wall of scene.walls) fill(context, wall, colour("wall"));
  for (const obstacle of scene.obstacles) fill(context, obstacle, colour("wall"));
  for (const parked of scene.parked_cars) drawCar(context, parked, colour("parked"), colour("ground"));
  if (scene.rays.length) drawRays(context, scene, car, colour("rays"), pixel);
  drawPath(context, scene, colour, pixel);

  const end = [scene.x[scene.last], scene.y[scene.last], scene.heading[scene.last], length, width];
  context.setLineDash([4 * pixel, 3 * pixel]);
  context.strokeStyle = colour("ink");
  context.lineWidth = 1.3 * pixel;
  trace(context, end);
  context.stroke();
  context.setLineDash([]);
  const hasCrashed = scene.outcome === "crash" && time === scene.last;
  drawCar(context, car, colour(hasCrashed ? "crash" : "car"), colour("ink"), controlAt(scene.steering));
}

// The charts --------------------------------------------------------------------------------------

function svg(name, attributes) {
  const element = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  return element;
}

function addChart(chart) {
  const box = document.createElement("div");
  box.className = "chart";
  const heading = document.createElement("h3");
  chart.output = document.createElement("output");
  heading.append(chart.title, chart.output);
  chart.image = svg("svg", { viewBox: "0 0 1 1", preserveAspectRatio: "none", role: "img" });
  chart.lines = ["zero", "values", "now"].map((name) => svg("path", { class: name }));
  chart.image.append(...chart.lines);
  chart.ends = document.createElement("div");
  chart.ends.className = "ends";
  box.append(heading, chart.image, chart.ends);
  byId("charts").append(box);
  chart.image.addEventListener("pointerdown", (event) => {
    chart.image.setPointerCapture(event.pointerId);
    seekPointer(chart.image, event);
  });
  chart.image.addEventListener("pointermove", (event) => {
    if (event.buttons) seekPointer(chart.image, event);
  });
}

function seekPointer(image, event) {
  const box = image.getBoundingClientRect();
  seek(Math.round(((event.clientX - box.left) / box.width) * scenes[chosen].last));
}

function drawChart(chart, scene) {
  const values = scene[chart.key];
  const low = Math.min(0, ...values);
  const high = Math.max(0, ...values);
  const space = 0.08 * (high - low || 1);
  const height = (value) => (high + space - value) / (high - low + 2 * space || 1);
  let line = `M0 ${height(chart.isControl ? values[1] : values[0])}`;
  for (let step = 1; step <= scene.last; step++) {
    const x = (step / scene.last).toFixed(4);
    const y = height(values[step]).toFixed(4);
    line += chart.isControl ? `V${y}H${x}` : `L${x} ${y}`;
  }
  chart.lines[0].setAttribute("d", `M0 ${height(0)}H1`);
  chart.lines[1].setAttribute("d", line);
  const range = `${low.toFixed(chart.digits)} to ${high.toFixed(chart.digits)} ${chart.unit}`;
  chart.ends.textContent = range;
  chart.image.setAttribute("aria-label", `${chart.title} over time: ${range}`);
}

// The episode -------------------------------------------------------------------------------------

function seconds(steps) {
  return (steps / stepsPerSecond).toFixed(1);
}

function steps(number) {
  return number === 1 ? "1 step" : `${number} steps`;
}

function show() {
  const scene = scenes[chosen];
  const step = Math.floor(time);
  byId("play").textContent = playing ? "Pause" : "Play";
  byId("time").value = step;
  const clock = `${seconds(time)} of ${seconds(scene.last)} s, step ${step} of ${scene.last}`;
  byId("clock").textContent = clock;
  byId("time").setAttribute("aria-valuetext", clock);
  for (const chart of CHARTS) {
    const value = chart.isControl ? controlAt(scene[chart.key]) : valueAt(scene[chart.key]);
    chart.output.textContent = `${value.toFixed(chart.digits)} ${chart.unit}`.replace("-", "−");
    chart.lines[2].setAttribute("d", `M${time / scene.last} 0V1`);
  }
  draw();
}

function describeEnding(scene) {
  const end = (key, digits) => Math.abs(scene[key][scene.last]).toFixed(digits);
  const text = `At the end: ${end("distance", 2)} m from the goal, ${end("error", 0)}° off its heading, ${end("speed", 2)} m/s.`;
  const moved = scene.speed.findLastIndex((speed) => Math.abs(speed) >= STANDING_MPS);
  return scene.last - moved > stepsPerSecond ? `${text} It has stood still since ${seconds(moved + 1)} s.` : text;
}

function choose(number) {
  if (number < 0 || number >= scenes.length) return;
  const list = byId("episodes");
  list.children[chosen].setAttribute("aria-selected", "false");
  chosen = number;
  time = 0;
  const scene = scenes[chosen];
  const option = list.children[chosen];
  option.setAttribute("aria-selected", "true");
  option.scrollIntoView({ block: "nearest" });
  list.setAttribute("aria-activedescendant", option.id);
  byId("h-episode").textContent = `Seed ${scene.seed}: ${scene.outcome} after ${steps(scene.last)}`;
  byId("ending").textContent = describeEnding(scene);
  byId("lot").setAttribute("aria-label", `The lot from above, with the path of the car. ${byId("ending").textContent}`);
  byId("time").max = scene.last;
  byId("legend-rays").hidden = !scene.rays.length;
  for (const chart of CHARTS) drawChart(chart, scene);
  show();
}

function seek(step) {
  playing = false;
  time = Math.max(0, Math.min(scenes[chosen].last, step));
  show();
}

function play() {
  playing = !playing;
  if (playing && time === scenes[chosen].last) time = 0;
  show();
  if (playing) requestAnimationFrame(playFrom);
}

function playFrom(before) {
  requestAnimationFrame((now) => {
    if (!playing) return;
    const passed = ((now - before) / 1000) * Number(byId("pace").value);
    const { last } = scenes[chosen];
    time = Math.min(last, time + passed * stepsPerSecond);
    playing = time < last;
    show();
    if (playing) playFrom(now);
  });
}

function addEpisode(scene, number) {
  const option = document.createElement("li");
  option.id = `episode-${number}`;
  option.setAttribute("role", "option");
  option.setAttribute("aria-selected", "false");
  for (const [name, text] of [["seed", `seed ${scene.seed}`], [`outcome ${scene.outcome}`, scene.outcome], ["steps", steps(scene.last)]]) {
    const part = document.createElement("span");
    part.className = name;
    part.textContent = text;
    option.append(part, " ");
  }
  option.addEventListener("click", () => choose(number));
  byId("episodes").append(option);
}

const KEYS = {
  " ": play,
  ArrowLeft: () => seek(Math.ceil(time) - 1),
  ArrowRight: () => seek(Math.floor(time) + 1),
  ArrowUp: () => choose(chosen - 1),
  ArrowDown: () => choose(chosen + 1),
  Home: () => seek(0),
  End: () => seek(scenes[chosen].last),
};

function pressed(event) {
  const action = KEYS[event.key];
  const hasOwnSpace = event.key === " " && event.target.matches("button, input[type=checkbox]");
  if (!action || event.ctrlKey || event.altKey || event.metaKey || hasOwnSpace || event.target.matches("select")) return;
  event.preventDefault();
  action();
}

document.addEventListener("DOMContentLoaded", async () => {
  const recording = await unpack();
  stepsPerSecond = recording.steps_per_s;
  scenes = recording.scenes.map((plain, number) => makeScene(plain, number, recording));
  scenes.forEach(addEpisode);
  CHARTS.forEach(addChart);
  byId("play").addEventListener("click", play);
  byId("time").addEventListener("input", (event) => seek(Number(event.target.value)));
  byId("follow").addEventListener("change", draw);
  document.addEventListener("keydown", pressed);
  choose(0);
  new ResizeObserver(draw).observe(byId("lot"));
  new MutationObserver(draw).observe(document.documentElement, { attributeFilter: ["data-theme"] });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
});
