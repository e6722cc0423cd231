"""Follow a reference that ramps: a camera on a rail follows a part on a conveyor belt.

A controller that is not told the speed of the belt believes that the part stands still. It brakes
as the camera comes near, and the camera trails behind. Here a sensor measures the speed of the
belt, so the speed is an exogenous input. The default control is a law: the drive that keeps this
speed. The prediction is therefore right when the camera follows the part.
"""

import capsyn

DRIVE, DRAG = 2.0, 1.0  # m/s^2, 1/s: at full drive the camera runs at 2 m/s


def dynamics(x, u, w):
    """Return the rates of the camera's distance ahead of the part and of its speed."""
    return [x[1] - w[0], DRIVE * u[0] - DRAG * x[1]]


problem = capsyn.Problem(
    name="ramp",
    dynamics=dynamics,
    domain=capsyn.Box([-2, -2], [2, 2], names=["ahead", "speed"], units=["m", "m/s"]),
    exogenous=capsyn.Box([-1], [1], names=["belt"], units=["m/s"]),
    alphabet=capsyn.Alphabet([-1, 0, 1], names=["back", "coast", "forth"], inputs=["drive"]),
    default=lambda x, w: w[0] * DRAG / DRIVE,
    horizon=2.0,
    running_cost=lambda x, w: x[0] ** 2 + 0.2 * (x[1] - w[0]) ** 2,
    settings=capsyn.SsacSettings(rule="steepest", sample_time=0.02),
    switching=capsyn.Switching(price="3%"),
    outside="nearest",
)


def report(what, run):
    """Print how closely the camera followed the part."""
    found = capsyn.tracking(run, "ahead", 0.0, band=0.05)
    time = found.settling
    settled = f"within 0.05 m after {time:.1f} s" if time >= 0 else "never within 0.05 m"
    print(f"{what}: offset {found.bias:+.3f} m, rms {found.rms:.3f} m, {settled}")


if __name__ == "__main__":
    policy = capsyn.synthesize(problem, leaves="affine", max_level=2)
    start = [-1, 0]  # at rest, 1 m behind the part
    for belt in (0.0, 0.5, -0.8):
        told = capsyn.simulate(policy, start, duration=20, exogenous=[belt])
        report(f"belt {belt:+.1f} m/s, told", told)
        plant = {"model": lambda x, u, belt=belt: dynamics(x, u, [belt])}
        untold = capsyn.simulate(policy.at([0]), start, duration=20, **plant)
        report(f"belt {belt:+.1f} m/s, not told", untold)
    steps = {"belt": {0: 0.5, 10: -0.5}}  # after 10 s the belt runs the other way
    report("belt that turns back, told", capsyn.simulate(policy, start, 20, exogenous=steps))
