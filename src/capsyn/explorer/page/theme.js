/* Okabe and Ito's colours, which stay apart under colour blindness, and samples of cividis. */
const OKABE_ITO = [
  "#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#F0E442", "#999999",
];
const CIVIDIS = [
  "#00224e", "#123570", "#3b496c", "#575d6d", "#707173", "#8a8678", "#a59c74", "#c3b369", "#e1cc55",
  "#fee838",
];
const THEMES = {
  light: {
    paper: "#ffffff", ink: "#1c2128", quiet: "#5b6470", faint: "#d8dde3", halo: "#ffffff", hatch: "#ffffffb0",
    mixed: "#ffffff", stripe: "#c3cad3", none: "#eef0f3", fallback: "#dfe3e8",
    tracks: ["#15181d", "#b3005e", "#00518a", "#6b3a00", "#37500a", "#5b2a86"],
  },
  dark: {
    paper: "#171b21", ink: "#e6eaef", quiet: "#98a2ae", faint: "#323943", halo: "#0c0f13", hatch: "#0c0f13c0",
    mixed: "#171b21", stripe: "#485261", none: "#20262e", fallback: "#39414c",
    tracks: ["#ffffff", "#ff9acb", "#9bd8ff", "#ffc58a", "#d3ea8d", "#d9bfff"],
  },
};
/** How much of the paper is mixed into the colours of the map. */
const SOFTENED = { light: 0.2, dark: 0.12 };

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

/** Return the pure colours of `count` symbols. */
export function symbolColors(count) {
  if (count <= OKABE_ITO.length) return OKABE_ITO.slice(0, count);
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

/** Return the theme of the page for `count` symbols: its mode, colours, and `toggle`. */
export function makeTheme(count, changed) {
  const wish = window.matchMedia("(prefers-color-scheme: dark)");
  const pure = symbolColors(count);
  const theme = {};

  function set(mode) {
    document.documentElement.dataset.theme = mode;
    const colors = THEMES[mode];
    const symbols = pure.map(color => blend(color, colors.paper, SOFTENED[mode]));
    Object.assign(theme, colors, { mode, symbols });
  }

  theme.color = symbol => (symbol >= 0 ? theme.symbols[symbol] : theme.fallback);
  theme.track = index => theme.tracks[index % theme.tracks.length];
  theme.toggle = () => {
    set(theme.mode === "dark" ? "light" : "dark");
    theme.chosen = true;
    changed();
  };
  wish.addEventListener("change", () => {
    if (theme.chosen) return;
    set(wish.matches ? "dark" : "light");
    changed();
  });
  set(wish.matches ? "dark" : "light");
  return theme;
}
