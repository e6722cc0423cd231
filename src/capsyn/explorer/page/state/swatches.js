import { element } from "../dom/elements.js";
import { MIXED, NONE } from "../policy/symbols.js";

/** Width and height of a swatch, in CSS pixels. */
const SIZE = 10;

/** A coloured square of a symbol, filled by the theme. */
export function swatch(symbol) {
  return element("span", { class: "swatch", "data-symbol": symbol });
}

export function paintSwatches(theme) {
  for (const node of document.querySelectorAll(".swatch")) {
    const symbol = Number(node.dataset.symbol);
    if (theme.marks.dots(symbol)) {
      const canvas = element("canvas", { width: 2 * SIZE, height: 2 * SIZE });
      const context = canvas.getContext("2d");
      context.fillStyle = theme.paint(symbol);
      context.fillRect(0, 0, 2 * SIZE, 2 * SIZE);
      node.replaceChildren(canvas);
      continue;
    }
    node.style.background = symbol === MIXED
      ? `repeating-linear-gradient(135deg, ${theme.stripe} 0 2px, ${theme.mixed} 2px 6px)`
      : symbol === NONE ? theme.none : theme.color(symbol);
  }
}
