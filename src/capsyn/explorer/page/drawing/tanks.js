import { stroke, write } from "../dom/canvas.js";

const WATER = { light: "#5aa7dd", dark: "#3f86bb" };

/** A valve, filled as far as it is open. */
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
  write(context, name, [x, y - 11], theme.quiet, "11", "center", "alphabetic");
}

/** A tank with its walls, water and name, and the level that is aimed at. */
function tank(context, theme, { x, wide, bottom, unit }, level, aim, name) {
  const high = Math.min(Math.max(level, 0), 1) * unit;
  context.fillStyle = WATER[theme.mode];
  context.fillRect(x, bottom - high, wide, high);
  stroke(context, theme.ink, 2.5, [x, bottom - unit], [x, bottom], [x + wide, bottom],
    [x + wide, bottom - unit]);
  if (aim !== null) {
    const y = bottom - aim * unit;
    context.setLineDash([4, 4]);
    stroke(context, theme.ink, 1.5, [x - 5, y], [x + wide + 5, y]);
    context.setLineDash([]);
  }
  write(context, name, [x + wide / 2, bottom + 14], theme.quiet, "11", "center", "alphabetic");
}

/** Two tanks, the first above the second, with their valves. */
export function doubleTank(context, size, theme, { state, control, data }) {
  const above = data.drawn_length, unit = (size.height - 62) / (1 + above);
  const floor = size.height - 24, upper = floor - above * unit;
  const wide = Math.min(92, size.width * 0.24);
  const [left, right] = [size.width * 0.24 - wide / 2 + 8, size.width * 0.64 - wide / 2];
  const middle = left + wide + (right - left - wide) / 2, names = data.alphabet.inputs;
  const goal = [null, null], { ball, axes } = data.target ?? {};
  if (ball) axes.forEach((axis, k) => (goal[axis] = ball.center[k]));
  const pipe = (flow, ...points) =>
    stroke(context, flow > 0 ? WATER[theme.mode] : theme.faint, 5, ...points);

  const top = upper - unit - 14;
  pipe(control[0], [left - 22, top], [left + wide / 2, top], [left + wide / 2, top + 12]);
  pipe(control[1], [left + wide, upper - 5], [right + 8, upper - 5], [right + 8, upper + 6]);
  pipe(control[2], [right + wide, floor - 5], [right + wide + 44, floor - 5]);
  [[left, upper], [right, floor]].forEach(([x, bottom], k) =>
    tank(context, theme, { x, wide, bottom, unit }, state[k], goal[k], data.domain.names[k]));
  valve(context, theme, left - 2, top, control[0], names[0]);
  valve(context, theme, middle, upper - 5, control[1], names[1]);
  valve(context, theme, right + wide + 24, floor - 5, control[2], names[2]);
}
