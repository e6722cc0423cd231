/**
 * @typedef {object} Track  A trajectory of the closed loop: what `run` of `makeLoop` returns, and
 * @property {Float64Array[]} states  (K+1) of (n) [state units]
 * @property {object} options  what it was computed with
 * @property {number[]} start  (n) where it was asked to start [state units]
 * @property {string} words  what is unusual about its options
 * @property {number} number  its number on the page
 * @property {number} color  of the theme's colours for tracks
 */

/** Return how long the longest of some tracks is [s]; 0 if there is none. */
export function longest(tracks) {
  return tracks.reduce((most, track) => Math.max(most, track.t.at(-1)), 0);
}

/** Return the sample of a track at the present. */
export function progress({ player }, track) {
  return Math.min(Math.floor(player.time * track.rate + 1e-6), track.states.length - 1);
}

/** Return the symbol of a track from a sample on; undefined where it has none. */
export function symbolAt({ symbols }, sample) {
  return symbols[Math.min(sample, symbols.length - 1)];
}

/** Return the tracks in the order of drawing: the active one last. */
export function ordered({ tracks, active }) {
  return [...tracks.filter(track => track !== active), active].filter(Boolean);
}
