/** Return a function that moves a state (n) and its cost (1) on by one sample of a map. */
export function makeMapStep(model, n) {
  const next = new Float64Array(n), c = new Float64Array(1);

  return (x, cost, u) => {
    model.runningCost(x, c);
    model.dynamics(x, u, next);
    cost[0] += c[0];
    x.set(next);
  };
}
