function parts(color) {
  return [1, 3, 5].map(k => parseInt(color.slice(k, k + 2), 16));
}

/** Return a colour with a share of another mixed in. */
export function blend(one, other, share) {
  const [a, b] = [parts(one), parts(other)];
  const mixed = a.map((v, i) => Math.round(v * (1 - share) + b[i] * share));
  return "#" + mixed.map(v => v.toString(16).padStart(2, "0")).join("");
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
