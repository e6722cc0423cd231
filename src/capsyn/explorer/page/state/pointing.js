/**
 * @typedef {object} Pointed  What is at the state that is pointed at.
 * @property {number[]} state  (n) [state units]
 * @property {?object} cell  see `cell` of `makeLookup`; it has gone round as often as the state
 * @property {number} symbol
 * @property {number} status
 */

/** Point at a state, or at none. */
export function point(app, state) {
  app.pointed = state ? read(app, state) : null;
  app.parts.readout.draw();
  app.soon("sweep", () => app.parts.map.sweep());
}

/** Read the place that is pointed at again: the plane or the other states have changed. */
export function reread(app) {
  const { view, pointed, parts } = app;
  if (pointed) app.pointed = read(app, view.state(...view.place(pointed.state)));
  parts.readout.draw();
}

function read({ lookup, view }, state) {
  const cell = lookup.cell(state);
  if (cell && cell.lower) {
    const turned = (edge, i) => edge + state[i] - view.wrapped(state[i], i);
    Object.assign(cell, { lower: cell.lower.map(turned), upper: cell.upper.map(turned) });
  }
  return { state, cell, ...lookup.symbol(state) };
}
