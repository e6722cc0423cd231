/** Return an element with attributes, listeners (`onclick`) and children; text is never markup. */
export function element(tag, attributes = {}, ...children) {
  return fill(document.createElement(tag), attributes, children);
}

/** Return an SVG element likewise. */
export function shape(tag, attributes = {}, ...children) {
  return fill(document.createElementNS("http://www.w3.org/2000/svg", tag), attributes, children);
}

function fill(node, attributes, children) {
  for (const [key, value] of Object.entries(attributes)) {
    if (key.startsWith("on")) node.addEventListener(key.slice(2), value);
    else if (value === true) node.setAttribute(key, "");
    else if (value !== false && value !== null && value !== undefined) node.setAttribute(key, value);
  }
  node.append(...children.flat().filter(child => child !== null && child !== undefined));
  return node;
}

/** Return the element of an id. */
export const byId = id => document.getElementById(id);

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
export const counted = (count, one, many = `${one}s`) => `${whole(count)} ${count === 1 ? one : many}`;

const RAISED = { "-": "⁻", 0: "⁰", 1: "¹", 2: "²", 3: "³", 4: "⁴", 5: "⁵", 6: "⁶", 7: "⁷", 8: "⁸", 9: "⁹" };

/** Return a unit with its powers raised. */
export const unitText = unit =>
  unit.replace(/\^(-?\d+)/g, (_, power) => Array.from(power, digit => RAISED[digit]).join(""));

/** Return a name with its unit in brackets. */
export const withUnit = (name, unit) => (unit ? `${name} [${unitText(unit)}]` : name);

/** Return round tick values in [low, high], about `count` of them. */
export function ticks(low, high, count) {
  const raw = (high - low) / Math.max(1, count), power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map(k => k * power).find(k => k >= raw * 0.999);
  const found = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) {
    found.push(Number((k * step).toPrecision(12)));
  }
  return found;
}

/** Return a function that writes ticks, with the digits that tell them apart. */
export function tickText(found) {
  const step = Math.min(...found.slice(1).map((value, k) => Math.abs(value - found[k])));
  const most = Math.max(...found.map(Math.abs));
  const digits = Number.isFinite(step) && step > 0 && most > 0
    ? Math.floor(Math.log10(most)) - Math.floor(Math.log10(step) + 1e-9) + 2 : 4;
  return value => short(value, Math.min(Math.max(digits, 4), 15));
}

/** Give a canvas the pixels of its box on the screen; return its size in CSS pixels and the scale. */
export function fit(canvas) {
  const { clientWidth: width, clientHeight: height } = canvas;
  const scale = Math.min(window.devicePixelRatio || 1, 2);
  const [w, h] = [Math.max(1, Math.round(width * scale)), Math.max(1, Math.round(height * scale))];
  if (canvas.width !== w || canvas.height !== h) {
    canvas.width = w;
    canvas.height = h;
  }
  return { width, height, scale };
}
