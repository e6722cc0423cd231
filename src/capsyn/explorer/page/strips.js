import { pieces } from "./chatter.js";

/** Width of the pieces of time that are looked at as one, in CSS pixels. */
const PIECE = 3;

/** Return the painters of inputs and symbols over time: {inputs(i), symbols, pieces(track, plot)}. */
export function makeStrips(app) {
  const { data } = app, kept = new WeakMap();
  const scaleOf = plot => plot.bbox.width / Math.max(1, plot.over.clientWidth);

  /** The pieces of a track, each of so many samples, made anew for another length or width. */
  function piecesOf(track, plot) {
    const count = Math.max(1, Math.round(plot.over.clientWidth / PIECE)), length = app.longest();
    const known = kept.get(track);
    if (known?.count === count && known.length === length) return known;
    const each = (length * track.rate) / count;
    const made = { count, length, each, found: pieces(track, length, count) };
    kept.set(track, made);
    return made;
  }

  const time = (plot, k, rate) => Math.round(plot.valToPos(k / rate, "x", true));

  /** An input of each track: its steps, and where it chatters its mean in the band that it spans. */
  const inputs = i => plot => {
    const { ctx } = plot, scale = scaleOf(plot), most = app.tracks.length - 1;
    const values = symbol => data.controls.at(symbol)[i];
    ctx.save();
    ctx.lineJoin = "round";
    for (const track of [...app.tracks.filter(one => one !== app.active), app.active]) {
      const aside = (app.tracks.indexOf(track) - most / 2) * 2 * scale;
      const { each, found } = piecesOf(track, plot);
      const place = value => plot.valToPos(value, "y", true) + aside;
      ctx.fillStyle = ctx.strokeStyle = app.theme.track(track.color);
      ctx.lineWidth = (track === app.active ? 1.8 : 1.2) * scale;
      const line = new Path2D(), { symbols, rate } = track;
      let first = true;
      const to = (x, y) => {
        if (first) line.moveTo(x, y);
        else line.lineTo(x, y);
        first = false;
      };
      found.forEach(({ shares, changes, from, to: end }, k) => {
        const x0 = time(plot, k * each, rate), x1 = time(plot, Math.min((k + 1) * each, symbols.length), rate);
        const seen = [...shares.keys()].map(values), [low, high] = [Math.min(...seen), Math.max(...seen)];
        if (changes >= 2 && high > low) {
          const mean = [...shares].reduce((sum, [symbol, share]) => sum + share * values(symbol), 0);
          ctx.globalAlpha = track === app.active ? 0.25 : 0.08;
          ctx.fillRect(x0, place(high), x1 - x0, place(low) - place(high));
          ctx.globalAlpha = 1;
          to(x0, place(mean));
          to(x1, place(mean));
          return;
        }
        for (let sample = from; sample < end; sample++) {
          const y = place(values(symbols[sample]));
          to(Math.max(x0, time(plot, sample, rate)), y);
          to(Math.min(x1, time(plot, sample + 1, rate)), y);
        }
      });
      ctx.stroke(line);
    }
    ctx.restore();
  };

  /** Each track's symbols as a band: in every piece of time their shares, one above the other. */
  function symbols(plot) {
    const { ctx, bbox } = plot, scale = scaleOf(plot), row = bbox.height / app.tracks.length;
    ctx.save();
    app.tracks.forEach((track, place) => {
      const { each, found } = piecesOf(track, plot), { rate } = track;
      const top = bbox.top + place * row + scale, height = row - 2 * scale;
      found.forEach(({ shares, changes, from, to }, k) => {
        const end = Math.min((k + 1) * each, track.symbols.length);
        const [x0, x1] = [k * each, end].map(sample => time(plot, sample, rate));
        if (changes < 2) {
          for (let sample = from; sample < to; sample++) {
            const left = Math.max(x0, time(plot, sample, rate));
            ctx.fillStyle = app.theme.color(track.symbols[sample]);
            ctx.fillRect(left, top, x1 - left, height);
          }
          return;
        }
        let y = top;
        for (const [symbol, share] of [...shares].sort(([a], [b]) => a - b)) {
          ctx.fillStyle = app.theme.color(symbol);
          ctx.fillRect(x0, y, x1 - x0, share * height);
          y += share * height;
        }
      });
      if (app.tracks.length < 2) return;
      ctx.fillStyle = app.theme.track(track.color);
      ctx.font = `600 ${11 * scale}px system-ui, sans-serif`;
      ctx.textAlign = "right";
      ctx.textBaseline = "middle";
      ctx.fillText(String(track.number), bbox.left - 5 * scale, top + height / 2);
    });
    ctx.restore();
  }

  return { inputs, symbols, pieces: piecesOf };
}
