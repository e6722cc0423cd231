const ARRAYS = {
  int8: Int8Array, uint8: Uint8Array, int16: Int16Array, uint16: Uint16Array,
  int32: Int32Array, uint32: Uint32Array, float64: Float64Array,
};

/** Return the typed array that `policy_data` packed, little-endian. */
export function unpack({ dtype, base64 }) {
  return new ARRAYS[dtype](bytesOf(base64).buffer);
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
