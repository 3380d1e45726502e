"""Does the memory help, does it harm? `memory.toml`, paired over seeds, as a table.

    python benchmarks/memory.py --out bench/memory [--seeds 6000..6049] [--workers 2] [--write docs/parts.md]

Differences of the match rate to the same runs without memory, in percentage points, with 95 % bootstrap intervals by
run; bold where a Wilcoxon test tells it from none after Holm's correction over the table.
"""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from pathlib import Path

from paired import Row, differences, markdown, mean, parser, points, run, write

HOME = Path(__file__).parent
HARM = 0.001  # of the match rate: what the memory may cost at most


def table(rows: Sequence[Row]) -> str:
    """One line a world: match rate without memory, what the memory adds, what a mixed-up one does."""
    found = differences(rows, "match_rate", "off")
    scenarios = list(dict.fromkeys(row["scenario"] for row in rows))
    lines = [
        [s, f"{100 * mean(rows, s, 'off', 'match_rate'):.3f}", *(points(found.get((s, m)), digits=3) for m in ("on", "mixed up"))]
        for s in scenarios
    ]  # fmt: skip
    seeds = len({row["seed"] for row in rows})
    return (
        markdown(["world, route after the taught lap", "off, match %", "on", "mixed up"], lines)
        + "\n\n"
        + told(rows, found, seeds)
    )


def told(rows: Sequence[Row], found: dict, seeds: int) -> str:
    """What it comes to, in words."""
    parts = [f"{seeds} seeds a world."]
    for method in ("on", "mixed up"):
        mine = {s: c for (s, m), c in found.items() if m == method}
        better = [s for s, c in mine.items() if c.verdict == "better"]
        worse = [s for s, c in mine.items() if c.verdict == "worse"]
        harmed = [s for s, c in mine.items() if c.mean < -HARM]
        most = min(mine.items(), key=lambda item: item[1].mean)
        parts.append(
            f"Memory {method}: better in {_list(better)}, worse in {_list(worse)}; largest loss {-100 * most[1].mean:.3f} "
            f"points ({most[0]}); mean loss over {100 * HARM:g} points in {_list(harmed)}."
        )
    return "\n".join(parts)


def _list(names: Sequence[str]) -> str:
    return "no world" if not names else "; ".join(names)


def main() -> None:
    cli = parser(__doc__, "bench/memory")
    options = cli.parse_args()
    grid = tomllib.loads((HOME / "memory.toml").read_text("utf-8"))
    grid |= {"seeds": options.seeds} if options.seeds else {}
    text = table(run(grid, HOME, options.out, options.workers))
    print(text)
    if options.write:
        write(options.write, "memory", text)


if __name__ == "__main__":
    main()
