import { regionPaths } from "./region.js";

/** Points along each axis of the slice at which costs are compared. */
const POINTS = 100;
/** The share of the slice with the least cost. */
const LEAST = 0.02;

/**
 * Return where in the plane the running cost is least, see `regionPaths`: the share `LEAST` of the
 * slice, whatever part of it is seen. It is null without a model, and where no exogenous input
 * could move it.
 */
export function goalPaths({ model, view }, frame, pixels) {
  if (!model || view.states === view.n) return null;
  const answer = new Float64Array(1), state = Float64Array.from(view.fixed), [i, j] = view.axes;
  const cost = at => {
    model.runningCost(at, answer);
    return answer[0];
  };
  const place = (axis, k) => view.lower[axis] + ((k + 0.5) / POINTS) * view.width(axis);
  const costs = Float64Array.from({ length: POINTS ** 2 }, (_, k) => {
    state[i] = place(i, k % POINTS);
    state[j] = place(j, Math.floor(k / POINTS));
    return cost(state);
  }).sort();
  const most = costs[Math.round(LEAST * costs.length)];
  return regionPaths(view, frame, pixels, at => cost(at) <= most);
}
