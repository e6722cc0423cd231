/** Return a number as short text: at most `digits` significant digits, a true minus sign. */
export function short(value, digits = 4) {
  if (value === null || value === undefined || Number.isNaN(value)) return "–";
  if (!Number.isFinite(value)) return value > 0 ? "∞" : "−∞";
  const size = Math.abs(value);
  const text = size !== 0 && (size >= 1e6 || size < 1e-4)
    ? value.toExponential(digits - 1).replace(/\.?0+e/, "e").replace("e+", "e")
    : String(Number(value.toPrecision(digits)));
  return text.replace("-", "−");
}

/** Return a whole number with separators. */
export const whole = value => value.toLocaleString("en-US");

/** Return a number of things in words. */
export const counted = (count, one, many = `${one}s`) =>
  `${whole(count)} ${count === 1 ? one : many}`;

const DIGITS = "-0123456789", RAISED = "⁻⁰¹²³⁴⁵⁶⁷⁸⁹";

/** Return a unit with its powers raised. */
export const unitText = unit =>
  unit.replace(/\^(-?\d+)/g, (_, power) =>
    Array.from(power, digit => RAISED[DIGITS.indexOf(digit)]).join(""));

/** Return a name with its unit in brackets. */
export const withUnit = (name, unit) => (unit ? `${name} [${unitText(unit)}]` : name);

/** Return the unit that a policy counts time in. */
export const timeUnit = data => data.time_unit ?? "s";

/** Return round tick values in [low, high], about `count` of them. */
export function ticks(low, high, count) {
  const raw = (high - low) / Math.max(1, count), power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map(k => k * power).find(k => k >= raw * 0.999);
  const values = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) {
    values.push(Number((k * step).toPrecision(12)));
  }
  return values;
}

/** Return a function that writes ticks, with the digits that tell them apart. */
export function tickText(values) {
  const step = Math.min(...values.slice(1).map((value, k) => Math.abs(value - values[k])));
  const most = Math.max(...values.map(Math.abs));
  const digits = Number.isFinite(step) && step > 0 && most > 0
    ? Math.floor(Math.log10(most)) - Math.floor(Math.log10(step) + 1e-9) + 2 : 4;
  return value => short(value, Math.min(Math.max(digits, 4), 15));
}
