"""How long a whole synthesis takes, where the time goes, and what memory it needs."""

import json
import resource
import time

from capsyn import problems, synthesize
from capsyn.controllers.solver import SsacKernel


def measure():
    """Return rows for cart-pole at level 3."""
    problem = problems.plain("cart-pole")
    synthesize(problem, max_level=0)  # builds the kernel
    kernel = {"seconds": 0.0}
    call = SsacKernel.__call__

    def timed(self, *arguments):
        started = time.perf_counter()
        result = call(self, *arguments)
        kernel["seconds"] += time.perf_counter() - started
        return result

    totals, shares = [], []
    for _ in range(5):
        started = time.perf_counter()
        policy = synthesize(problem, max_level=3)
        totals.append(time.perf_counter() - started)
    SsacKernel.__call__ = timed
    for _ in range(5):
        kernel["seconds"] = 0.0
        started = time.perf_counter()
        synthesize(problem, max_level=3, threads=1)
        shares.append(1 - kernel["seconds"] / (time.perf_counter() - started))
    SsacKernel.__call__ = call
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    name = "cart-pole level 3"
    return [
        {
            "what": f"{name}: solves",
            "value": policy.statistics["solves"],
            "unit": "",
            "wanted": "about 354,000",
        },
        {"what": f"{name}: leaf cells", "value": policy.cells.leaf_count, "unit": ""},
        {
            "what": f"{name}: synthesize, all processors",
            "value": sorted(totals)[2],
            "unit": "s",
            "wanted": "<= 3.5",
        },
        {
            "what": f"{name}: peak memory of the process",
            "value": peak,
            "unit": "MB",
            "wanted": "<= 700",
        },
        {
            "what": f"{name}: share of synthesize outside the kernel, 1 thread",
            "value": sorted(shares)[2],
            "unit": "ratio",
            "wanted": "<= 0.35",
        },
    ]


if __name__ == "__main__":
    print(json.dumps(measure()))
