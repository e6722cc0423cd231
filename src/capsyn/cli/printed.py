"""What the command line prints of reports and evidence."""

from __future__ import annotations

from typing import Any

from capsyn.alphabets.judged import brief, chosen_among
from capsyn.cli.console import print_line, print_table
from capsyn.modelling.settings import usual_sample_time
from capsyn.modelling.time_unit import NAMES
from capsyn.verification.sentences import evidence_rows, vector

MOST_NAMED = 8
"""Most symbols of which something is said in one line."""


def print_lyapunov(data: dict[str, Any], headline: str) -> None:
    """Print what a proof about a Lyapunov function found."""
    violated, undecided = data["violated_cell_count"], data["undecided_cell_count"]
    per = NAMES[data.get("time_unit", "s")]
    print_line("lyapunov", headline)
    print_line("cells", f"{violated:,} with a state where it grows, {undecided:,} more undecided")
    for cell in data["violated_cells"][:3]:
        print_line("grows at", f"{vector(cell['state'])}: {cell['value']:.3g} per {per}")
    if "grid" in data:
        shares = data["grid"]["shares"].items()
        print_line("grid", ", ".join(f"{name} {value:.3%}" for name, value in shares))


def print_agreement(data: dict[str, Any], headline: str) -> None:
    """Print how often a policy gives what its controller gives."""
    cells, in_force = data["island_cells"], data.get("in_force", [])
    print_line("agreement", headline)
    worst = sorted(in_force, key=lambda row: row["share"])[:MOST_NAMED]
    if in_force:
        rest = "; the others more" if len(worst) < len(in_force) else ""
        each = "; ".join(f"{row['symbol']} {row['share']:.3%}" for row in worst)
        print_line("in force", each + rest)
    print_line("islands", f"{cells:,} cells hold something that all their test points missed")


def _print_complexity(data: dict[str, Any], from_cells: bool, priced: bool, time_unit: str) -> None:
    """Print what `capsyn.compression.complexity.complexity` returns.

    `priced` is whether affine leaves have prices.
    """
    table, tree, machine = data["table"], data["tree"], data["automaton"]
    mean = tree and tree["mean_comparisons"]
    if from_cells:
        print_line("", f"{table['comparisons']} comparisons at most")
        print_line("exact tree", _exact_tree(tree, priced))
    elif mean is not None:
        print_line("", f"{mean:.1f} comparisons on average")
    if tree is not None and tree["deepest"] is not None:
        place = ", ".join(f"{x:.6g}" for x in tree["deepest"])
        print_line("", f"most comparisons of the tree at ({place})")
    print_line("entropy", f"{data['symbol_entropy']:.3f} bits of the symbols by volume")
    if machine is None:
        return
    print_line(
        "automaton",
        f"{machine['regions']} regions in {machine['partitions']:,} connected partitions and "
        f"{machine['boxes']:,} boxes; {machine['edges']} edges",
    )
    if machine["switch_rate"] is not None:
        print_line(
            "switches",
            f"{machine['possible_edges']} edges not excluded; {machine['switch_rate']:.3g} per "
            f"{NAMES[time_unit]} from evenly spread states; sliding on "
            f"{machine['sliding_share']:.1%} of the switching surface; "
            f"{machine['switching_entropy']:.3f} bits a switch",
        )


def _exact_tree(tree: dict[str, Any] | None, priced: bool) -> str:
    """Return what is told of the exact tree of cells."""
    if tree is None:
        reason = "none, since affine leaves have prices" if priced else "too large"
        return f"{reason}: an export to c and most targets writes the cells"
    planes = f" and {tree['planes']:,} oblique splits" if tree["planes"] else ""
    mean = tree["mean_comparisons"]
    average = "" if mean is None else f", {mean:.1f} on average"
    return (
        f"{tree['nodes']:,} nodes{planes}, {tree['bytes']:,} bytes packed, "
        f"{tree['comparisons']} comparisons at most{average}"
    )


def print_automaton(data: dict[str, Any]) -> None:
    """Print what ``Automaton.to_json`` returns."""
    names, unit = {}, data.get("time_unit", "s")
    stays = " stays" if data.get("remembers") else ""
    for vertex in data["vertices"]:
        names[vertex["symbol"]] = vertex["name"]
        print_line(
            f"region {vertex['region']}",
            f"{vertex['name']} {vector(vertex['value'])}{stays}: {vertex['volume_share']:.2%} of "
            f"the volume, {vertex['cells']:,} cells in {vertex['partitions']:,} connected "
            f"partitions and {vertex['boxes']:,} boxes",
        )
    pairs = [{key: names[edge[key]] for key in ("source", "target")} for edge in data["edges"]]
    edges = [edge | pair for edge, pair in zip(data["edges"], pairs)]
    for edge in edges:
        for name in ("rate", "sliding_rate"):
            edge[f"{name} [1/{unit}]"] = edge.pop(name)
    print_table(edges)
    switching = data["switching"]
    if switching is None:
        print_line("switches", "not known: no model, a map, or inputs with least times")
        return
    print_line(
        "switches",
        f"{switching['rate']:.3g} per {NAMES[unit]} from evenly spread states, and "
        f"{switching['sliding_rate']:.3g} arrivals where the loop slides, on "
        f"{switching['sliding_share']:.1%} of the switching surface",
    )
    if switching["sliding_faces"]:
        print_line("", "the faces with most sliding area:")
    for face in switching["sliding_faces"][:5]:
        bounds = (
            f"{name} = {low:g}" if axis == face["axis"] else f"{name} in [{low:g}, {high:g}]"
            for axis, (name, low, high) in enumerate(
                zip([*data["states"], *data.get("exogenous", ())], face["lower"], face["upper"])
            )
        )
        between = f"{names[face['below']]} below and {names[face['above']]} above"
        print_line("slides on", f"{', '.join(bounds)}, with {between}")


def print_compression(tree: dict[str, Any], policy: dict[str, Any]) -> None:
    """Print the reports of a tree and of the policy that it was made from."""
    _print_tree(tree)
    print_line("instead of", f"{policy['cells']:,} cells, {policy['packed_bytes']:,} bytes packed")


def _print_tree(data: dict[str, Any]) -> None:
    planes = f", {data['planes']} oblique splits" if data["planes"] else ""
    grid = _along_axes(data, "steps")
    print_line(
        "tree",
        f"{data['nodes']:,} nodes, {data['depth']} comparisons at most{planes}, on {grid} steps; "
        f"{data['packed_bytes']:,} bytes packed",
    )
    if data["features"]:
        margin = data["features"]["margin"]
        near = "" if margin is None else f"; at least {margin:.1e} of their span from thresholds"
        print_line(
            "features",
            f"{', '.join(data['features']['names'])}: {data['features']['operations']} "
            f"operations at the centre of a step{near}",
        )
    told = data["guarantee"]
    loop = told.get("loop_text", "")
    print_line("guarantee", told["text"].replace(f"; {loop}", "") if loop else told["text"])
    if loop:
        print_line("loops", loop)
    if lost := told.get("lost"):
        shares = (f"{name} {a:.2%} -> {b:.2%}" for name, (a, b) in lost.items())
        print_line("lost", f"{', '.join(shares)} of the volume")


def print_report(data: dict[str, Any]) -> None:
    """Print what `capsyn.policies.report.report` returns."""
    statistics, unit = data["statistics"], data.get("time_unit", "s")
    print_line("policy", data["name"])
    _print_states_and_symbols(data)
    if "cells" in data:
        _print_cells(data)
    else:
        _print_tree(data)
    if "proof" in data:
        print_line("proof", f"holds for {data['proof']['policy']}")
    if data.get("complexity"):
        priced = bool(data.get("affine_leaves") and data.get("switching", {}).get("price"))
        _print_complexity(data["complexity"], "cells" in data, priced, unit)
    if "table" in statistics:
        _print_table_source(statistics["table"])
    if "source" in data:
        print_line("source", data["source"])
    if "alphabet" in statistics:
        print_alphabet(statistics["alphabet"])
    if "solves" in statistics:
        _print_solves(statistics)
    if statistics.get("sample"):
        _print_sample(statistics["sample"])
    if data["settings"] and data["horizon"] is not None:
        horizon = f"{data['horizon']} {unit} in {data['settings']['steps']} steps"
        if data.get("discrete"):
            time = f"{data['settings']['sample_time']:g} {unit}"
            kind = data["settings"].get("sensitivity", "exact")
            horizon = f"{data['horizon']:g} samples of a discrete-time model, each {time}, {kind}"
        _print_settings(data["settings"], horizon)
    if data["settings"] and not data.get("discrete"):
        print_line("sampled", _sampled(data["settings"]["sample_time"], data["horizon"], unit))
    if data["target"]:
        print_line("target", data["target"])
    rule = data["outside"] + (", at once" if data.get("outside_at_once") else "")
    hold = data.get("switching", {}).get("hold")
    dwell = "" if hold else f"; minimum dwell {data['min_dwell']:g} {unit}"
    print_line("outside", f"{rule}{dwell}")
    _print_memory(data, unit)
    if "limits" in data:
        _print_limits(data["limits"], statistics.get("limits"), unit)
    for name, sentence in evidence_rows(data["evidence"]):
        print_line(name, sentence)
    for hint in data["hints"]:
        print_line("hint", hint)


def _sampled(time: float, horizon: float | None, unit: str) -> str:
    """Return how often closed loops are sampled, in words."""
    usual = horizon is not None and time == usual_sample_time(horizon)
    why = ": about a hundredth of the horizon, as where nothing is said" if usual else ""
    return f"every {time:g} {unit}{why}"


def _and_affine(data: dict[str, Any]) -> str:
    leaves = data.get("affine_leaves", 0)
    return f", as do {leaves:,} affine leaves" if leaves else ""


def _print_memory(data: dict[str, Any], unit: str) -> None:
    """Print how the next symbol depends on the one in force, what changes cost and wait for."""
    if memory := data.get("memory"):
        print_line(
            "memory",
            f"{memory['rows']:,} rows of next symbols, {memory['varying_rows']:,} of which depend "
            f"on the one in force{_and_affine(data)}, which stays only for that on "
            f"{memory['staying_share']:.2%} of the volume; shares of symbols are the mean over "
            "those in force",
        )
    switching = data.get("switching", {})
    names = [symbol["name"] for symbol in data["symbols"]]
    if price := switching.get("price"):
        print_line("price", _price(price, NAMES[unit]))
    if hold := switching.get("hold"):
        times = dict(zip(names, hold)) if isinstance(hold, list) else hold
        each = [f"{k} {time:g}" for k, time in times.items()] if isinstance(times, dict) else []
        print_line("hold", f"{', '.join(each) or f'{hold:g}'} {unit} at least")
    if pairs := switching.get("forbidden"):
        print_line("forbidden", ", ".join(f"{before} to {after}" for before, after in pairs))
    if "delay" in data:
        print_line("delay", f"{data['delay']:g} {unit}, compensated")


def _print_limits(data: dict[str, Any], found: dict[str, Any] | None, unit: str) -> None:
    """Print from where limits are kept, and from where not."""
    known = "".join(
        f", {k} in [{low:g}, {high:g}]" for k, (low, high) in data["parameters"].items()
    )
    of = "" if found is None else f" and {found['share']:.2%} of where they hold"
    print_line(
        "limits",
        f"kept from {data['kept_share']:.2%} of the domain{of}: sampled every "
        f"{data['sample_time']:g} {unit}{known}",
    )
    for key, what in (("from", "from states in"), ("lost", "not from others in")):
        if found is not None and found[key]:
            ranges = (f"{name} [{low:.6g}, {high:.6g}]" for name, (low, high) in found[key].items())
            print_line("", f"{what} {', '.join(ranges)}")


def _price(price: Any, per: str) -> str:
    """Return a price on switching in words."""
    if isinstance(price, dict):
        each = ", ".join(f"{name} {value:.4g}" for name, value in price.items())
        return f"{each} per {per}, for each unit of change"
    if isinstance(price, list):
        values = [value for row in price for value in row if value]
        return f"{min(values, default=0):.4g} to {max(values, default=0):.4g} per {per}, by pair"
    return f"{price:.4g} per {per}, of any switch"


def _print_states_and_symbols(data: dict[str, Any]) -> None:
    for what, axes in (("state", data["states"]), ("exogenous", data.get("exogenous", []))):
        for axis in axes:
            unit = f" {axis['unit']}" if axis["unit"] else ""
            periodic = ", periodic" if axis["periodic"] else ""
            bounds = f"[{axis['lower']:g}, {axis['upper']:g}]"
            print_line(what, f"{axis['name']} in {bounds}{unit}{periodic}")
    for symbol in data["symbols"]:
        value, share = vector(symbol["value"]), symbol["volume_share"]
        print_line("symbol", f"{symbol['name']} {value}: {share:.2%} of the volume")
    kind = ", in gaps, which are outside" if data["gaps"] else ""
    value, share = vector(data["default"]["value"]), data["default"]["volume_share"]
    if data["default"].get("law"):
        value = f"a law, {value} in the middle"
    print_line("default", f"{value}: {share:.2%} of the volume{kind}")


def _along_axes(data: dict[str, Any], key: str) -> str:
    """Return a figure of all states, and of the exogenous inputs after them."""
    return " x ".join(str(axis[key]) for axis in (*data["states"], *data.get("exogenous", ())))


def _print_cells(data: dict[str, Any]) -> None:
    grid = _along_axes(data, "partitions")
    mixed = f"{data['mixed_cells']:,} with mixed labels, {data['mixed_share']:.2%} of the volume"
    along = ", split along some axes" if data["adaptive"] else ""
    print_line(
        "cells",
        f"{data['cells']:,} from a root grid {grid}, max level {data['max_level']}{along}; {mixed}",
    )
    if data["affine_leaves"]:
        steps = _along_axes(data, "steps")
        leaves = f"{data['affine_leaves']:,} of the cells"
        print_line("affine", f"{leaves}, on a lattice of {steps} steps")
    print_line("table", f"{data['packed_bytes']:,} bytes packed")


def print_alphabet(study: dict[str, Any]) -> None:
    """Print what `capsyn.alphabets.study.AlphabetStudy.summary` returns."""
    print_line("alphabet", chosen_among(study))
    if study["rows"]:
        told = (study["rows"], study["objective"], study["time_unit"], study["count"])
        print_table(brief(*told))


def _print_table_source(counts: dict[str, int]) -> None:
    print_line(
        "from",
        f"a table of {counts['points']:,} points, {counts['outside']:,} without a symbol and "
        f"{counts['several']:,} with several",
    )


def _print_solves(statistics: dict[str, Any]) -> None:
    roles = {
        "vertices": "vertices",
        "centers": "centres",
        "others": "other test points",
        "quarter": "second looks at ties",
    }
    counts = statistics.get("solves_by_role", {})
    parts = ", ".join(f"{counts[role]:,} {name}" for role, name in roles.items() if role in counts)
    print_line("solves", f"{statistics['solves']:,}: {parts}")
    budget = statistics.get("stopped_by")
    if budget or statistics.get("stopped_by_max_solves"):
        print_line("stopped by", f"{budget or 'max_solves'}, before max_level everywhere")
    for key, name, unit in (
        ("worst_case_solves", "Prop. 2", "solves at worst"),
        ("indifferent_points", "ties", "test points where several symbols tie"),
        ("not_finite_points", "not finite", "test points"),
        ("limit_points", "limits", "test points with an infinite gradient, solved inside a cell"),
    ):
        if key in statistics:
            print_line(name, f"{statistics[key]:,} {unit}")


def _print_sample(sample: dict[str, Any]) -> None:
    print_line(
        "controller",
        f"no descent in {sample['no_descent']:.2%} of the volume, several symbols tie in "
        f"{sample['indifferent']:.2%}, no finite result in {sample['not_finite']:.2%} "
        f"({sample['states']:,} random states)",
    )


def _print_settings(settings: dict[str, Any], horizon: str) -> None:
    wanted = "gamma" if settings["alpha_d"] is None else "alpha_d"
    rule = settings["rule"]
    goal = f", {wanted} {settings[wanted]:g}" if rule == "schedule" else ""
    print_line(
        "settings",
        f"horizon {horizon}, rule {rule}{goal}, "
        f"control weight {settings['control_weight']}, {settings['precision']} precision",
    )
