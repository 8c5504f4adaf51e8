"""Write the tables of docs/hostile.md from results of mutations.py and faults.py.

Usage: hostile_page.py --mutations FILE.json --faults FILE.json …
"""

import argparse
import json
from pathlib import Path

from faults import table as by_fault
from plan_page import number, table, write

PAGE = Path(__file__).parents[1] / "docs" / "hostile.md"
_WORSE = ("traceback", "hang", "death", "memory", "outside")


def mutations(found):
    """Lines on damaged files: numbers of outcomes by parser."""
    rows = found["rows"]
    cells = [
        [
            row["parser"],
            f"{sum(row[end] for end in ('answer', 'sentence', *_WORSE)):,}",
            *(f"{row[end]:,}" for end in ("answer", "sentence", *_WORSE)),
            number(row["longest_s"]),
            number(1e3 * row["memory_gb"]),
        ]
        for row in rows
    ]
    total = [sum(row[end] for row in rows) for end in ("answer", "sentence", *_WORSE)]
    cells.append(["all", f"{sum(total):,}", *(f"{count:,}" for count in total), "", ""])
    heads = ["read", "tried", "answer", "sentence", "traceback", "> 10 s", "died", "> 1 GB"]
    lines = table([*heads, "elsewhere", "longest (s)", "memory (MB)"], cells)
    return [f"`mutations.py --count {found['asked']} --seed {found['seed']}`:", "", *lines]


def faults(runs):
    """Lines on faults: the times tried in one run or several, and the worst results."""
    heads = ["fault", "trials", "moments (s)", "exit status", "tracebacks", "left running"]
    heads += ["lost (s)", "log does not open", "stage moves on (s)", "torque not as set"]
    heads += ["not refused", "replay differs by"]
    cells = []
    for row in by_fault([trial for run in runs for trial in run["trials"]]):
        span = f"{row['first_s']:.1f} to {row['last_s']:.1f}"
        cells.append(
            [row["fault"], row["trials"], span, ", ".join(row["statuses"]), row["tracebacks"]]
            + [row["left_running"], number(row["lost_s"]), row["not_opened"]]
            + ["–" if row[key] is None else number(row[key]) for key in ("moves_on_s",)]
            + [row["torque_wrong"], row["not_refused"]]
            + ["–" if row["differs"] is None else f"{row['differs']:.1g}"]
        )
    seeds = ", ".join(str(run["seed"]) for run in runs)
    return [f"`faults.py --seed {seeds}`:", "", *table(heads, cells)]


def main():
    """Write the tables whose results are given."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--mutations", type=Path)
    parser.add_argument("--faults", type=Path, nargs="+")
    options = parser.parse_args()
    if options.mutations:
        write("mutations", mutations(json.loads(options.mutations.read_text())), PAGE)
    if options.faults:
        write("faults", faults([json.loads(f.read_text()) for f in options.faults]), PAGE)


if __name__ == "__main__":
    main()
