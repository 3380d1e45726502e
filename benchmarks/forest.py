"""Tables and figures of docs/forest.md: exact hitting times, what each part is worth, the ancestors, speed, memory.

python benchmarks/forest.py hitting --figure docs/figures/forest-hitting.png
python benchmarks/forest.py parts --forests 400
python benchmarks/forest.py ancestors --figure docs/figures/forest-ancestors.png
python benchmarks/forest.py speed
"""

from __future__ import annotations

import argparse
import math
import resource
import time
from pathlib import Path
from typing import Any

import numpy as np

from tomthumb.forest import Rules, plant, tell
from tomthumb.forest.ancestors import KINDS, Quarry, foraging, quarry
from tomthumb.forest.exact import hitting, hitting_one_cell, loop_odds, step_table, transition, window_cells
from tomthumb.forest.experiments import boots_contrasts, coming_home, interval, whole_tale
from tomthumb.forest.walkers import flights_until_seen
from tomthumb.forest.world import bare
from tomthumb.tale.levy import LengthLaw, power_law, scaled_law

SIDE = 32
EXPONENTS = (1.2, 1.5, 2.0, 2.5, 3.0)


def through_window(law: LengthLaw, n: int = SIDE) -> float:
    """Exact mean number of flights from a uniform start through the 3 x 3 window."""
    return float(hitting(transition(step_table(law, n)), window_cells(n, (0, 0))).mean())


def show_hitting(figure: Path | None, forests: int) -> None:
    """Exact values and simulated flights; the distance over lambda for one cell and through the window."""
    print("| lambda | H one cell | simulated | H through 3x3 | simulated | distance one cell | through 3x3 |")
    print("|---" * 7 + "|")
    for lam in (*EXPONENTS, None):
        law = power_law(lam, SIDE // 2) if lam else power_law(1.0, 1)
        exact = (hitting_one_cell(step_table(law, SIDE)), through_window(law))
        seen = [flights_until_seen(law, SIDE, w, 4000, np.random.default_rng(1))[0] for w in (False, True)]
        told = [f"{s.mean():.1f} +- {s.std() / math.sqrt(len(s)):.1f}" for s in seen]
        ways = [f"{h * law.mean:.1f}" for h in exact]
        name = f"{lam:g}" if lam else "simple walk"
        print(f"| {name} | {exact[0]:.4f} | {told[0]} | {exact[1]:.4f} | {told[1]} | {ways[0]} | {ways[1]} |")
    for alpha in (1.0, 2.0, 4.0, 7.0):
        law = scaled_law(power_law(2.0, SIDE // 2), alpha)
        t = through_window(law)
        print(f"boots alpha {alpha:g}: {t:.1f} flights, distance {t * law.mean:.1f} through 3x3")
    for lam in (1.5, 2.0, 3.0):
        table = step_table(power_law(lam, 8), 16)
        odds = loop_odds(table, table, (0, 0), (5, 6), (11, 3), 10)
        rules = Rules(lam=lam, stones="never", birds=1.0, plasticity=None, boots=1.0)
        rng, forest = np.random.default_rng(5), bare(16, (0, 0), (5, 6), (11, 3))
        tales = [tell(forest, rng, rules) for _ in range(10 * forests)]
        passes = sum(t.iterations for t in tales)
        ogres, kings = sum(t.ogre_visits for t in tales) / passes, sum(t.awards for t in tales) / passes
        print(f"loop lambda {lam:g}: ogre {odds.ogre:.6f} ({ogres:.4f}), success {odds.success:.6f} ({kings:.4f}), "
              f"iterations {odds.iterations:.4f} ({passes / len(tales):.4f})")  # fmt: skip
    if figure:
        draw_hitting(figure)


def draw_hitting(path: Path) -> None:
    """Distance against lambda: least near 2 through the window, falling all the way for one cell."""
    import matplotlib.pyplot as plt

    exponents = np.arange(1.05, 3.01, 0.05)
    laws = [power_law(float(lam), SIDE // 2) for lam in exponents]
    curves = {
        "one cell": [hitting_one_cell(step_table(law, SIDE)) * law.mean for law in laws],
        "through the 3 x 3 window": [through_window(law) * law.mean for law in laws],
    }
    figure, axes = plt.subplots(1, 2, figsize=(9.0, 3.4), layout="constrained")
    for axis, (name, curve), window in zip(axes, curves.items(), (False, True), strict=True):
        axis.plot(exponents, curve, label="exact")
        for lam in EXPONENTS:
            flights, distances = flights_until_seen(
                power_law(lam, SIDE // 2), SIDE, window, 4000, np.random.default_rng(1)
            )
            error = 2 * distances.std() / math.sqrt(len(flights))
            axis.errorbar(lam, distances.mean(), error, fmt="o", color="tab:orange", capsize=3)
        least = int(np.argmin(curve))
        axis.axvline(exponents[least], color="0.7", ls=":")
        axis.set_title(f"{name}: least at lambda = {exponents[least]:.2f}", fontsize=10)
        axis.set_xlabel("lambda")
        axis.set_ylabel("mean distance, cells")
    save(figure, path)


def show_parts(forests: int) -> None:
    """Every part against its absence, as a Markdown table."""
    print("| what | with | without | difference | 95 % interval |\n|---|---|---|---|---|")
    for c in (*coming_home(forests), *boots_contrasts(forests), *whole_tale(forests)):
        print(
            f"| {c.name} | {c.with_part:.1f} | {c.without:.1f} | {c.difference:+.1f} | [{c.low:+.1f}, {c.high:+.1f}] |"
        )


def show_ancestors(figure: Path | None, forests: int) -> None:
    """Samples brought home by each kind; crumbs on the ground of the regulated robots while a source pays and after."""
    print("| kind | samples of 90 home after 1500 steps | 95 % interval |\n|---|---|---|")
    for kind in KINDS:
        worlds = [
            (quarry(np.random.default_rng(s)), np.random.default_rng([s, 1])) for s in range(max(5, forests // 10))
        ]
        homes = np.array([[c.brought for c in foraging(w, kind, rng, 1500)][-1] for w, rng in worlds], dtype=float)
        low, high = interval(homes, np.random.default_rng(0))
        print(f"| {kind} | {homes.mean():.1f} | [{low:.1f}, {high:.1f}] |")
    if figure:
        draw_regulation(figure)


def draw_regulation(path: Path) -> None:
    """The regulated robots' trail: it grows while the source pays, and is gathered in again when it does not."""
    import matplotlib.pyplot as plt

    marks, stock, carried = [], [], []
    for c in foraging(Quarry(41, np.array([[8, 8]]), np.array([150])), "regulated", np.random.default_rng(0), 4000):
        marks.append(int(c.marks.sum()))
        stock.append(int(c.stock[0]))
        carried.append((int(c.carried.min()), int(c.carried.max())))
    figure, axes = plt.subplots(1, 2, figsize=(9.0, 3.2), layout="constrained")
    axes[0].plot(marks, label="crumbs on the ground")
    axes[0].plot(np.array(stock) / 10, label="samples left / 10")
    axes[1].plot([c[0] for c in carried], label="least carried")
    axes[1].plot([c[1] for c in carried], label="most carried")
    axes[1].axhline(40, color="0.7", ls=":", label="budget of a robot")
    for axis in axes:
        axis.set_xlabel("steps")
        axis.legend(fontsize=8)
    save(figure, path)


def save(figure: Any, path: Path) -> None:
    """A small PNG."""
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=80)


def show_speed() -> None:
    """Family moves a second of one core's time, whole tales with learning and trail; memory of the largest."""
    tell(plant(np.random.default_rng(0), 16), np.random.default_rng(0))  # compile outside the clock
    print("| forest | moves | moves a second | peak memory |\n|---|---|---|---|")
    for size, tales, most in ((64, 40, 10**8), (256, 10, 10**8), (1024, 1, 10**7), (4096, 1, 10**7)):
        forests = [plant(np.random.default_rng(s), size) for s in range(tales)]
        start = time.process_time()
        moves = sum(tell(f, np.random.default_rng(s), Rules(max_moves=most)).moves for s, f in enumerate(forests))
        rate = moves / (time.process_time() - start)
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
        print(f"| {size} x {size} | {moves} | {rate / 1e6:.2f} million | {peak:.2f} GiB |")


def main() -> None:
    """One table (and figure) at a time."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("hitting", "parts", "ancestors", "speed"))
    parser.add_argument("--forests", type=int, default=200)
    parser.add_argument("--figure", type=Path)
    given = parser.parse_args()
    if given.what == "hitting":
        show_hitting(given.figure, given.forests)
    elif given.what == "parts":
        show_parts(given.forests)
    elif given.what == "ancestors":
        show_ancestors(given.figure, given.forests)
    else:
        show_speed()


if __name__ == "__main__":
    main()
