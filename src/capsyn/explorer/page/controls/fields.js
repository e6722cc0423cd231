import { element } from "../dom/elements.js";

/** Return a control with its name. */
export function labelled(text, control, ...more) {
  return element("label", {}, element("span", { title: text }, text), control, ...more);
}
