"""What the command line prints of reports and evidence."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from capsyn.cli.console import _line, print_table
from capsyn.verification.sentences import circumstances, evidence_rows, failing_trial, headlines

if TYPE_CHECKING:
    pass


def _print_monte_carlo(data: dict[str, Any], headline: str, again: str | None) -> None:
    conditions = data["conditions"]
    stay = f", and stay there the last {conditions['hold']:g} s" if conditions["hold"] else ""
    _line("monte carlo", headline)
    _line("from", conditions["initial"])
    _line("to", f"{conditions['target']}, within {conditions['within']:g} s{stay}")
    _line("by", f"{conditions['controller']}; {circumstances(conditions)}")
    how = {"time": "ran until the time limit", "target": "arrived"}
    ends = (f"{count:,} {how.get(name, name)}" for name, count in data["ended"].items())
    _line("ended", ", ".join(ends))
    for key, name, unit in (
        ("time_to_target", "time", "s until the target"),
        ("switches_per_second", "switches", "per second"),
        ("cost_left", "cost left", "of the cost J at the start"),
    ):
        if data[key]:
            spread = ", ".join(f"{k} {v:.3g}" for k, v in data[key].items())
            _line(name, f"{spread} {unit}")
    if data["trials_outside_domain"]:
        _line("outside", f"{data['trials_outside_domain']:,} trials left the domain on the way")
    trials, failed = data["failing_trials"], data["trials"] - data["successes"]
    for trial in trials[:5]:
        _line("failed from", failing_trial(trial))
    if failed > 5:
        _line("", f"and {failed - 5:,} more")
    if again is not None:
        anew = ", but for its noise, which is drawn anew" if any(trials[0]["noise"]) else ""
        _line("again", f"the first of them{anew}: {again}")


def print_evidence(found: dict[str, Any], again: str | None = None) -> None:
    """Print what `capsyn verify` found, by kind, and the command that repeats a failing trial."""
    lines = headlines(found)
    if "monte_carlo" in found:
        _print_monte_carlo(found["monte_carlo"], lines["monte carlo"], again)
    if "lyapunov" in found:
        data = found["lyapunov"]
        violated, undecided = data["violated_cell_count"], data["undecided_cell_count"]
        _line("lyapunov", lines["lyapunov"])
        _line("cells", f"{violated:,} with a state where it grows, {undecided:,} more undecided")
        for cell in data["violated_cells"][:3]:
            state = ", ".join(f"{v:g}" for v in cell["state"])
            _line("grows at", f"({state}): {cell['value']:.3g} per second")
        if "grid" in data:
            shares = data["grid"]["shares"].items()
            _line("grid", ", ".join(f"{name} {value:.3%}" for name, value in shares))
    if "agreement" in found:
        cells = found["agreement"]["island_cells"]
        _line("agreement", lines["agreement"])
        _line("islands", f"{cells:,} cells hold something that all their test points missed")


def _print_complexity(data: dict[str, Any], from_cells: bool) -> None:
    """Print what `capsyn.compression.complexity.complexity` returns."""
    table, tree, machine = data["table"], data["tree"], data["automaton"]
    planes = f" and {tree['planes']:,} oblique splits" if tree["planes"] else ""
    mean = tree["mean_comparisons"]
    average = "" if mean is None else f", {mean:.1f} on average"
    if from_cells:
        _line("", f"{table['comparisons']} comparisons at most")
        _line(
            "exact tree",
            f"{tree['nodes']:,} nodes{planes}, {tree['bytes']:,} bytes packed, "
            f"{tree['comparisons']} comparisons at most{average}",
        )
    elif mean is not None:
        _line("", f"{mean:.1f} comparisons on average")
    _line("entropy", f"{data['symbol_entropy']:.3f} bits of the symbols by volume")
    if machine is None:
        return
    _line(
        "automaton",
        f"{machine['regions']} regions in {machine['partitions']:,} connected partitions and "
        f"{machine['boxes']:,} boxes; {machine['edges']} edges",
    )
    if machine["switch_rate"] is not None:
        _line(
            "switches",
            f"{machine['possible_edges']} edges not excluded; {machine['switch_rate']:.3g} per "
            f"second from evenly spread states; sliding on {machine['sliding_share']:.1%} of the "
            f"switching surface; {machine['switching_entropy']:.3f} bits a switch",
        )


def print_automaton(data: dict[str, Any]) -> None:
    """Print what ``Automaton.to_json`` returns."""
    names = {}
    for vertex in data["vertices"]:
        names[vertex["symbol"]] = vertex["name"]
        value = ", ".join(f"{v:g}" for v in vertex["value"])
        _line(
            f"region {vertex['region']}",
            f"{vertex['name']} ({value}): {vertex['volume_share']:.2%} of the volume, "
            f"{vertex['cells']:,} cells in {vertex['partitions']:,} connected partitions and "
            f"{vertex['boxes']:,} boxes",
        )
    pairs = [{key: names[edge[key]] for key in ("source", "target")} for edge in data["edges"]]
    edges = [edge | pair for edge, pair in zip(data["edges"], pairs)]
    for edge in edges:
        for name in ("rate", "sliding_rate"):
            edge[f"{name} [1/s]"] = edge.pop(name)
    print_table(edges)
    found = data["switching"]
    if found is None:
        _line("switches", "not known: the policy has no model")
        return
    _line(
        "switches",
        f"{found['rate']:.3g} per second from evenly spread states, and "
        f"{found['sliding_rate']:.3g} arrivals where the loop slides, on "
        f"{found['sliding_share']:.1%} of the switching surface",
    )
    if found["sliding_faces"]:
        _line("", "the faces with most sliding area:")
    for face in found["sliding_faces"][:5]:
        bounds = (
            f"{name} = {low:g}" if axis == face["axis"] else f"{name} in [{low:g}, {high:g}]"
            for axis, (name, low, high) in enumerate(
                zip(data["states"], face["lower"], face["upper"])
            )
        )
        between = f"{names[face['below']]} below and {names[face['above']]} above"
        _line("slides on", f"{', '.join(bounds)}, with {between}")


def print_compression(tree: dict[str, Any], policy: dict[str, Any]) -> None:
    """Print the reports of a tree and of the policy that it was made from."""
    _print_tree(tree)
    _line("instead of", f"{policy['cells']:,} cells, {policy['packed_bytes']:,} bytes packed")


def _print_tree(data: dict[str, Any]) -> None:
    planes = f", {data['planes']} oblique splits" if data["planes"] else ""
    grid = " x ".join(str(state["steps"]) for state in data["states"])
    _line(
        "tree",
        f"{data['nodes']:,} nodes, {data['depth']} comparisons at most{planes}, on {grid} steps; "
        f"{data['packed_bytes']:,} bytes packed",
    )
    _line("guarantee", data["guarantee"]["text"])


def print_report(data: dict[str, Any]) -> None:
    """Print what `capsyn.policies.report.report` returns."""
    line = _line
    statistics = data["statistics"]
    line("policy", data["name"])
    for state in data["states"]:
        unit = f" {state['unit']}" if state["unit"] else ""
        periodic = ", periodic" if state["periodic"] else ""
        line(
            "state", f"{state['name']} in [{state['lower']:g}, {state['upper']:g}]{unit}{periodic}"
        )
    for symbol in data["symbols"]:
        value = ", ".join(f"{v:g}" for v in symbol["value"])
        line("symbol", f"{symbol['name']} ({value}): {symbol['volume_share']:.2%} of the volume")
    value = ", ".join(f"{v:g}" for v in data["default"]["value"])
    kind = ", in gaps, which are outside" if data["gaps"] else ""
    line("default", f"({value}): {data['default']['volume_share']:.2%} of the volume{kind}")
    if "cells" in data:
        grid = " x ".join(str(state["partitions"]) for state in data["states"])
        mixed = (
            f"{data['mixed_cells']:,} with mixed labels, {data['mixed_share']:.2%} of the volume"
        )
        line(
            "cells",
            f"{data['cells']:,} from a root grid {grid}, max level {data['max_level']}"
            f"{', split along some axes' if data['adaptive'] else ''}; {mixed}",
        )
        if data["affine_leaves"]:
            steps = " x ".join(str(state["steps"]) for state in data["states"])
            line("affine", f"{data['affine_leaves']:,} of the cells, on a lattice of {steps} steps")
        line("table", f"{data['packed_bytes']:,} bytes packed")
    else:
        _print_tree(data)
    if "proof" in data:
        line("proof", f"holds for {data['proof']['policy']}")
    if data.get("complexity"):
        _print_complexity(data["complexity"], "cells" in data)
    if "table" in statistics:
        counts = {name: f"{count:,}" for name, count in statistics["table"].items()}
        line(
            "from",
            f"a table of {counts['points']} points, {counts['outside']} without a symbol and "
            f"{counts['several']} with several",
        )
    if "solves" in statistics:
        named = {
            "vertices": "vertices",
            "centers": "centres",
            "others": "other test points",
            "quarter": "second looks at ties",
        }
        roles = statistics.get("solves_by_role", {})
        parts = ", ".join(f"{roles[k]:,} {name}" for k, name in named.items() if k in roles)
        line("solves", f"{statistics['solves']:,}: {parts}")
        budget = statistics.get("stopped_by")
        if budget or statistics.get("stopped_by_max_solves"):
            line("stopped by", f"{budget or 'max_solves'}, before max_level everywhere")
        for key, name, unit in (
            ("worst_case_solves", "Prop. 2", "solves at worst"),
            ("indifferent_points", "ties", "test points where several symbols tie"),
            ("not_finite_points", "not finite", "test points"),
        ):
            if key in statistics:
                line(name, f"{statistics[key]:,} {unit}")
    sample = statistics.get("sample")
    if sample:
        line(
            "controller",
            f"no descent in {sample['no_descent']:.2%} of the volume, several symbols tie in "
            f"{sample['indifferent']:.2%}, no finite result in {sample['not_finite']:.2%} "
            f"({sample['states']:,} random states)",
        )
    settings = data["settings"]
    if settings:
        wanted = "gamma" if settings["alpha_d"] is None else "alpha_d"
        rule = settings["rule"]
        goal = f", {wanted} {settings[wanted]:g}" if rule == "schedule" else ""
        line(
            "settings",
            f"horizon {data['horizon']} s in {settings['steps']} steps, rule {rule}{goal}, "
            f"control weight {settings['control_weight']}, {settings['precision']} precision",
        )
    if data["target"]:
        line("target", data["target"])
    line("outside", f"{data['outside']}; minimum dwell {data['min_dwell']:g} s")
    for name, sentence in evidence_rows(data["evidence"]):
        line(name, sentence)
    for hint in data["hints"]:
        line("hint", hint)
