import { byId, fit, tickText, ticks, withUnit } from "./dom.js";
import { picture } from "./picture.js";
import { targetPaths } from "./target.js";
import { readable } from "./theme.js";

const NEAR = 14;
const MOVED = 4;
const FINE = 1 / 200, COARSE = 1 / 40;
const FONT = '12px system-ui, -apple-system, "Segoe UI", Roboto, sans-serif';

/**
 * Return the map of the page: {draw, sweep, redraw, zoomed, shown}. `draw` paints all, `sweep` what
 * moves; `redraw` tells how long a picture takes, and `shown` what is drawn.
 *
 * `app` has data, lookup, model, theme, view, tracks (a list), active, pointed, progress(track) and
 * the callbacks point(state), start(state), move(state), note(text), changed().
 */
export function makeMap(app) {
  const { data, lookup, view } = app;
  const base = byId("map-base"), overlay = byId("map");
  const n = data.domain.lower.length;
  const margin = n > 1 ? { left: 60, right: 14, top: 12, bottom: 44 }
    : { left: 16, right: 16, top: 12, bottom: 44 };
  let frame = { x: 0, y: 0, width: 1, height: 1 }, scale = 1, goal = null, lines = new WeakMap(), labels = {};

  const label = axis => withUnit(data.domain.names[axis], data.domain.units[axis]);
  const toPixels = ([across, up]) => [
    frame.x + across * frame.width, frame.y + (1 - up) * frame.height,
  ];
  const toShares = (x, y) => [(x - frame.x) / frame.width, 1 - (y - frame.y) / frame.height];

  function draw() {
    const size = fit(base);
    fit(overlay);
    scale = size.scale;
    const round = value => Math.round(value * scale) / scale;
    frame = {
      x: margin.left, y: margin.top,
      width: Math.max(20, round(size.width - margin.left - margin.right)),
      height: Math.max(20, round(size.height - margin.top - margin.bottom)),
    };
    const context = base.getContext("2d");
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.clearRect(0, 0, base.width, base.height);
    const [w, h] = [Math.round(frame.width * scale), Math.round(frame.height * scale)];
    context.putImageData(picture(lookup, view, app.theme, w, h), frame.x * scale, frame.y * scale);
    context.setTransform(scale, 0, 0, scale, 0, 0);
    axes(context);
    goal = target();
    sweep();
  }

  function axes(context) {
    const { theme } = app, [x0, x1, y0, y1] = view.bounds;
    context.font = FONT;
    context.strokeStyle = theme.quiet;
    context.lineWidth = 1;
    context.strokeRect(frame.x - 0.5, frame.y - 0.5, frame.width + 1, frame.height + 1);
    context.fillStyle = theme.quiet;
    context.textAlign = "center";
    context.textBaseline = "top";
    const bottom = frame.y + frame.height;
    const columns = ticks(x0, x1, frame.width / 90), rows = ticks(y0, y1, frame.height / 60);
    labels = { x: columns.map(tickText(columns)), y: n > 1 ? rows.map(tickText(rows)) : [] };
    for (const [k, value] of columns.entries()) {
      const x = frame.x + ((value - x0) / (x1 - x0)) * frame.width;
      line(context, x, bottom + 1, x, bottom + 5);
      context.fillText(labels.x[k], x, bottom + 8);
    }
    context.fillStyle = theme.ink;
    context.textBaseline = "alphabetic";
    context.fillText(label(view.axes[0]), frame.x + frame.width / 2, bottom + 38);
    if (n === 1) return;
    context.textAlign = "right";
    context.textBaseline = "middle";
    context.fillStyle = theme.quiet;
    for (const [k, value] of rows.entries()) {
      const y = bottom - ((value - y0) / (y1 - y0)) * frame.height;
      line(context, frame.x - 5, y, frame.x - 1, y);
      context.fillText(labels.y[k], frame.x - 8, y);
    }
    context.save();
    context.translate(14, frame.y + frame.height / 2);
    context.rotate(-Math.PI / 2);
    context.textAlign = "center";
    context.fillStyle = theme.ink;
    context.fillText(label(view.axes[1]), 0, 0);
    context.restore();
  }

  function line(context, x0, y0, x1, y1) {
    context.beginPath();
    context.moveTo(x0, y0);
    context.lineTo(x1, y1);
    context.stroke();
  }

  function sweep() {
    const context = overlay.getContext("2d");
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.clearRect(0, 0, overlay.width, overlay.height);
    context.setTransform(scale, 0, 0, scale, 0, 0);
    context.save();
    context.beginPath();
    context.rect(frame.x, frame.y, frame.width, frame.height);
    context.clip();
    if (goal) shade(context);
    const order = [...app.tracks.filter(track => track !== app.active), app.active].filter(Boolean);
    for (const track of order) path(context, track);
    pointer(context);
    context.restore();
    for (const track of order) marks(context, track);
  }

  /** Where the target is in the plane. */
  function target() {
    if (!app.model || !data.target || n === 1) return null;
    const [x0, x1, y0, y1] = view.bounds, [i, j] = view.axes;
    const state = Float64Array.from(view.fixed), answer = new Float64Array(1);
    return targetPaths((across, up) => {
      state[i] = x0 + across * (x1 - x0);
      state[j] = y0 + up * (y1 - y0);
      app.model.inside(state, answer);
      return answer[0] !== 0;
    }, toPixels, frame.width, frame.height);
  }

  /** Shares of the plane without wrapping. */
  function shares(state) {
    const [x0, x1, y0, y1] = view.bounds, [i, j] = view.axes;
    return [(state[i] - x0) / (x1 - x0), n > 1 ? (state[j] - y0) / (y1 - y0) : 0.5];
  }

  /** The target: hatched, within a dashed line. */
  function shade(context) {
    context.lineCap = "butt";
    context.lineWidth = 1;
    context.strokeStyle = app.theme.hatch;
    context.stroke(goal.hatch);
    context.strokeStyle = app.theme.halo;
    context.lineWidth = 3;
    context.stroke(goal.edge);
    context.setLineDash([5, 4]);
    context.strokeStyle = app.theme.ink;
    context.lineWidth = 1.6;
    context.stroke(goal.edge);
    context.setLineDash([]);
  }

  function halo(context, color, width, alpha, lines) {
    context.globalAlpha = alpha;
    context.lineJoin = "round";
    context.lineCap = "round";
    for (const [paint, wide] of [[app.theme.halo, width + 2.5], [color, width]]) {
      context.strokeStyle = paint;
      context.lineWidth = wide;
      if (lines) context.stroke(lines);
      else context.stroke();
    }
    context.globalAlpha = 1;
  }

  /** The line of a track between two of its samples; at the seam of a period it leaves and returns. */
  function trace(track, first, last) {
    const { states } = track, lines = new Path2D();
    const period = [view.period(0) * frame.width, view.period(1) * frame.height];
    let [px, py] = toPixels(view.place(states[first])), pieces = 1;
    lines.moveTo(px, py);
    for (let k = first + 1; k <= last; k++) {
      const [x, y] = toPixels(view.place(states[k]));
      const [dx, dy] = [x - px, y - py];
      if (k < last && Math.abs(dx) < 1 && Math.abs(dy) < 1) continue;
      const right = Math.abs(dx) > period[0] / 2 ? Math.sign(dx) * period[0] : 0;
      const down = Math.abs(dy) > period[1] / 2 ? Math.sign(dy) * period[1] : 0;
      if (right || down) {
        lines.lineTo(x - right, y - down);
        lines.moveTo(px + right, py + down);
        pieces += 1;
      }
      lines.lineTo(x, y);
      [px, py] = [x, y];
    }
    return Object.assign(lines, { pieces });
  }

  /** The whole line of a track, made anew when the view or the frame has changed. */
  function whole(track) {
    const key = [...view.axes, ...view.bounds, ...Object.values(frame)].join();
    const kept = lines.get(track);
    if (kept?.key === key) return kept.line;
    const line = trace(track, 0, track.states.length - 1);
    lines.set(track, { key, line, done: new Path2D(), at: 0 });
    return line;
  }

  /** Its line up to a sample: what has been drawn is kept. */
  function until(track, now) {
    const kept = lines.get(track);
    if (now < kept.at) Object.assign(kept, { done: new Path2D(), at: 0 });
    if (now > kept.at) kept.done.addPath(trace(track, kept.at, now));
    kept.at = now;
    return kept.done;
  }

  function path(context, track) {
    const color = app.theme.track(track.color), now = app.progress(track);
    const strong = track === app.active, all = whole(track), going = now < track.states.length - 1;
    halo(context, color, strong ? 1.6 : 1.2, going ? 0.32 : strong ? 1 : 0.75, all);
    if (going) halo(context, color, strong ? 2.2 : 1.6, 1, until(track, now));
  }

  function marks(context, track) {
    const color = app.theme.track(track.color), now = app.progress(track);
    const [sx, sy] = toPixels(view.place(track.states[0]));
    if (inside(sx, sy)) {
      context.beginPath();
      context.arc(sx, sy, 8.5, 0, 2 * Math.PI);
      context.fillStyle = color;
      context.fill();
      context.strokeStyle = app.theme.halo;
      context.lineWidth = 2;
      context.stroke();
      context.fillStyle = readable(color);
      context.font = "600 11px system-ui, sans-serif";
      context.textAlign = "center";
      context.textBaseline = "middle";
      context.fillText(String(track.number), sx, sy + 0.5);
    }
    const [x, y] = toPixels(view.place(track.states[now]));
    if (!inside(x, y) || now === 0) return;
    context.beginPath();
    context.arc(x, y, 6, 0, 2 * Math.PI);
    context.fillStyle = app.theme.color(track.symbols[Math.min(now, track.symbols.length - 1)]);
    context.fill();
    context.strokeStyle = color;
    context.lineWidth = 2.5;
    context.stroke();
  }

  const inside = (x, y) => x >= frame.x - 1 && x <= frame.x + frame.width + 1 &&
    y >= frame.y - 1 && y <= frame.y + frame.height + 1;

  function pointer(context) {
    const { theme, pointed } = app;
    if (!pointed) return;
    const { cell, state } = pointed, [x, y] = toPixels(view.place(state));
    if (cell && cell.lower) {
      const [left, bottom] = toPixels(shares(cell.lower)), [right, top] = toPixels(shares(cell.upper));
      context.beginPath();
      if (n > 1) context.rect(left, top, right - left, bottom - top);
      else context.rect(left, frame.y, right - left, frame.height);
      halo(context, theme.ink, 1.5, 1);
    }
    context.beginPath();
    context.moveTo(x - 7, y);
    context.lineTo(x + 7, y);
    context.moveTo(x, y - 7);
    context.lineTo(x, y + 7);
    halo(context, theme.ink, 1.2, 1);
  }

  /** Milliseconds that one picture of so many pixels takes, put on a canvas of its own. */
  function redraw(width, height) {
    const canvas = new OffscreenCanvas(width, height), context = canvas.getContext("2d");
    const started = performance.now();
    context.putImageData(picture(lookup, view, app.theme, width, height), 0, 0);
    return performance.now() - started;
  }

  function position(event) {
    const box = overlay.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  }

  let held = null;
  overlay.addEventListener("pointerdown", event => {
    if (event.button !== 0) return;
    const [x, y] = position(event);
    const start = app.active && toPixels(view.place(app.active.states[0]));
    const grab = start && Math.hypot(x - start[0], y - start[1]) < NEAR;
    held = { x, y, bounds: view.bounds, grab, moved: false };
    overlay.setPointerCapture(event.pointerId);
  });
  overlay.addEventListener("pointermove", event => {
    const [x, y] = position(event);
    const [across, up] = toShares(x, y);
    if (!held) {
      const on = across >= 0 && across <= 1 && up >= 0 && up <= 1;
      overlay.classList.toggle("grab", Boolean(app.active) &&
        Math.hypot(...toPixels(view.place(app.active.states[0])).map((v, k) => v - [x, y][k])) < NEAR);
      return app.point(on ? view.state(across, up) : null);
    }
    if (!held.moved && Math.hypot(x - held.x, y - held.y) < MOVED) return;
    held.moved = true;
    if (held.grab) {
      const [a, b] = [across, up].map(v => Math.min(Math.max(v, 0), 1));
      return app.move(view.state(a, b));
    }
    const [x0, x1, y0, y1] = held.bounds;
    const dx = ((held.x - x) / frame.width) * (x1 - x0);
    const dy = ((y - held.y) / frame.height) * (y1 - y0);
    view.show([x0 + dx, x1 + dx, y0 + dy, y1 + dy]);
    app.changed();
  });
  overlay.addEventListener("pointerup", event => {
    const was = held;
    held = null;
    if (!was || was.moved) return;
    const [across, up] = toShares(...position(event));
    if (across >= 0 && across <= 1 && up >= 0 && up <= 1) app.start(view.state(across, up));
  });
  overlay.addEventListener("pointercancel", () => (held = null));
  overlay.addEventListener("pointerleave", () => held || app.point(null));
  overlay.addEventListener("wheel", event => {
    if (document.activeElement !== overlay && !event.ctrlKey) {
      return app.note("Ctrl and the wheel zoom; the wheel alone once the map has the focus");
    }
    event.preventDefault();
    view.zoom(Math.exp(Math.sign(event.deltaY) * 0.2), view.state(...toShares(...position(event))));
    app.changed();
  }, { passive: false });

  const steps = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
  overlay.addEventListener("keydown", event => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const at = app.pointed ? view.place(app.pointed.state) : [0.5, 0.5];
    const about = () => view.state(...at);
    if (steps[event.key]) {
      const share = event.shiftKey ? FINE : COARSE;
      const next = at.map((v, k) => v + steps[event.key][k] * share);
      const beyond = next.map(v => Math.min(v, 0) + Math.max(v - 1, 0));
      if (beyond.some(Boolean)) view.move(beyond);
      app.point(view.state(...next.map(v => Math.min(Math.max(v, 0), 1))));
      if (beyond.some(Boolean)) app.changed();
    } else if (event.key === "Enter") app.start(about());
    else if (event.key === "+" || event.key === "=") zoomed(0.8, about());
    else if (event.key === "-" || event.key === "_") zoomed(1.25, about());
    else if (event.key === "0") {
      view.reset();
      app.changed();
    } else if (event.key === "Escape") app.point(null);
    else return;
    event.preventDefault();
    event.stopPropagation();
  });

  function zoomed(factor, state) {
    view.zoom(factor, state);
    app.changed();
  }

  return {
    draw, sweep, redraw, zoomed,
    shown: () => ({
      frame: { ...frame }, ticks: labels, target: goal ? goal.points : [],
      pieces: app.tracks.map(track => whole(track).pieces),
    }),
  };
}
