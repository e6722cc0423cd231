import { readable } from "./colors.js";
import { shape } from "./elements.js";

/**
 * Return the marks of symbols, over their colours: {dots, ink, pattern, node}. `looks` and `tiles`
 * are those of `page_data`; `colors` the colours of symbols as they are shown.
 *
 * dots(symbol): {tile, size}, whether there is a dot in each place of a square, row by row; null for
 * a symbol without marks. ink(symbol): their colour. pattern(symbol): what a canvas fills with.
 * node(symbol, scale): an SVG pattern, whose id is `marks-` and the symbol.
 */
export function makeMarks(looks, { values, shape: [, size] }, colors) {
  const area = size * size, patterns = new Map();
  const dots = symbol => {
    const kind = looks[symbol]?.[1] ?? 0;
    return kind ? { tile: values.subarray(kind * area, (kind + 1) * area), size } : null;
  };
  const ink = symbol => readable(colors[symbol]);
  /** Call `put(column, row)` at each dot. */
  const each = (symbol, put) => dots(symbol).tile.forEach((dot, k) => {
    if (dot) put(k % size, Math.floor(k / size));
  });

  function pattern(symbol) {
    if (!patterns.has(symbol)) {
      const canvas = new OffscreenCanvas(size, size), context = canvas.getContext("2d");
      context.fillStyle = colors[symbol];
      context.fillRect(0, 0, size, size);
      context.fillStyle = ink(symbol);
      each(symbol, (column, row) => context.fillRect(column, row, 1, 1));
      patterns.set(symbol, context.createPattern(canvas, "repeat"));
    }
    return patterns.get(symbol);
  }

  function node(symbol, scale) {
    let d = "";
    each(symbol, (column, row) => (d += `M${column} ${row}h1v1h-1z`));
    return shape("pattern", { id: `marks-${symbol}`, width: size, height: size,
      patternUnits: "userSpaceOnUse", patternTransform: `scale(${scale})` },
    shape("rect", { width: size, height: size, fill: colors[symbol] }),
    shape("path", { d, fill: ink(symbol) }));
  }

  return { dots, ink, pattern, node };
}
