"""Feed every loader with damaged files: nothing but a TomThumbError may come out, in bounded time and memory.

    python benchmarks/fuzz_loaders.py --cases 100000 --keep tally.json [--loader NAME] [--seed 0] [--data FOLDER]
    python benchmarks/fuzz_loaders.py --atheris 600 --loader NAME     # guided by coverage, for so many seconds

Each case takes a small valid log, damages one or more of its files (cut, bytes flipped, spans repeated, removed or
replaced, hostile numbers and words put in, noise, an empty file) and loads it, steps and all. It stops with the seed of
the first case that raises anything else, gives an error of more than one line, takes more than 20 s, or needs more than
1 GiB on top of the process (a limit of the system, so that nothing larger is ever had).

Loaders take turns of `--turn` cases, and the tally is kept: the same command continues where it was stopped.
"""

from __future__ import annotations

import argparse
import faulthandler
import json
import os
import resource
import shutil
import signal
import sys
import tempfile
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from fuzz_targets import Target, attempt, survives, targets

from tomthumb.bench.execute import memory_bound

LIMIT_S, LIMIT_MIB = 20, 1024
BEGIN, END = "<!-- fuzz: benchmarks/fuzz_loaders.py -->", "<!-- end of fuzz -->"
MEMORY_PLACE = "/dev/shm" if Path("/dev/shm").is_dir() else None


class Hang(BaseException):
    """A case that takes too long: no Exception, so that nobody on the way catches it."""


def _hang(number: int, frame: Any) -> None:
    raise Hang(f"more than {LIMIT_S} s")


@contextmanager
def guarded() -> Iterator[None]:
    """Memory bound, and warnings are errors."""
    with memory_bound(LIMIT_MIB), warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


def run(name: str, target: Target, cases: range, seed: int, place: Path) -> dict[str, float]:
    """Such cases of one loader: how many, how many of them were still read, the slowest in s, all together in s.

    Hangs are ended: in Python code by an alarm, in other code by the end of the process.
    """
    signal.signal(signal.SIGALRM, _hang)
    read, slowest, begun = 0, 0.0, time.monotonic()
    for case in cases:
        folder = place / "case"
        folder.mkdir()
        start = time.monotonic()
        signal.alarm(LIMIT_S)
        faulthandler.dump_traceback_later(2 * LIMIT_S, exit=True)
        try:
            read += attempt(target, folder, np.random.default_rng([seed, case]))
        except BaseException:
            print(f"{name}: case {case} of seed {seed}", file=sys.stderr)
            raise
        finally:
            signal.alarm(0)
            faulthandler.cancel_dump_traceback_later()
        slowest = max(slowest, time.monotonic() - start)
        shutil.rmtree(folder)
    return {"cases": len(cases), "read": read, "slowest_s": slowest, "seconds": time.monotonic() - begun}


def add(kept: dict[str, Any], found: dict[str, float]) -> dict[str, Any]:
    """The tally of a loader with one turn more."""
    total = {key: kept.get(key, 0) + found[key] for key in ("cases", "read", "seconds")}
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss >> 10
    worst = {"slowest_s": found["slowest_s"], "peak_mib": peak}
    return total | {key: max(kept.get(key, 0), value) for key, value in worst.items()}


def all_in_turn(chosen: dict[str, Target], options: argparse.Namespace) -> None:
    """Every loader up to `--cases`, a turn each at a time, until `--seconds` are over."""
    stop = time.monotonic() + options.seconds
    kept: dict[str, Any] = {}
    if options.keep and options.keep.exists():
        kept = json.loads(options.keep.read_text())
    with tempfile.TemporaryDirectory(dir=MEMORY_PLACE) as name, guarded():
        while time.monotonic() < stop:
            behind = [n for n in chosen if kept.get(n, {}).get("cases", 0) < options.cases]
            if not behind:
                break
            loader = min(behind, key=lambda n: kept.get(n, {}).get("cases", 0))
            first = kept.get(loader, {}).get("cases", 0)
            cases = range(first, min(first + options.turn, options.cases))
            kept[loader] = add(kept.get(loader, {}), run(loader, chosen[loader], cases, options.seed, Path(name)))
            if options.keep:
                options.keep.write_text(json.dumps(kept, indent=1))
    print("\n".join(table(kept)), flush=True)
    if options.write:
        write(options.write, kept)


def table(kept: dict[str, Any]) -> list[str]:
    """The tally as the lines of a Markdown table."""
    head = ["| loader | cases | still read | slowest s | ms a case | process MiB |", "|---|---|---|---|---|---|"]
    return head + [
        f"| {name} | {row['cases']} | {row['read']} | {row['slowest_s']:.1f} | "
        f"{1e3 * row['seconds'] / row['cases']:.1f} | {row['peak_mib']} |"
        for name, row in kept.items()
    ]


def write(document: Path, kept: dict[str, Any]) -> None:
    """Put the table between the marks of a document."""
    before, _, rest = document.read_text(encoding="utf-8").partition(BEGIN)
    after = rest.partition(END)[2]
    document.write_text("\n".join([before + BEGIN, "", *table(kept), "", END]) + after, encoding="utf-8")


def guided(name: str, target: Target, seconds: int) -> None:
    """libFuzzer through atheris: the input says by its first byte which file it stands for. Ends the process."""
    import atheris

    with tempfile.TemporaryDirectory(dir=MEMORY_PLACE) as place, guarded():
        corpus = Path(place) / "corpus"
        corpus.mkdir()
        names = list(target.files)
        for k, file in enumerate(names):
            (corpus / str(k)).write_bytes(bytes([k]) + target.files[file])
        folder = Path(place) / "case"

        def one(data: bytes) -> None:
            shutil.rmtree(folder, ignore_errors=True)
            which = names[data[0] % len(names)] if data else names[0]
            survives(target, folder, target.files | {which: data[1:]})

        limits = [f"-max_total_time={seconds}", f"-timeout={LIMIT_S}", "-rss_limit_mb=2048", "-max_len=65536"]
        atheris.Setup([name, *limits, "-print_final_stats=1", str(corpus)], one)
        atheris.Fuzz()


def instrumented(data: Path | None) -> dict[str, Target]:
    """The targets, with the loaders imported anew so that atheris sees where their code goes."""
    import atheris

    for module in [m for m in sys.modules if m.startswith("tomthumb.scenarios")]:
        del sys.modules[module]
    del sys.modules["fuzz_targets"]
    with atheris.instrument_imports(include=["tomthumb.scenarios"]):
        import fuzz_targets

        found: dict[str, Target] = fuzz_targets.targets(data)
        for target in found.values():  # loaders are imported when they are first asked for
            with tempfile.TemporaryDirectory() as name:
                fuzz_targets.survives(target, Path(name), target.files)
    globals()["survives"] = fuzz_targets.survives
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=500)
    parser.add_argument("--turn", type=int, default=1000)
    parser.add_argument("--seconds", type=float, default=float("inf"))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--loader", nargs="*")
    parser.add_argument("--data", type=Path, default=Path(os.environ.get("TOMTHUMB_DATA", "../shared/data")))
    parser.add_argument("--keep", type=Path)
    parser.add_argument("--write", type=Path, help="put the table between the marks of this document")
    parser.add_argument("--atheris", type=int, metavar="SECONDS")
    options = parser.parse_args()
    data = options.data if options.data.is_dir() else None
    if options.atheris:
        try:
            found = instrumented(data)
        except ModuleNotFoundError as error:
            if error.name != "atheris":
                raise
            sys.exit("--atheris needs atheris (pip install atheris): skipped")
        name = options.loader[0] if options.loader else ""
        if name not in found:
            sys.exit(f"--atheris needs --loader, one of {', '.join(found)}")
        guided(name, found[name], options.atheris)
    found = targets(data)
    for name in options.loader or ():
        if name not in found:
            sys.exit(f"no loader {name}: there are {', '.join(found)}")
    all_in_turn({name: found[name] for name in options.loader or found}, options)


if __name__ == "__main__":
    main()
