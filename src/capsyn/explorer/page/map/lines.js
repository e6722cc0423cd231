import { toPixels } from "./frame.js";

/**
 * Return the lines of tracks in a plane, which are kept: {whole, until}.
 * `whole(track, view, frame)` is a Path2D with its number of `pieces`, made anew when the view or
 * the frame has changed; `until(track, now, view, frame)` is its part up to a sample, to which
 * is added as it goes on.
 */
export function makeLines() {
  const kept = new WeakMap();

  function whole(track, view, frame) {
    const key = [...view.axes, ...view.bounds, ...Object.values(frame)].join();
    const known = kept.get(track);
    if (known?.key === key) return known.line;
    const line = trace(track, 0, track.states.length - 1, view, frame);
    kept.set(track, { key, line, done: new Path2D(), at: 0 });
    return line;
  }

  function until(track, now, view, frame) {
    const known = kept.get(track);
    if (now < known.at) Object.assign(known, { done: new Path2D(), at: 0 });
    if (now > known.at) known.done.addPath(trace(track, known.at, now, view, frame));
    known.at = now;
    return known.done;
  }

  return { whole, until };
}

/** The line of a track between two samples; at the seam of a period it leaves and returns. */
function trace({ states }, first, last, view, frame) {
  const line = new Path2D();
  const period = [view.period(0) * frame.width, view.period(1) * frame.height];
  let [px, py] = toPixels(frame, view.place(states[first])), pieces = 1;
  line.moveTo(px, py);
  for (let k = first + 1; k <= last; k++) {
    const [x, y] = toPixels(frame, view.place(states[k]));
    const [dx, dy] = [x - px, y - py];
    if (k < last && Math.abs(dx) < 1 && Math.abs(dy) < 1) continue;
    const right = Math.abs(dx) > period[0] / 2 ? Math.sign(dx) * period[0] : 0;
    const down = Math.abs(dy) > period[1] / 2 ? Math.sign(dy) * period[1] : 0;
    if (right || down) {
      line.lineTo(x - right, y - down);
      line.moveTo(px + right, py + down);
      pieces += 1;
    }
    line.lineTo(x, y);
    [px, py] = [x, y];
  }
  return Object.assign(line, { pieces });
}
