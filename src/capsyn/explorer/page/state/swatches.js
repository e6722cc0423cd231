import { element } from "../dom/elements.js";
import { MIXED, NONE } from "../policy/symbols.js";

/** A coloured square of a symbol, filled by the theme. */
export function swatch(symbol) {
  return element("span", { class: "swatch", "data-symbol": symbol });
}

export function paintSwatches(theme) {
  for (const node of document.querySelectorAll(".swatch")) {
    const symbol = Number(node.dataset.symbol);
    node.style.background = symbol === MIXED
      ? `repeating-linear-gradient(135deg, ${theme.stripe} 0 2px, ${theme.mixed} 2px 6px)`
      : symbol === NONE ? theme.none : theme.color(symbol);
  }
}
