/* Samples of cividis. */
const CIVIDIS = [
  "#00224e", "#123570", "#3b496c", "#575d6d", "#707173", "#8a8678", "#a59c74", "#c3b369", "#e1cc55",
  "#fee838",
];

function parts(color) {
  return [1, 3, 5].map(k => parseInt(color.slice(k, k + 2), 16));
}

/** Return a colour with a share of another mixed in. */
export function blend(one, other, share) {
  const [a, b] = [parts(one), parts(other)];
  const mixed = a.map((v, i) => Math.round(v * (1 - share) + b[i] * share));
  return "#" + mixed.map(v => v.toString(16).padStart(2, "0")).join("");
}

function sampled(colors, place) {
  const at = place * (colors.length - 1), k = Math.min(Math.floor(at), colors.length - 2);
  return blend(colors[k], colors[k + 1], at - k);
}

/** Return the pure colours of `count` symbols: of a palette where it has enough. */
export function symbolColors(count, palette) {
  if (count <= palette.length) return palette.slice(0, count);
  return Array.from({ length: count }, (_, k) => sampled(CIVIDIS, k / (count - 1)));
}

/** Return a colour of 32-bit pixels. */
export function pixel(color) {
  const [red, green, blue] = parts(color);
  return ((255 << 24) | (blue << 16) | (green << 8) | red) >>> 0;
}

/** Return black or white, whichever is easier to read on a colour. */
export function readable(color) {
  const [red, green, blue] = parts(color);
  return 0.299 * red + 0.587 * green + 0.114 * blue < 140 ? "#ffffff" : "#15181d";
}
