import { Domain } from "../../policy/domain.js";
import { makeRanks } from "../../policy/features.js";
import { raster } from "../../policy/raster.js";
import { DEFAULT, INSIDE, MIXED, NONE, OUTSIDE } from "../../policy/symbols.js";
import { cellsOfRows } from "./rows.js";

/** Pixels of a symbol's stripe where several may follow. */
const STRIPE = 4;

/**
 * Return the lookup of a policy that remembers. It is as the other `makeLookup` says, but for
 *
 * shown: the symbol in force for which the others answer, DEFAULT before the first decision, to be
 * set by whoever likes. While it is null, for any, a raster has in turn, in stripes, what follows
 * the labels that may be in force, and the others answer for DEFAULT.
 *
 * symbol(x, outside, now): what follows `now`, DEFAULT or NONE before the first decision.
 *
 * cell(x): has a `row`, too: what follows each symbol, and DEFAULT last; and tells whether it is
 * `mixed`: several rows were seen in it, or vary in it.
 *
 * remembers: whether the symbol in force matters anywhere.
 */
export function makeLookup(data, features = null) {
  const domain = new Domain(data.domain, data.counts), last = data.controls.length - 1;
  const cells = cellsOfRows(data, domain.n, makeRanks(data.features, features));
  const symbolOf = label => (label === last ? DEFAULT : label);
  const blends = makeBlends(cells, data.memory.in_force, symbolOf);
  const next = (place, z, now = lookup.shown ?? DEFAULT) =>
    symbolOf(cells.label(place, z, now < 0 ? last : now));

  function symbol(x, outside = data.outside, now = undefined) {
    const status = domain.status(x);
    if (status === INSIDE || (status === OUTSIDE && outside === "nearest")) {
      const z = domain.steps(x);
      return { symbol: next(cells.find(z), z, now), status };
    }
    return { symbol: typeof outside === "number" ? outside : NONE, status };
  }

  function cell(x) {
    if (domain.status(x) !== INSIDE) return null;
    const z = domain.steps(x), { place, level, low, high } = cells.cell(z, data.counts);
    return {
      leaf: place,
      level,
      lower: low && low.map((k, i) => domain.face(i, k)),
      upper: high && high.map((k, i) => domain.face(i, k)),
      symbol: next(place, z),
      allowed: cells.allowed(place).map(symbolOf),
      row: cells.row(place, z).map(symbolOf),
      mixed: cells.isMixed(place),
    };
  }

  function pixels(plane) {
    const answer = lookup.shown === null ? blends.code : next;
    const value = (place, whole, z) => (whole ? answer(place, z) : MIXED);
    const seen = raster(domain, cells, plane, Int16Array, value);
    return lookup.shown === null ? blends.woven(seen, plane.width) : seen;
  }

  const lookup = {
    n: domain.n,
    levels: cells.levels,
    remembers: cells.remembers,
    shown: cells.remembers ? null : DEFAULT,
    symbol,
    cell,
    raster: pixels,
    places: plane => raster(domain, cells, plane, Int32Array, place => place),
  };
  return lookup;
}

/**
 * Return what shows all that may follow: {code, woven}. `code(place, z)` is the symbol that follows
 * all labels `inForce`, else a number beyond MIXED of those that follow some; `woven` puts these in
 * the place of such numbers, in stripes.
 */
function makeBlends(cells, inForce, symbolOf) {
  const lists = [], codes = new Map(), known = new Map();

  function code(place, z) {
    if (known.has(place)) return known.get(place);
    const row = cells.row(place, z), following = new Set(inForce.map(label => row[label]));
    const list = [...following].sort((a, b) => a - b), key = list.join();
    if (!codes.has(key)) {
      codes.set(key, list.length > 1 ? MIXED - lists.push(list.map(symbolOf)) : symbolOf(list[0]));
    }
    if (cells.constant(place)) known.set(place, codes.get(key));
    return codes.get(key);
  }

  function woven(pixels, width) {
    pixels.forEach((value, k) => {
      if (value >= MIXED) return;
      const list = lists[MIXED - 1 - value], row = Math.floor(k / width);
      pixels[k] = list[Math.floor((row + k % width) / STRIPE) % list.length];
    });
    return pixels;
  }

  return { code, woven };
}
