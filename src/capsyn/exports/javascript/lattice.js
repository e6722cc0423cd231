/** Return the lattice step of a finite number on an axis; beyond its bounds the nearest. */
export function latticeStep(x, low, high, periodic, count) {
  const width = high - low;
  if (periodic && !(x >= low && x < high)) {
    let rest = (x - low) % width;
    if (rest < 0) rest += width;
    rest += low;
    x = rest >= high ? low : rest;
  }
  x = Math.min(Math.max(x, low), high);
  let k = Math.floor(Math.min((x - low) * (count / width), count - 1));
  if (x < low + width * (k / count)) k -= 1;
  if (k + 1 < count && x >= low + width * ((k + 1) / count)) k += 1;
  return k;
}
