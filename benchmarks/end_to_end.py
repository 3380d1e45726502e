"""Whole runs: `end_to_end.toml`, every associator in every cell, and STT against the best of the others.

    python benchmarks/end_to_end.py --out out/end_to_end [--workers 2] [--seeds 1000..1049] [--write docs/end_to_end.md]
    python benchmarks/end_to_end.py --out out/end_to_end --only people clutter

Match rates in percent; STT's differences to the associator that is best in the cell (chosen on the same worlds, so this
favours the others) and to JCBB at the gate that is best there, with 95 % bootstrap intervals by run. Bold where a Wilcoxon
test tells the difference from none after Holm's correction over the table. Runs that are there already are not repeated.
"""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from pathlib import Path

from paired import Row, differences, markdown, mean, parser, points, run, write

from tomthumb.stats import Comparison

HOME = Path(__file__).parent
OURS, TRUTH = "STT", "oracle"


def word(c: Comparison | None) -> str:
    """By the interval of the mean difference."""
    if c is None:
        return "-"
    return "wins" if c.low > 0.0 else "**loses**" if c.high < 0.0 else "ties"


def names(rows: Sequence[Row], column: str) -> list[str]:
    """What stands in a column, in the order of the grid."""
    return list(dict.fromkeys(row[column] for row in rows))


def match_table(rows: Sequence[Row]) -> str:
    """Match rate of every method in every cell, and STT's ghosts and NEES beside the oracle's."""
    methods = names(rows, "method")
    lines = []
    for cell in names(rows, "scenario"):
        shares = [f"{100 * mean(rows, cell, method, 'match_rate'):.2f}" for method in methods]
        ghosts = f"{mean(rows, cell, OURS, 'ghosts'):.1f}"
        ate = f"{mean(rows, cell, OURS, 'ate_m'):.3f} / {mean(rows, cell, TRUTH, 'ate_m'):.3f}"
        lines.append([cell, *shares, ghosts, ate])
    return markdown(["cell", *methods, "ghosts, STT", "ATE m, STT / oracle"], lines)


def versus_table(rows: Sequence[Row]) -> str:
    """STT against the best of the others and against JCBB at its best gate, in each cell."""
    others = [method for method in names(rows, "method") if method not in (OURS, TRUTH)]
    against = {other: differences(rows, "match_rate", other) for other in others}
    lines = []
    for cell in names(rows, "scenario"):
        best = max(others, key=lambda other: mean(rows, cell, other, "match_rate"))
        jcbb = max((o for o in others if o.startswith("JCBB")), key=lambda o: mean(rows, cell, o, "match_rate"))
        one, two = (against[other].get((cell, OURS)) for other in (best, jcbb))
        lines.append([cell, best, points(one), jcbb, points(two), word(one)])
    return markdown(["cell", "best of the others", "STT minus it", "best gate of JCBB", "STT minus it", "STT"], lines)


def main() -> None:
    """Make the tables."""
    cli = parser(__doc__, "bench/end_to_end", workers=2)
    grid = tomllib.loads((HOME / "end_to_end.toml").read_text("utf-8"))
    labels = [cell["label"] for cell in grid["scenario"]]
    cli.add_argument("--only", nargs="+", choices=labels, metavar="LABEL", help=f"of scenarios: {', '.join(labels)}")
    args = cli.parse_args()
    if args.only and args.write:
        cli.error("--write replaces the whole table: not with --only")
    grid["seeds"] = args.seeds or grid["seeds"]
    grid["scenario"] = [cell for cell in grid["scenario"] if cell["label"] in (args.only or labels)]
    rows = run(grid, HOME, args.out, args.workers)
    text = f"{match_table(rows)}\n\n{versus_table(rows)}"
    print(text)
    if args.write:
        write(args.write, "end_to_end", text)


if __name__ == "__main__":
    main()
