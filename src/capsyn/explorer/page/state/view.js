/** How far a view may reach beyond the bounds of an axis that is not periodic, in its widths. */
const BEYOND = 0.25;
/** Least cells of the finest grid that a view shows along an axis. */
const FEWEST = 3;

/**
 * The view of a policy's plane: which axes, the part of them that is seen, the values of the other
 * states and of all exogenous inputs, the level of Algorithm 1, whether cells are outlined, whether
 * what is proved is shown, and the only symbol that is not faded (null: none is). Of the n axes the first are the `states`, the
 * others exogenous inputs.
 */
export class View {
  /** `data` is that of `page_data`, `levels` how many there are. */
  constructor({ domain, counts, exogenous }, levels) {
    const { lower, upper, periodic } = domain, n = lower.length;
    Object.assign(this, { n, lower, upper, periodic, counts, levels });
    this.states = n - (exogenous ? exogenous.names.length : 0);
    this.axes = n > 1 ? [0, 1] : [0, 0];
    this.fixed = lower.map((low, i) => (low + upper[i]) / 2);
    this.level = levels;
    this.outlines = true;
    this.proved = false;
    this.only = null;
    this.reset();
  }

  width(axis) {
    return this.upper[axis] - this.lower[axis];
  }

  reset() {
    this.bounds = this.axes.flatMap(axis => [this.lower[axis], this.upper[axis]]);
  }

  /** Show a part of the plane, moved and resized to what may be seen; periodic axes go round. */
  show(bounds) {
    const { lower, upper, periodic, counts } = this;
    this.bounds = this.axes.flatMap((axis, k) => {
      const width = this.width(axis), beyond = periodic[axis] ? 0 : BEYOND * width;
      const all = width + 2 * beyond, few = (FEWEST * width) / counts[axis];
      const [from, to] = bounds.slice(2 * k, 2 * k + 2);
      const size = Math.min(Math.max(to - from, Math.min(few, all)), all);
      const least = lower[axis] - beyond, most = upper[axis] + beyond - size;
      const low = periodic[axis] ? this.wrapped((from + to) / 2, axis) - size / 2
        : Math.min(Math.max((from + to - size) / 2, least), most);
      return [low, low + size];
    });
  }

  /** Zoom by a factor about a state, which stays where it is. */
  zoom(factor, state) {
    this.show(this.bounds.map((edge, k) => {
      const about = state[this.axes[k >> 1]];
      return about + (edge - about) * factor;
    }));
  }

  /** Move from some bounds by shares of what is seen in them. */
  move([across, up], [x0, x1, y0, y1] = this.bounds) {
    const [dx, dy] = [across * (x1 - x0), up * (y1 - y0)];
    this.show([x0 + dx, x1 + dx, y0 + dy, y1 + dy]);
  }

  /** Put a state on one side of the plane; the other side's state goes to the first's place. */
  choose(side, axis) {
    if (this.n === 1) return;
    const axes = [...this.axes];
    if (axes[1 - side] === axis) axes[1 - side] = axes[side];
    axes[side] = axis;
    this.axes = axes;
    this.reset();
  }

  /** Return the state at shares of the plane, from the left and from the bottom. */
  state(across, up) {
    const [x0, x1, y0, y1] = this.bounds, state = Array.from(this.fixed);
    if (this.n > 1) state[this.axes[1]] = y0 + up * (y1 - y0);
    state[this.axes[0]] = x0 + across * (x1 - x0);
    return state;
  }

  /** Return a state with the exogenous inputs as they are set. */
  told(state) {
    return Array.from(state, (value, axis) => (axis < this.states ? value : this.fixed[axis]));
  }

  /** Set the exogenous inputs to those of a reading, and the states to another's unless null. */
  follow(reading, state) {
    this.fixed = this.fixed.map((value, axis) =>
      (axis >= this.states ? reading[axis] : state ? this.held(state[axis], axis) : value));
  }

  /** Return a periodic component within its bounds. */
  wrapped(value, axis) {
    if (!this.periodic[axis]) return value;
    const turns = Math.floor((value - this.lower[axis]) / this.width(axis));
    return value - turns * this.width(axis);
  }

  /** Return a component within its bounds: the nearest where it does not go round. */
  held(value, axis) {
    return this.periodic[axis] ? this.wrapped(value, axis)
      : Math.min(Math.max(value, this.lower[axis]), this.upper[axis]);
  }

  side(side) {
    return this.bounds.slice(2 * side, 2 * side + 2);
  }

  /** The period of a side of the plane in its shares; infinite where there is none. */
  period(side) {
    const axis = this.axes[side], [low, high] = this.side(side);
    return this.periodic[axis] ? this.width(axis) / (high - low) : Infinity;
  }

  /** Return the share of a side of the plane where a component is; one that goes round, in it. */
  share(state, side) {
    const [low, high] = this.side(side), at = (state[this.axes[side]] - low) / (high - low);
    const turn = this.period(side), off = Math.abs(at - 0.5);
    return off <= turn / 2 + 1e-9 ? at : at - turn * Math.floor((at - 0.5) / turn + 0.5);
  }

  /** Return the shares of the plane, from the left and from the bottom, of a state. */
  place(state) {
    return [this.share(state, 0), this.n > 1 ? this.share(state, 1) : 0.5];
  }

  /** Return the shares of the plane of a state that does not go round. */
  unturned(state) {
    return [0, 1].map(side => {
      if (side && this.n === 1) return 0.5;
      const [low, high] = this.side(side);
      return (state[this.axes[side]] - low) / (high - low);
    });
  }

  /** Return what `raster` and `places` of a lookup take, for so many pixels. */
  raster(across, up) {
    const { n, lower, axes, fixed, bounds, level, levels } = this;
    return {
      axes,
      fixed: n > 1 ? fixed : lower,
      bounds: n > 1 ? bounds : [...bounds.slice(0, 2), lower[0], lower[0]],
      width: across,
      height: n > 1 ? up : 1,
      level: level >= levels ? null : level,
    };
  }
}
