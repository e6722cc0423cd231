"""How many solves the paper's six policies take, beside the paper's own counts."""

import json

from capsyn.paper.cases import count_solves


def measure():
    """Return one row per case."""
    rows = []
    for row in count_solves():
        note = f", {row['note']}" if row["note"] else ""
        rows.append(
            {
                "what": f"solves: {row['problem']} level {row['max_level']}{note}"
                f" (worst case {row['worst_case']:,})",
                "value": row["solves"],
                "unit": "",
                "wanted": f"paper: {row['paper_solves']:,}"
                + ("; <= 4,700" if row["problem"] == "cart-pendulum" else ""),
            }
        )
    return rows


if __name__ == "__main__":
    print(json.dumps(measure()))
