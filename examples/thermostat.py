"""Show how horizon and default decide where the temperature of a heated room settles.

The heater is on or off. sSAC predicts with the default control alone, and adds one symbol for a
moment. A long prediction without heat looks cold even above the goal, so the policy heats too long.
A default that holds the goal removes this error. A short horizon removes it as well.
"""

import capsyn


def thermostat(default, horizon):
    """Return the problem of holding 21 degrees in a room while it is 15 degrees outside."""
    return capsyn.Problem(
        name="thermostat",
        dynamics=lambda x, u: [-0.1 * (x[0] - 15) + u[0]],
        domain=capsyn.Box([10.0], [30.0], names=["temperature"], units=["degC"]),
        alphabet=capsyn.Alphabet([0.0, 1.0], names=["off", "on"], inputs=["heat"]),
        default=default,
        horizon=horizon,
        running_cost=lambda x: (x[0] - 21) ** 2,
        max_level=8,
    )


def settled(policy):
    """Return the mean temperature over the last 10 of 200 s."""
    run = capsyn.simulate(policy, [18.0], duration=200.0, rate=100.0)
    return run.states[-1000:, 0].mean()


if __name__ == "__main__":
    for default, horizon in ((0.0, 5.0), (0.0, 0.5), (0.6, 5.0)):
        policy = capsyn.synthesize(thermostat(default, horizon))
        print(f"default {default}, horizon {horizon} s: {settled(policy):.2f} degC")
