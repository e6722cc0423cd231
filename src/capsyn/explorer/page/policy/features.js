/**
 * Return what gives the ranks of features at lattice steps: how many of its thresholds each
 * reaches. `described` is of `policy_data`, null without features; `program(z, values)` is what
 * `features_javascript` makes.
 */
export function makeRanks(described, program) {
  if (!described) return { count: 0, at: () => [] };
  const { thresholds } = described, values = new Float64Array(thresholds.length);
  return {
    count: thresholds.length,
    at(z) {
      program(z, values);
      return thresholds.map((row, k) => row.filter(threshold => values[k] >= threshold).length);
    },
  };
}
