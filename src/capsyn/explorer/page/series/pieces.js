/**
 * Return what a closed loop did in equal pieces of time: for each piece that it reached
 * {shares, changes, from, to}, the shares of its time by symbol, how often the symbol changed in
 * it, and the samples [from, to) that it meets. `track` has symbols and rate [1/s].
 */
export function pieces({ symbols, rate }, length, count) {
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

/** Return samples of a curve of `count` that keep its least and greatest value in every piece. */
export function extremes(count, value, pieces) {
  const kept = [], each = Math.max(1, count / pieces);
  if (each <= 3) return Array.from({ length: count }, (_, k) => k);
  for (let start = 0; start < count; start += each) {
    const from = Math.floor(start), to = Math.min(count, Math.floor(start + each));
    let [low, high] = [from, from];
    for (let k = from + 1; k < to; k++) {
      const here = value(k);
      if (here < value(low)) low = k;
      if (here > value(high)) high = k;
    }
    kept.push(...[...new Set([from, low, high])].sort((a, b) => a - b));
  }
  if (kept.at(-1) !== count - 1) kept.push(count - 1);
  return kept;
}
