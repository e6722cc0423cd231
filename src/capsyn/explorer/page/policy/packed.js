const ARRAYS = {
  int8: Int8Array, uint8: Uint8Array, int16: Int16Array, uint16: Uint16Array,
  int32: Int32Array, uint32: Uint32Array, float64: Float64Array,
};

/** Return the data that `pack` in Python made a text of; arrays have their `values`, row by row. */
export async function unpacked(text) {
  const packed = new Blob([bytesOf(text)]).stream().pipeThrough(new DecompressionStream("deflate"));
  const buffer = await new Response(packed).arrayBuffer();
  const start = 4 + new DataView(buffer).getUint32(0, true);
  const json = new TextDecoder().decode(new Uint8Array(buffer, 4, start - 4));
  return JSON.parse(json, (_, value) => {
    if (value?.dtype !== undefined) value.values = valuesOf(value, buffer, start);
    return value;
  });
}

function valuesOf({ dtype, shape, from, delta }, buffer, start) {
  const values = new ARRAYS[dtype](shape.reduce((a, b) => a * b, 1));
  const count = values.length, size = values.BYTES_PER_ELEMENT;
  const bytes = new Uint8Array(buffer, start + from, count * size);
  const places = new Uint8Array(values.buffer);
  for (let k = 0, at = 0; k < size; k++) {
    for (let i = k; i < places.length; i += size) places[i] = bytes[at++];
  }
  if (delta) for (let i = 1; i < count; i++) values[i] += values[i - 1];
  const [rows] = shape, columns = shape.slice(1).reduce((a, b) => a * b, 1);
  if (columns === 1) return values;
  return values.map((_, k) => values[(k % columns) * rows + Math.floor(k / columns)]);
}

/** Return the typed array of what `pack` was given as one, row by row. */
export const unpack = ({ values }) => values;

/** Return rows of values in their order, of those that stand symbol by symbol. */
export function regrouped(values, symbols) {
  const width = values.length / symbols.length, sorted = new values.constructor(values.length);
  const next = [];
  for (const symbol of symbols) next[symbol + 1] = (next[symbol + 1] ?? 0) + 1;
  next[0] = 0;
  for (let symbol = 1; symbol < next.length; symbol++) {
    next[symbol] = (next[symbol] ?? 0) + next[symbol - 1];
  }
  symbols.forEach((symbol, row) => {
    const from = width * next[symbol]++;
    for (let i = 0; i < width; i++) sorted[row * width + i] = values[from + i];
  });
  return sorted;
}

function bytesOf(base64) {
  const text = atob(base64), bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  return bytes;
}

/** Return the `count` values below 8 whose runs, length * 8 + value, are a text of `run_lengths`. */
export function unpackRuns(base64, count) {
  const values = new Uint8Array(count);
  let at = 0, code = 0, place = 1;
  for (const byte of bytesOf(base64)) {
    code += (byte & 127) * place;
    place *= 128;
    if (byte > 127) continue;
    const end = at + Math.floor(code / 8);
    values.fill(code % 8, at, end);
    [at, code, place] = [end, 0, 1];
  }
  return values;
}
