import { arrow, disc, stroke } from "../dom/canvas.js";

/** A cart on rails, its pole (positive angles to the left), and how it is accelerated. */
function cart(context, { width }, theme, { at, rail, length, angle, push, color }) {
  stroke(context, theme.faint, 2, [12, rail + 15], [width - 12, rail + 15]);
  context.fillStyle = theme.quiet;
  context.beginPath();
  context.roundRect(at - 24, rail - 9, 48, 18, 4);
  context.fill();
  for (const wheel of [-13, 13]) disc(context, theme.ink, [at + wheel, rail + 10], 4.5);
  const tip = [at - length * Math.sin(angle), rail - length * Math.cos(angle)];
  stroke(context, theme.ink, 4, [at, rail], tip);
  disc(context, theme.ink, [at, rail], 4);
  disc(context, color, tip, 9, theme.ink, 2);
  arrow(context, theme.ink, at + Math.sign(push) * 32, rail, push * 30);
}

/** The pendulum, whose cart stays in the middle. */
export function pendulum(context, size, theme, { state, control, color, strongest }) {
  const length = Math.min(size.width, size.height) * 0.4;
  const setting = { at: size.width / 2, rail: size.height / 2, length };
  cart(context, size, theme, { ...setting, angle: state[0], push: control[0] / strongest, color });
}

export function cartPole(context, size, theme, { state, control, color, strongest, data }) {
  const [low, high] = [data.domain.lower[0], data.domain.upper[0]], pole = data.drawn_length;
  const reach = Math.max(high - low, 2.2 * Math.abs(state[0] - (low + high) / 2));
  const unit = Math.min((size.width - 150) / reach, (size.height - 70) / pole);
  const at = size.width / 2 + (state[0] - (low + high) / 2) * unit;
  const setting = { at, rail: size.height - 40, length: pole * unit, angle: state[2] };
  cart(context, size, theme, { ...setting, push: control[0] / strongest, color });
}
