/** Symbols beside 0 .. N-1: the default control, none, and a cell that is cut further. */
export const DEFAULT = -1, NONE = -2, MIXED = -3;
/** Statuses of a state: in the domain, outside it, or with a NaN or infinite component. */
export const INSIDE = 0, OUTSIDE = 1, NOT_FINITE = 2;
