/** Return how long the longest of some tracks is; 0 if there is none. */
export function longest(tracks) {
  return tracks.reduce((most, track) => Math.max(most, track.t.at(-1)), 0);
}

/** Return the sample of a track at the present. */
export function progress({ player }, track) {
  return Math.min(Math.floor(player.time * track.rate + 1e-6), track.states.length - 1);
}

/** Return the first sample of a track that is not before the present; its last if all are. */
export function coming({ player }, track) {
  return Math.min(Math.ceil(player.time * track.rate - 1e-6), track.states.length - 1);
}

/** Return the symbol of a track from a sample on; undefined where it has none. */
export function symbolAt({ symbols }, sample) {
  return symbols[Math.min(sample, symbols.length - 1)];
}

/** Return the tracks in the order of drawing: the active one last. */
export function ordered({ tracks, active }) {
  return [...tracks.filter(track => track !== active), active].filter(Boolean);
}
