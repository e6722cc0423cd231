import { DEFAULT, MIXED, NONE } from "./lookup.js";
import { pixel } from "./theme.js";

/** Share of a pixel's colour that is left where a cell ends. */
const OUTLINE = { light: 0.76, dark: 0.68 };
/** Pictures with more outline than this share of their pixels have none: their cells are too small. */
const CROWDED = 0.5;

/**
 * Return the pixels of a view as ImageData, with the symbols and, if wanted, the outlines of cells.
 */
export function picture(lookup, view, theme, width, height) {
  const wanted = view.raster(width, height), rows = wanted.height;
  const symbols = lookup.raster(wanted);
  const image = new ImageData(width, height);
  const pixels = new Uint32Array(image.data.buffer);
  const colors = Uint32Array.from(theme.symbols, pixel);
  const others = { [DEFAULT]: pixel(theme.fallback), [NONE]: pixel(theme.none) };
  const [plain, stripe] = [pixel(theme.mixed), pixel(theme.stripe)];
  for (let row = 0, k = 0; row < rows; row++) {
    for (let column = 0; column < width; column++, k++) {
      const symbol = symbols[k];
      if (symbol >= 0) pixels[k] = colors[symbol];
      else if (symbol === MIXED) pixels[k] = (row + column) % 9 < 1.5 ? stripe : plain;
      else pixels[k] = others[symbol];
    }
  }
  if (view.outlines) outline(pixels, lookup.places(wanted), width, rows, OUTLINE[theme.mode]);
  for (let row = rows; row < height; row++) pixels.copyWithin(row * width, 0, width);
  return image;
}

function outline(pixels, places, width, rows, share) {
  const edge = new Uint8Array(pixels.length);
  let found = 0;
  for (let row = 0, k = 0; row < rows; row++) {
    for (let column = 0; column < width; column++, k++) {
      const place = places[k];
      if ((column && places[k - 1] !== place) || (row && places[k - width] !== place)) {
        edge[k] = 1;
        found += 1;
      }
    }
  }
  if (found > CROWDED * width * rows) return;
  for (let k = 0; k < width * rows; k++) {
    if (!edge[k]) continue;
    const color = pixels[k];
    const [red, green, blue] = [color & 255, (color >> 8) & 255, (color >> 16) & 255];
    pixels[k] = ((255 << 24) | ((blue * share) << 16) | ((green * share) << 8) | (red * share)) >>> 0;
  }
}
