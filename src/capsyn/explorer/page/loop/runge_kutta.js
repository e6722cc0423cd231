/**
 * Return a function that moves a state (n) and its cost (1) on under a control, for a duration
 * [time unit], by so many steps of the classical Runge-Kutta method.
 */
export function makeAdvance(model, n) {
  const [k1, k2, k3, k4, y] = Array.from({ length: 5 }, () => new Float64Array(n));
  const [c1, c2, c3, c4] = Array.from({ length: 4 }, () => new Float64Array(1));

  function along(x, factor, h, k) {
    for (let i = 0; i < n; i++) y[i] = x[i] + factor * h * k[i];
  }

  return (x, cost, u, duration, steps) => {
    const h = duration / steps;
    for (let s = 0; s < steps; s++) {
      model.dynamics(x, u, k1);
      model.runningCost(x, c1);
      along(x, 0.5, h, k1);
      model.dynamics(y, u, k2);
      model.runningCost(y, c2);
      along(x, 0.5, h, k2);
      model.dynamics(y, u, k3);
      model.runningCost(y, c3);
      along(x, 1, h, k3);
      model.dynamics(y, u, k4);
      model.runningCost(y, c4);
      for (let i = 0; i < n; i++) x[i] += (h / 6) * (k1[i] + 2 * k2[i] + 2 * k3[i] + k4[i]);
      cost[0] += (h / 6) * (c1[0] + 2 * c2[0] + 2 * c3[0] + c4[0]);
    }
  };
}
