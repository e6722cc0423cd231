import { byId, element, fit } from "./dom.js";

const WATER = { light: "#5aa7dd", dark: "#3f86bb" };
const POLE = 2; // m, as the problems have it
const UPPER = 0.5; // m, of the upper tank above the lower

function stroke(context, color, width, ...points) {
  context.beginPath();
  points.forEach(([x, y], k) => (k ? context.lineTo(x, y) : context.moveTo(x, y)));
  context.strokeStyle = color;
  context.lineWidth = width;
  context.lineCap = "round";
  context.lineJoin = "round";
  context.stroke();
}

function disc(context, color, x, y, radius) {
  context.beginPath();
  context.arc(x, y, radius, 0, 2 * Math.PI);
  context.fillStyle = color;
  context.fill();
}

function arrow(context, color, x, y, length) {
  if (Math.abs(length) < 2) return;
  const tip = x + length, back = Math.sign(length) * 6;
  stroke(context, color, 2.5, [x, y], [tip, y]);
  stroke(context, color, 2.5, [tip - back, y - 5], [tip, y], [tip - back, y + 5]);
}

/** A cart at `x` on rails, its pole (positive angles to the left), and how it is accelerated. */
function cart(context, { width, height }, theme, { at, rail, unit, angle, push, color }) {
  const length = POLE * unit;
  stroke(context, theme.faint, 2, [12, rail + 15], [width - 12, rail + 15]);
  context.fillStyle = theme.quiet;
  context.beginPath();
  context.roundRect(at - 24, rail - 9, 48, 18, 4);
  context.fill();
  for (const wheel of [-13, 13]) disc(context, theme.ink, at + wheel, rail + 10, 4.5);
  const tip = [at - length * Math.sin(angle), rail - length * Math.cos(angle)];
  stroke(context, theme.ink, 4, [at, rail], tip);
  disc(context, theme.ink, at, rail, 4);
  disc(context, color, ...tip, 9);
  context.strokeStyle = theme.ink;
  context.lineWidth = 2;
  context.stroke();
  arrow(context, theme.ink, at + Math.sign(push) * 32, rail, push * 30);
}

function pendulum(context, size, theme, { state, control, color, strongest }) {
  const unit = (Math.min(size.width, size.height) * 0.4) / POLE;
  const setting = { at: size.width / 2, rail: size.height / 2, unit };
  cart(context, size, theme, { ...setting, angle: state[0], push: control[0] / strongest, color });
}

function cartPole(context, size, theme, { state, control, color, strongest, data }) {
  const [low, high] = [data.domain.lower[0], data.domain.upper[0]];
  const reach = Math.max(high - low, 2.2 * Math.abs(state[0] - (low + high) / 2));
  const unit = Math.min((size.width - 150) / reach, (size.height - 70) / POLE);
  const at = size.width / 2 + (state[0] - (low + high) / 2) * unit;
  const setting = { at, rail: size.height - 40, unit, angle: state[2] };
  cart(context, size, theme, { ...setting, push: control[0] / strongest, color });
}

function valve(context, theme, x, y, open, name) {
  context.beginPath();
  context.moveTo(x - 9, y - 6);
  context.lineTo(x + 9, y + 6);
  context.lineTo(x + 9, y - 6);
  context.lineTo(x - 9, y + 6);
  context.closePath();
  context.fillStyle = open > 0 ? WATER[theme.mode] : theme.paper;
  context.globalAlpha = open > 0 ? 0.4 + 0.6 * open : 1;
  context.fill();
  context.globalAlpha = 1;
  context.strokeStyle = theme.ink;
  context.lineWidth = 1.5;
  context.stroke();
  context.fillStyle = theme.quiet;
  context.font = "11px system-ui, sans-serif";
  context.textAlign = "center";
  context.fillText(name, x, y - 11);
}

function doubleTank(context, size, theme, { state, control, data }) {
  const unit = (size.height - 62) / (1 + UPPER), wide = Math.min(92, size.width * 0.24);
  const floor = size.height - 24, upper = floor - UPPER * unit;
  const [left, right] = [size.width * 0.24 - wide / 2 + 8, size.width * 0.64 - wide / 2];
  const water = WATER[theme.mode], names = data.alphabet.inputs;
  const goal = [null, null], { ball, axes } = data.target ?? {};
  if (ball) axes.forEach((axis, k) => (goal[axis] = ball.center[k]));
  const middle = left + wide + (right - left - wide) / 2;

  const tank = (x, bottom, level, aim, name) => {
    const high = Math.min(Math.max(level, 0), 1) * unit;
    context.fillStyle = water;
    context.fillRect(x, bottom - high, wide, high);
    stroke(context, theme.ink, 2.5, [x, bottom - unit], [x, bottom], [x + wide, bottom],
      [x + wide, bottom - unit]);
    if (aim !== null) {
      context.setLineDash([4, 4]);
      stroke(context, theme.ink, 1.5, [x - 5, bottom - aim * unit], [x + wide + 5, bottom - aim * unit]);
      context.setLineDash([]);
    }
    context.fillStyle = theme.quiet;
    context.font = "11px system-ui, sans-serif";
    context.textAlign = "center";
    context.fillText(name, x + wide / 2, bottom + 14);
  };
  const pipe = (flow, ...points) => stroke(context, flow > 0 ? water : theme.faint, 5, ...points);

  const top = upper - unit - 14;
  pipe(control[0], [left - 22, top], [left + wide / 2, top], [left + wide / 2, top + 12]);
  pipe(control[1], [left + wide, upper - 5], [right + 8, upper - 5], [right + 8, upper + 6]);
  pipe(control[2], [right + wide, floor - 5], [right + wide + 44, floor - 5]);
  tank(left, upper, state[0], goal[0], data.domain.names[0]);
  tank(right, floor, state[1], goal[1], data.domain.names[1]);
  valve(context, theme, left - 2, top, control[0], names[0]);
  valve(context, theme, middle, upper - 5, control[1], names[1]);
  valve(context, theme, right + wide + 24, floor - 5, control[2], names[2]);
}

const DRAWINGS = { pendulum, "cart-pole": cartPole, "double-tank": doubleTank };

/** Return the animation of the system: {draw}; one without a drawing stays hidden. */
export function makeDrawing(app) {
  const { data } = app, paint = DRAWINGS[data.drawing], panel = byId("drawing");
  panel.hidden = !paint || !data.loops;
  if (panel.hidden) return { draw() {} };
  const canvas = element("canvas", { role: "img", "aria-label": "The system at the present time" });
  panel.append(canvas);
  const strongest = Math.max(...data.controls.map(control => Math.abs(control[0]))) || 1;

  function draw() {
    const size = fit(canvas), context = canvas.getContext("2d");
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.clearRect(0, 0, canvas.width, canvas.height);
    const track = app.active;
    if (!track) return;
    context.setTransform(size.scale, 0, 0, size.scale, 0, 0);
    const now = app.progress(track);
    const symbol = track.symbols.length ? track.symbols[Math.min(now, track.symbols.length - 1)] : -1;
    paint(context, size, app.theme, {
      state: track.states[now], control: data.controls.at(symbol), color: app.theme.color(symbol),
      strongest, data,
    });
    canvas.dataset.state = Array.from(track.states[now]).join(" ");
  }

  new ResizeObserver(draw).observe(canvas);
  return { draw };
}
