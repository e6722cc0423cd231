import { ticks, tickText, withUnit } from "../dom/text.js";

const FONT = '12px system-ui, -apple-system, "Segoe UI", Roboto, sans-serif';

/** Draw the axes of a view around its frame; return the texts of their ticks, {x, y}. */
export function drawAxes(context, frame, { data: { domain }, theme, view }) {
  const [x0, x1, y0, y1] = view.bounds, bottom = frame.y + frame.height;
  const names = view.axes.map(axis => withUnit(domain.names[axis], domain.units[axis]));
  context.font = FONT;
  context.strokeStyle = theme.quiet;
  context.lineWidth = 1;
  context.strokeRect(frame.x - 0.5, frame.y - 0.5, frame.width + 1, frame.height + 1);
  const columns = ticks(x0, x1, frame.width / 90), rows = ticks(y0, y1, frame.height / 60);
  write(context, "center", "top", theme.quiet);
  const x = columns.map(tickText(columns));
  columns.forEach((value, k) => {
    const at = frame.x + ((value - x0) / (x1 - x0)) * frame.width;
    line(context, at, bottom + 1, at, bottom + 5);
    context.fillText(x[k], at, bottom + 8);
  });
  write(context, "center", "alphabetic", theme.ink);
  context.fillText(names[0], frame.x + frame.width / 2, bottom + 38);
  if (view.n === 1) return { x, y: [] };
  write(context, "right", "middle", theme.quiet);
  const y = rows.map(tickText(rows));
  rows.forEach((value, k) => {
    const at = bottom - ((value - y0) / (y1 - y0)) * frame.height;
    line(context, frame.x - 5, at, frame.x - 1, at);
    context.fillText(y[k], frame.x - 8, at);
  });
  context.save();
  context.translate(14, frame.y + frame.height / 2);
  context.rotate(-Math.PI / 2);
  write(context, "center", "middle", theme.ink);
  context.fillText(names[1], 0, 0);
  context.restore();
  return { x, y };
}

function write(context, align, baseline, color) {
  context.textAlign = align;
  context.textBaseline = baseline;
  context.fillStyle = color;
}

function line(context, x0, y0, x1, y1) {
  context.beginPath();
  context.moveTo(x0, y0);
  context.lineTo(x1, y1);
  context.stroke();
}
