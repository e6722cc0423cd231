import { write } from "../dom/canvas.js";
import { longest, ordered } from "../state/tracks.js";

/** Width of the pieces of time that are looked at as one, in CSS pixels. */
const PIECE = 3;

const scaleOf = plot => plot.bbox.width / Math.max(1, plot.over.clientWidth);
const pixel = (plot, sample, rate) => Math.round(plot.valToPos(sample / rate, "x", true));
/** The pixels where piece k of a track begins and ends. */
const ends = (plot, { symbols, rate }, each, k) =>
  [k * each, Math.min((k + 1) * each, symbols.length)].map(sample => pixel(plot, sample, rate));

/**
 * Return what a closed loop did in equal pieces of time: for each piece that it reached
 * {shares, changes, from, to}, the shares of its time by symbol, how often the symbol changed in
 * it, and the samples [from, to) that it meets. `track` has symbols and rate.
 */
function pieces({ symbols, rate }, length, count) {
  const reached = [], each = (length * rate) / count;
  for (let piece = 0; piece < count; piece++) {
    const start = piece * each, end = Math.min(start + each, symbols.length);
    if (!(end > start)) break;
    const from = Math.floor(start), to = Math.ceil(end), shares = new Map();
    let changes = 0;
    for (let k = from; k < to; k++) {
      const weight = (Math.min(k + 1, end) - Math.max(k, start)) / (end - start);
      shares.set(symbols[k], (shares.get(symbols[k]) ?? 0) + weight);
      if (k > from && symbols[k] !== symbols[k - 1]) changes += 1;
    }
    reached.push({ shares, changes, from, to });
  }
  return reached;
}

/** Return painters of inputs and symbols over time: {inputs(i), symbols, pieces(track, plot)}. */
export function makeStrips(app) {
  const kept = new WeakMap();

  /** The pieces of a track, each of so many samples, made anew for another length or width. */
  function piecesOf(track, plot) {
    const length = longest(app.tracks);
    const count = Math.max(1, Math.round(plot.over.clientWidth / PIECE));
    const known = kept.get(track);
    if (known?.count === count && known.length === length) return known;
    const each = (length * track.rate) / count;
    const cut = { count, length, each, list: pieces(track, length, count) };
    kept.set(track, cut);
    return cut;
  }

  return {
    inputs: i => plot => paintInputs(app, i, plot, piecesOf),
    symbols: plot => paintSymbols(app, plot, piecesOf),
    pieces: (track, plot) => piecesOf(track, plot).list,
  };
}

function paintInputs(app, i, plot, piecesOf) {
  const { ctx } = plot, scale = scaleOf(plot), most = app.tracks.length - 1;
  ctx.save();
  ctx.lineJoin = "round";
  for (const track of ordered(app)) {
    const strong = track === app.active, aside = (app.tracks.indexOf(track) - most / 2) * 2 * scale;
    ctx.fillStyle = ctx.strokeStyle = app.theme.track(track.color);
    ctx.lineWidth = (strong ? 1.8 : 1.2) * scale;
    const valueOf = symbol => app.data.controls.at(symbol)[i];
    const place = value => plot.valToPos(value, "y", true) + aside;
    paintInput(plot, track, piecesOf(track, plot), { valueOf, place, alpha: strong ? 0.25 : 0.08 });
  }
  ctx.restore();
}

/** An input of a track: its steps, and where it chatters its mean in the band that it spans. */
function paintInput(plot, track, { each, list }, { valueOf, place, alpha }) {
  const { ctx } = plot, { symbols, rate } = track, line = new Path2D();
  list.forEach(({ shares, changes, from, to }, k) => {
    const [x0, x1] = ends(plot, track, each, k), values = [...shares.keys()].map(valueOf);
    const [low, high] = [Math.min(...values), Math.max(...values)];
    if (changes >= 2 && high > low) {
      const mean = [...shares].reduce((sum, [symbol, share]) => sum + share * valueOf(symbol), 0);
      ctx.globalAlpha = alpha;
      ctx.fillRect(x0, place(high), x1 - x0, place(low) - place(high));
      ctx.globalAlpha = 1;
      line.lineTo(x0, place(mean));
      line.lineTo(x1, place(mean));
      return;
    }
    for (let sample = from; sample < to; sample++) {
      const y = place(valueOf(symbols[sample]));
      line.lineTo(Math.max(x0, pixel(plot, sample, rate)), y);
      line.lineTo(Math.min(x1, pixel(plot, sample + 1, rate)), y);
    }
  });
  ctx.stroke(line);
}

/** Each track's symbols as a band, with its number where there are several. */
function paintSymbols(app, plot, piecesOf) {
  const { ctx, bbox } = plot, scale = scaleOf(plot), row = bbox.height / app.tracks.length;
  ctx.save();
  app.tracks.forEach((track, place) => {
    const top = bbox.top + place * row + scale, height = row - 2 * scale;
    paintBand(plot, track, piecesOf(track, plot), { top, height, theme: app.theme });
    if (app.tracks.length < 2) return;
    const at = [bbox.left - 5 * scale, top + height / 2], color = app.theme.track(track.color);
    write(ctx, String(track.number), at, color, `600 ${11 * scale}`, "right");
  });
  ctx.restore();
}

/** The symbols of a track: in every piece of time their shares, one above the other. */
function paintBand(plot, track, { each, list }, { top, height, theme }) {
  const { ctx } = plot, { symbols, rate } = track;
  list.forEach(({ shares, changes, from, to }, k) => {
    const [x0, x1] = ends(plot, track, each, k);
    if (changes < 2) {
      for (let sample = from; sample < to; sample++) {
        const left = Math.max(x0, pixel(plot, sample, rate));
        ctx.fillStyle = theme.paint(symbols[sample]);
        ctx.fillRect(left, top, x1 - left, height);
      }
      return;
    }
    let y = top;
    for (const [symbol, share] of [...shares].sort(([a], [b]) => a - b)) {
      ctx.fillStyle = theme.paint(symbol);
      ctx.fillRect(x0, y, x1 - x0, share * height);
      y += share * height;
    }
  });
}
