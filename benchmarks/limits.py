"""Limits that are kept by construction: a boost converter whose current must not pass 4.5 A."""

import dataclasses
import json
import statistics
import time

import numpy as np

import capsyn
from capsyn import problems
from capsyn.problems import boost_converter

LIMIT, PERIOD = 4.5, 1e-5
TRIALS, CHUNK, SAMPLES, PARTS = 1_000_000, 100_000, 200, 4
CELLS = (None, 600, 720)
rows = []


def row(what, value, unit="", wanted=""):
    value = value if isinstance(value, int) else float(value)
    rows.append({"what": what, "value": value, "unit": unit, "wanted": wanted})


def exact_steps(duration):
    """Return (M, c) of both modes: states x become ``M x + c`` in a time, by scaled squaring."""
    steps = []
    for u in (0.0, 1.0):
        at = np.array(boost_converter.dynamics(np.zeros(2), [u]))
        columns = [np.array(boost_converter.dynamics(e, [u])) - at for e in np.eye(2)]
        flow = np.zeros((3, 3))
        flow[:2, :2], flow[:2, 2] = np.stack(columns, axis=1), at
        whole, term = np.eye(3), np.eye(3)
        for k in range(1, 20):
            term = term @ flow * (duration / k)
            whole = whole + term
        steps.append((whole[:2, :2], whole[:2, 2]))
    return steps


def peaks(policy, states):
    """Return the largest current (B,) of loops from states (B, 2), and whether they stay kept."""
    steps, x = exact_steps(PERIOD / PARTS), states.T.copy()
    most = x[0].copy()
    for _ in range(SAMPLES):
        on = policy(x.T) == 1
        for _ in range(PARTS):
            off, up = (m @ x + c[:, None] for m, c in steps)
            x = np.where(on, up, off)
            most = np.maximum(most, x[0])
    return most, policy.keeps_limits(x.T)


def starts(policy, count, seed):
    """Return random states from which limits are kept."""
    found = []
    while sum(map(len, found)) < count:
        states = policy.domain.sample(count, (seed, len(found)))
        found.append(states[policy.keeps_limits(states)])
    return np.concatenate(found)[:count]


def seconds(make):
    """Return the median time of three calls, after one."""
    make()
    times = []
    for _ in range(3):
        began = time.perf_counter()
        made = make()
        times.append(time.perf_counter() - began)
    return statistics.median(times), made


if __name__ == "__main__":
    problem = problems.get("boost-converter")
    problem = problem.replace(
        limits=lambda x: [x[0] - LIMIT],
        settings=dataclasses.replace(problem.settings, sample_time=PERIOD),
    )
    plain = capsyn.synthesize(problem)
    for cells in CELLS:
        asked = capsyn.KeepLimits(cells=cells)
        took, policy = seconds(lambda asked=asked: capsyn.synthesize(problem, keep_limits=asked))
        figures = policy.statistics["limits"]
        what = "boost converter, at most 4.5 A at 100 kHz, " + " x ".join(
            map(str, figures["cells"])
        )
        what += " cells"
        row(f"{what}: share of the domain", 100 * figures["of_domain"], "%", ">= 29")
        row(f"{what}: share of where the limit holds", 100 * figures["share"], "%")
        row(f"{what}: synthesis", took, "s", "" if cells else "<= 2")
        row(f"{what}: nodes of its exact tree", capsyn.compress(policy).node_count)
        if cells is not None:
            continue
        parts = [starts(policy, CHUNK, seed) for seed in range(TRIALS // CHUNK)]
        found = [peaks(policy, part) for part in parts]
        most, stay = (np.concatenate(values) for values in zip(*found))
        row(f"{what}: {TRIALS:,} trials that break it", int((most > LIMIT).sum()), "", "<= 0")
        row(f"{what}: {TRIALS:,} trials that leave the set", int((~stay).sum()), "", "<= 0")
        row(f"{what}: largest current", most.max(), "A", "<= 4.5")
        some = parts[0][:2000]
        costs = {}
        for name, each in (("plain", plain), ("kept", policy)):
            run = capsyn.simulate(each, some, 20e-3, rate=1 / PERIOD)
            costs[name] = run.costs[:, -1].mean()
            broken = (run.states[..., 0] > LIMIT).any(axis=1).mean()
            row(f"{what}: loops of the {name} policy that break it", 100 * broken, "%")
        row(f"{what}: cost over the plain policy's", costs["kept"] / costs["plain"], "", "<= 1.02")
    ranges = {"load": (16.0, 24.0)}
    asked = capsyn.KeepLimits(
        model=lambda x, u, p: [
            (boost_converter.SUPPLY - (1 - u[0]) * x[1]) / boost_converter.INDUCTANCE,
            ((1 - u[0]) * x[0] - x[1] / p[0]) / boost_converter.CAPACITANCE,
        ],
        parameters=ranges,
    )
    took, policy = seconds(lambda: capsyn.synthesize(problem, keep_limits=asked))
    what = "boost converter, load known to +-20 %"
    row(f"{what}: share of the domain", 100 * policy.statistics["limits"]["of_domain"], "%")
    row(f"{what}: synthesis", took, "s", "<= 2")
    print(json.dumps(rows))
