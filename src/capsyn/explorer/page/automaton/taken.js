/**
 * Return a counter of a track's transitions: {follow(track, now), count(source, target), all}.
 * Labels are those of the automaton; `last` is the default's.
 */
export function makeTaken(last) {
  const labelOf = symbol => (symbol < 0 ? last : symbol);
  let track = null, sample = 0, counts = new Map();

  /** Count up to a sample; another track, or going back, counts anew. */
  function follow(next, now) {
    const symbols = next?.symbols ?? [], stop = Math.min(now, symbols.length - 1);
    if (track !== next || stop < sample || !symbols.length) {
      [track, sample, counts] = [next, 0, new Map()];
    }
    for (let k = sample + 1; k <= stop; k++) {
      const key = `${labelOf(symbols[k - 1])}>${labelOf(symbols[k])}`;
      counts.set(key, (counts.get(key) ?? 0) + 1);
    }
    sample = Math.max(stop, 0);
  }

  return {
    follow,
    count: (source, target) => counts.get(`${source}>${target}`) ?? 0,
    /** How often each edge has been taken, by "source>target". */
    all: () => Object.fromEntries(counts),
  };
}
