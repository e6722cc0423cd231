import { regionPaths } from "./region.js";

/** Return where a target is in the plane, see `regionPaths`; null without one, or a plane. */
export function targetPaths({ data, model, view }, frame, pixels) {
  if (!model || !data.target || view.n === 1) return null;
  const answer = new Float64Array(1);
  return regionPaths(view, frame, pixels, state => {
    model.inside(state, answer);
    return answer[0] !== 0;
  });
}
