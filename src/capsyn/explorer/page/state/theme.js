import { blend } from "../dom/colors.js";
import { makeMarks } from "../dom/marks.js";

const THEMES = {
  light: {
    paper: "#ffffff", ink: "#1c2128", quiet: "#5b6470", faint: "#d8dde3",
    halo: "#ffffff", hatch: "#ffffffb0",
    mixed: "#ffffff", stripe: "#c3cad3", none: "#eef0f3", fallback: "#dfe3e8",
    tracks: ["#15181d", "#b3005e", "#00518a", "#6b3a00", "#37500a", "#5b2a86"],
  },
  dark: {
    paper: "#171b21", ink: "#e6eaef", quiet: "#98a2ae", faint: "#323943",
    halo: "#0c0f13", hatch: "#0c0f13c0",
    mixed: "#171b21", stripe: "#485261", none: "#20262e", fallback: "#7d8793",
    tracks: ["#ffffff", "#ff9acb", "#9bd8ff", "#ffc58a", "#d3ea8d", "#d9bfff"],
  },
};
/** How much of the paper is mixed into the colours of the map. */
const SOFTENED = { light: 0.2, dark: 0.12 };

/** Return the theme of the page for symbols of some looks: its mode, colours, marks, `toggle`. */
export function makeTheme({ looks, tiles }, changed) {
  const wish = window.matchMedia("(prefers-color-scheme: dark)");
  const theme = {};

  function set(mode) {
    document.documentElement.dataset.theme = mode;
    const colors = THEMES[mode];
    const symbols = looks.map(([color]) => blend(color, colors.paper, SOFTENED[mode]));
    Object.assign(theme, colors, { mode, symbols, marks: makeMarks(looks, tiles, symbols) });
  }

  theme.color = symbol => (symbol >= 0 ? theme.symbols[symbol] : theme.fallback);
  /** What a canvas fills with for a symbol. */
  theme.paint = symbol =>
    (theme.marks.dots(symbol) ? theme.marks.pattern(symbol) : theme.color(symbol));
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
