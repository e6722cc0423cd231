/** How far a view may reach beyond the bounds of an axis that is not periodic, in its widths. */
const BEYOND = 0.25;
/** Least cells of the finest grid that a view shows along an axis. */
const FEWEST = 3;

/**
 * Return the view of a policy's plane: which axes, the part of them that is seen, the values of the
 * other states, the level of Algorithm 1, whether cells are outlined, and the only symbol that is not
 * faded (null: none is).
 */
export function makeView(data, levels) {
  const { lower, upper, periodic } = data.domain, n = lower.length;
  const view = {
    axes: n > 1 ? [0, 1] : [0, 0],
    fixed: lower.map((low, i) => (low + upper[i]) / 2),
    level: levels,
    outlines: true,
    only: null,
  };
  const width = axis => upper[axis] - lower[axis];

  view.reset = () => {
    view.bounds = view.axes.flatMap(axis => [lower[axis], upper[axis]]);
  };

  /** Show a part of the plane, moved and resized to what may be seen; periodic axes go round. */
  view.show = bounds => {
    view.bounds = view.axes.flatMap((axis, k) => {
      const beyond = periodic[axis] ? 0 : BEYOND * width(axis);
      const most = width(axis) + 2 * beyond, least = (FEWEST * width(axis)) / data.counts[axis];
      const [from, to] = bounds.slice(2 * k, 2 * k + 2);
      const size = Math.min(Math.max(to - from, Math.min(least, most)), most);
      const middle = periodic[axis] && view.wrapped((from + to) / 2, axis);
      const low = periodic[axis] ? middle - size / 2
        : Math.min(Math.max((from + to - size) / 2, lower[axis] - beyond), upper[axis] + beyond - size);
      return [low, low + size];
    });
  };

  /** Zoom by a factor about a state, which stays where it is. */
  view.zoom = (factor, state) => {
    view.show(view.bounds.map((edge, k) => {
      const about = state[view.axes[k >> 1]];
      return about + (edge - about) * factor;
    }));
  };

  /** Move by shares of what is seen. */
  view.move = shares => {
    const [x0, x1, y0, y1] = view.bounds;
    const [dx, dy] = [shares[0] * (x1 - x0), shares[1] * (y1 - y0)];
    view.show([x0 + dx, x1 + dx, y0 + dy, y1 + dy]);
  };

  /** Put a state on one side of the plane; the other side's state goes to the first's place. */
  view.choose = (side, axis) => {
    if (n === 1) return;
    const axes = [...view.axes];
    if (axes[1 - side] === axis) axes[1 - side] = axes[side];
    axes[side] = axis;
    view.axes = axes;
    view.reset();
  };

  /** Return the state at shares of the plane, from the left and from the bottom. */
  view.state = (across, up) => {
    const [x0, x1, y0, y1] = view.bounds, state = Array.from(view.fixed);
    if (n > 1) state[view.axes[1]] = y0 + up * (y1 - y0);
    state[view.axes[0]] = x0 + across * (x1 - x0);
    return state;
  };

  /** Return a periodic component within its bounds. */
  view.wrapped = (value, axis) => {
    if (!periodic[axis]) return value;
    const turns = Math.floor((value - lower[axis]) / width(axis));
    return value - turns * width(axis);
  };

  /** Return a component within its bounds: the nearest where it does not go round. */
  view.held = (value, axis) =>
    periodic[axis] ? view.wrapped(value, axis) : Math.min(Math.max(value, lower[axis]), upper[axis]);

  /** The period of a side of the plane in its shares; infinite where there is none. */
  view.period = side => {
    const axis = view.axes[side], [low, high] = view.bounds.slice(2 * side, 2 * side + 2);
    return periodic[axis] ? width(axis) / (high - low) : Infinity;
  };

  function share(state, side) {
    const axis = view.axes[side], [low, high] = view.bounds.slice(2 * side, 2 * side + 2);
    const at = (state[axis] - low) / (high - low), turn = view.period(side);
    const off = Math.abs(at - 0.5);
    return off <= turn / 2 + 1e-9 ? at : at - turn * Math.floor((at - 0.5) / turn + 0.5);
  }

  /** Return the shares of the plane, from the left and from the bottom, of a state. */
  view.place = state => [share(state, 0), n > 1 ? share(state, 1) : 0.5];

  /** Return what `raster` and `places` of a lookup take, for so many pixels. */
  view.raster = (across, up) => ({
    axes: view.axes,
    fixed: n > 1 ? view.fixed : lower,
    bounds: n > 1 ? view.bounds : [...view.bounds.slice(0, 2), lower[0], lower[0]],
    width: across,
    height: n > 1 ? up : 1,
    level: view.level >= levels ? null : view.level,
  });

  view.reset();
  return view;
}
