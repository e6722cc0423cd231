import { latticeStep } from "../../../exports/javascript/lattice.js";
import { INSIDE, NOT_FINITE, OUTSIDE } from "./symbols.js";

/** The box of the states, and the lattice that the faces of its cells are on. */
export class Domain {
  /** `domain` has lower, upper, periodic; `counts` are the steps of the lattice along each axis. */
  constructor({ lower, upper, periodic }, counts) {
    Object.assign(this, { n: lower.length, lower, upper, periodic, counts });
  }

  /** Whether a component is within its bounds; one that goes round always is. */
  holds(i, x) {
    return this.periodic[i] || (x >= this.lower[i] && x <= this.upper[i]);
  }

  /** The coordinate of step k of an axis. */
  face(i, k) {
    const { lower, upper, counts } = this;
    return k >= counts[i] ? upper[i] : lower[i] + (upper[i] - lower[i]) * (k / counts[i]);
  }

  step(i, x) {
    return latticeStep(x, this.lower[i], this.upper[i], this.periodic[i], this.counts[i]);
  }

  steps(x) {
    const z = new Array(this.n);
    for (let i = 0; i < this.n; i++) z[i] = this.step(i, x[i]);
    return z;
  }

  /** INSIDE, OUTSIDE or NOT_FINITE. */
  status(x) {
    let status = INSIDE;
    for (let i = 0; i < this.n; i++) {
      if (!Number.isFinite(x[i])) return NOT_FINITE;
      if (!this.holds(i, x[i])) status = OUTSIDE;
    }
    return status;
  }
}
