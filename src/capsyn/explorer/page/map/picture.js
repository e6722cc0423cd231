import { blend, pixel } from "../dom/colors.js";
import { DEFAULT, MIXED, NONE } from "../policy/symbols.js";

/** How much of the paper is mixed into the symbols that are not asked for. */
const FADED = 0.82;

/** Share of a pixel's colour that is left where a cell ends. */
const OUTLINE = { light: 0.76, dark: 0.68 };
/** Pixels of a dot of marks, across and up. */
const DOT = 2;
/** Pictures with more outline than this share of their pixels have none: cells are too small. */
const CROWDED = 0.5;

/**
 * Return the pixels of a view as ImageData, with the symbols and, if wanted, the outlines of cells.
 */
export function picture(lookup, view, theme, width, height) {
  const wanted = view.raster(width, height), rows = wanted.height;
  const symbols = lookup.raster(wanted);
  const image = new ImageData(width, height);
  const pixels = new Uint32Array(image.data.buffer);
  const shown = (color, symbol) =>
    pixel(view.only === null || view.only === symbol ? color : blend(color, theme.paper, FADED));
  const colors = Uint32Array.from(theme.symbols, shown);
  const inkOf = (_, symbol) => shown(theme.marks.ink(symbol), symbol);
  const inks = Uint32Array.from(theme.symbols, inkOf);
  const others = { [DEFAULT]: shown(theme.fallback, DEFAULT), [NONE]: pixel(theme.none) };
  const [plain, stripe] = [pixel(theme.mixed), pixel(theme.stripe)];
  for (let row = 0; row < rows; row++) {
    const end = (row + 1) * width;
    for (let k = row * width; k < end;) {
      const symbol = symbols[k], from = k;
      do k += 1; while (k < end && symbols[k] === symbol);
      const dots = theme.marks.dots(symbol);
      if (dots) {
        mark(pixels.subarray(from, k), [row, from - row * width], dots, [colors[symbol], inks[symbol]]);
      }
      else if (symbol !== MIXED) pixels.fill(symbol >= 0 ? colors[symbol] : others[symbol], from, k);
      else {
        const shift = row * (width - 1);
        for (let p = from; p < k; p++) pixels[p] = (p - shift) % 9 < 2 ? stripe : plain;
      }
    }
  }
  if (view.outlines) outline(pixels, lookup.places(wanted), width, rows, OUTLINE[theme.mode]);
  for (let row = rows; row < height; row++) pixels.copyWithin(row * width, 0, width);
  return image;
}

/** Fill pixels of a row, from a column on, with marks. */
function mark(pixels, [row, column], { tile, size }, [color, ink]) {
  const start = (Math.floor(row / DOT) % size) * size;
  for (let k = 0; k < pixels.length; k++) {
    pixels[k] = tile[start + (Math.floor((column + k) / DOT) % size)] ? ink : color;
  }
}

function outline(pixels, places, width, rows, share) {
  const edge = new Int32Array(Math.floor(CROWDED * width * rows));
  let count = 0;
  for (let row = 0, k = 0; row < rows; row++) {
    for (let column = 0; column < width; column++, k++) {
      const place = places[k];
      if ((column && places[k - 1] !== place) || (row && places[k - width] !== place)) {
        if (count === edge.length) return;
        edge[count++] = k;
      }
    }
  }
  for (let e = 0; e < count; e++) {
    const color = pixels[edge[e]];
    const [red, green, blue] = [color & 255, (color >> 8) & 255, (color >> 16) & 255];
    pixels[edge[e]] =
      ((255 << 24) | ((blue * share) << 16) | ((green * share) << 8) | (red * share)) >>> 0;
  }
}
