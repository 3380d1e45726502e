"""Feed every loader with damaged files: nothing but a TomThumbError may come out, in bounded time and memory.

    python benchmarks/fuzz_loaders.py --cases 100000 [--loader NAME] [--seed 0] [--data FOLDER]

Each case takes a small valid log, damages one or more of its files (cut, bytes flipped, spans repeated, removed or
replaced, hostile numbers and words put in, noise, an empty file) and loads it, steps and all. It stops with the seed of
the first case that raises anything else, takes more than 20 s, or brings the process above 1 GiB.
"""

from __future__ import annotations

import argparse
import contextlib
import gzip
import lzma
import resource
import shutil
import sys
import tempfile
import time
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import numpy as np

from tomthumb.errors import TomThumbError
from tomthumb.scenarios import load
from tomthumb.scenarios.csv_save import save_csv
from tomthumb.scenarios.jsonl import save_jsonl

HOSTILE = (
    b"nan", b"inf", b"-inf",
    b"1e308", b"-1e308", b"1e999", b"99999999999999999999", b"-1", b"0", b"", b"\x00", b"\xff\xfe",
    b"\xef\xbb\xbf", b"#", b",,,,", b"\n\n", b"\r", b"[[[[", b"{", b'"', b"../../etc/passwd", b"1_0", b"0x10", b"true",
    "\u0661\u0662".encode(), b"9" * 5000, b"-0.0", b"1e-320",
)  # fmt: skip
LIMIT_S, LIMIT_KIB = 20.0, 1 << 20
Files = dict[str, bytes]


@dataclass(frozen=True)
class Target:
    """A loader: how it is asked for (`{}` is the folder), its valid files, and which of them are damaged."""

    spec: str
    files: Files


def damage(data: bytes, rng: np.random.Generator) -> bytes:
    """One or two damages of random kinds."""
    for _ in range(rng.integers(1, 3)):
        data = DAMAGES[rng.integers(len(DAMAGES))](data, rng)
    return data[: 4 << 20]


def _cut(data: bytes, rng: np.random.Generator) -> bytes:
    return data[: rng.integers(len(data) + 1)]


def _flip(data: bytes, rng: np.random.Generator) -> bytes:
    out = bytearray(data)
    for k in rng.integers(0, max(len(out), 1), rng.integers(1, 4)):
        if len(out):
            out[k] = rng.integers(256)
    return bytes(out)


def _span(data: bytes, rng: np.random.Generator) -> tuple[int, int]:
    a, b = sorted(rng.integers(0, len(data) + 1, 2))
    return int(a), int(min(b, a + 2000))


def _repeat(data: bytes, rng: np.random.Generator) -> bytes:
    a, b = _span(data, rng)
    return data[:b] + data[a:b] * int(rng.integers(1, 6)) + data[b:]


def _remove(data: bytes, rng: np.random.Generator) -> bytes:
    a, b = _span(data, rng)
    return data[:a] + data[b:]


def _insert(data: bytes, rng: np.random.Generator) -> bytes:
    a = int(rng.integers(len(data) + 1))
    return data[:a] + HOSTILE[rng.integers(len(HOSTILE))] + data[a:]


def _word(data: bytes, rng: np.random.Generator) -> bytes:
    """A word (between blanks or commas) replaced by a hostile one."""
    a = int(rng.integers(len(data) + 1))
    start = max(data.rfind(mark, 0, a) for mark in (b" ", b",", b"\n", b":", b"[")) + 1
    ends = [e for e in (data.find(mark, a) for mark in (b" ", b",", b"\n", b"]")) if e >= 0]
    return data[:start] + HOSTILE[rng.integers(len(HOSTILE))] + data[min(ends, default=len(data)) :]


def _noise(data: bytes, rng: np.random.Generator) -> bytes:
    a, b = _span(data, rng)
    return data[:a] + rng.bytes(int(rng.integers(0, 300))) + data[b:]


def _empty(data: bytes, rng: np.random.Generator) -> bytes:
    return b""


def _packed(data: bytes, rng: np.random.Generator) -> bytes:
    """The same packed, whole or cut."""
    packed = gzip.compress(data, 1) if rng.random() < 0.5 else lzma.compress(data, preset=0)
    return packed if rng.random() < 0.5 else _cut(packed, rng)


DAMAGES: tuple[Callable[[bytes, np.random.Generator], bytes], ...] = (
    _cut, _flip, _flip, _repeat, _remove, _insert, _insert, _word, _word, _word, _noise, _empty, _packed,
)  # fmt: skip


def targets(data: Path | None) -> dict[str, Target]:
    """Small valid files for every loader; those of real logs are cut out of the logs, where they are there."""
    found = {**_own(), **_text()}
    if data is not None:
        found |= _logs(data)
    return found


def _own() -> dict[str, Target]:
    world = load("random", steps=6, landmarks=30, size=20.0)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        save_jsonl(world, folder / "a.jsonl")
        save_csv(world, folder / "csv")
        csv = {file.name: file.read_bytes() for file in sorted((folder / "csv").iterdir())}
        return {
            "jsonl": Target("jsonl:{}/a.jsonl", {"a.jsonl": (folder / "a.jsonl").read_bytes()}),
            "csv": Target("csv:{}", csv),
        }


def _text() -> dict[str, Target]:
    g2o = b"VERTEX_SE2 0 0 0 0\nEDGE_SE2 0 1 1 0 0.1 100 0 0 100 0 400\n"
    g2o += b"EDGE_SE2_XY 0 7 2 1 4 0 25\nLANDMARK 1 7 1 1 2 0 5\n"
    course = b"ODOMETRY 0.1 0.1 0.0\nSENSOR 1 2.3 0.35\nSENSOR 2 4.0 1.5\nODOMETRY 0.1 0.1 0.0\nSENSOR 1 2.2 0.3\n" * 3
    step = b"STEP e.0001 0.1 -0.2 0.01 0.00002 0 0.00001 0 0 0.0002\nLANDMARK_C -0.2 -3.1 0.93 0.0017 0.0001 0.0037 6\n"
    velocity = b"".join(b"%d 1.0 0.0 0.1 1 0 0 0 1 0 0 0 1\n" % k for k in range(4, 40))
    seen = b"".join(b"%d\n1 0 3\n3.3 5.8 12.6\n-0.5 0.2 -0.1\n" % k for k in range(8, 40, 8))
    yaml = b"track:\n  left:\n" + b"".join(b"  - position: [%d, 2, 0]\n    class: blue\n" % x for x in range(0, 40, 4))
    yaml += b"  right:\n" + b"".join(b"  - position: [%d, -2, 0]\n    class: yellow\n" % x for x in range(0, 40, 4))
    yaml += b"  lanesFirstWithLastConnected: false\n"
    item = b"<include><uri>model://cone_%s</uri><pose>%d %d 0 0 0 0</pose><name>cone_%s</name></include>"
    cones = [(b"blue", 2, b"left"), (b"yellow", -2, b"right")]
    sdf = (
        b"<sdf><model>"
        + b"".join(item % (c, x, y, s) for c, y, s in cones for x in range(0, 40, 4))
        + b"</model></sdf>"
    )
    tags = b"tag,x,y,direction\n" + b"".join(b"%s,%d,%d,0\n" % (c, x, y) for c, y, _ in cones for x in range(0, 40, 4))
    robot = {
        "Barcodes.dat": b"1 5\n6 63\n7 25\n",
        "Landmark_Groundtruth.dat": b"6 1.2 3.4 0.001 0.001\n7 2.2 1.4 0.001 0.001\n",
        "Robot1_Odometry.dat": b"".join(b"%d.5 0.1 0.02\n" % k for k in range(12)),
        "Robot1_Measurement.dat": b"".join(b"%d.7 63 1.2 0.1\n%d.7 25 2.2 -0.1\n" % (k, k) for k in range(10)),
        "Robot1_Groundtruth.dat": b"".join(b"%d.1 1.0 2.0 0.1\n" % k for k in range(12)),
    }
    return {
        "graph": Target("graph:{}/a.g2o", {"a.g2o": g2o}),
        "freiburg": Target("freiburg:{}", {"sensor_data.dat": course, "world.dat": b"1 2 1\n2 0 4\n"}),
        "dlr": Target("dlr:{}", {"map.circles": b"# a\n" + step * 5}),
        "cones": Target("cones:{}", {"T_velocityLog_1.txt": velocity, "T_perceptionLog_1.txt": seen}),
        "mrclam": Target("mrclam:{}", robot),
        "track_yaml": Target("track:{}/a.yaml?rate=1", {"a.yaml": yaml}),
        "track_sdf": Target("track:{}/a.sdf?rate=1", {"a.sdf": sdf}),
        "track_csv": Target("track:{}/a.csv?rate=1", {"a.csv": tags}),
    }


def _logs(data: Path) -> dict[str, Target]:
    def mats(folder: Path, *names: str) -> Files:
        return {name: (folder / name).read_bytes() for name in names}

    slsjf = data / "slsjf_simulated" / "535"
    names = ("sensor_data.mat", "store_speed.mat", "store_turnrate.mat", "store_robotTrue.mat", "store_beaconsTrue.mat")
    return {
        "slsjf": Target("slsjf:{}", mats(slsjf, *names)),
        "golden": Target("golden:{}/a.mat", {"a.mat": _small_golden()}),
        "lost_in_the_woods": Target("lost_in_the_woods:{}", {"dataset2.mat": _small_woods()}),
        "car_park": Target("car_park:{}?detections=raw", _small_car_park()),
        "victoria_park": Target("victoria_park:{}?detections=raw", {"raw_acfr/victoria_park_ascii.zip": _small_park()}),
    }


def _mat(**values: object) -> bytes:
    from scipy.io import savemat

    out = BytesIO()
    savemat(out, values, do_compression=len(values) % 2 == 0)
    return out.getvalue()


def _small_golden() -> bytes:
    eye = np.eye(4)
    row = {
        "odom_x": np.zeros(3), "odom_P": np.eye(3), "z": np.zeros(4), "R": eye, "ground_id": np.array([1.0, 2]),
        "H": np.array([1.0, 2]), "map_ground_id": np.array([1.0, 2]), "x": np.zeros(7), "Pdiag": np.ones(7),
    }  # fmt: skip
    trace = np.array([row] * 3, object)
    run = {
        "algo": "JCBB", "points": np.zeros((2, 2)), "truth": np.zeros((3, 4)), "est": np.zeros((3, 4)),
        "x1": np.zeros(7),
        "P1": np.eye(7), "z1": np.zeros(4), "R1": eye, "ground_id1": np.array([1.0, 2]), "trace": trace,
    }  # fmt: skip
    return _mat(o=run)


def _small_woods() -> bytes:
    k = np.ones((5, 1))
    t = 0.1 * np.arange(5.0)[:, None]
    r = np.full((5, 3), 2.0)
    return _mat(
        t=t, x_true=k, y_true=k, th_true=k, true_valid=k, l=np.ones((3, 2)), r=r, b=r / 9, v=k, om=k, d=0.2, r_var=0.1,
        b_var=0.1, v_var=0.1, om_var=0.1,
    )  # fmt: skip


def _small_car_park() -> Files:
    t = np.arange(8.0)[None]
    bright = np.zeros((8, 361))
    bright[:, 100] = 1
    log = _mat(
        Time_VS=t, Velocity=t * 0 + 1, Steering=t * 0, TimeGPS=t, GPSLon=t, GPSLat=t, TimeLaser=t + 0.5,
        Laser=np.full((8, 361), 5.0), Intensity=bright,
    )  # fmt: skip
    return {"data_set.mat": log, "beac_juan3.mat": _mat(estbeac=np.ones((3, 2)))}


def _small_park() -> bytes:
    out = BytesIO()
    scan = np.full(361, 81.91)
    scan[100:104] = 10.0
    laser = " ".join(f"{k} " + " ".join(map(str, scan)) for k in range(4))
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("DRS.txt", "".join(f"{0.1 * k} 1.0 0.01\n" for k in range(40)))
        archive.writestr("GPS.txt", "0 1 1\n1 2 2\n")
        archive.writestr("LASER.txt", laser)
    return out.getvalue()


def attempt(target: Target, folder: Path, rng: np.random.Generator) -> bool:
    """One case in an empty folder; True where the damaged log was still read."""
    hit = rng.random(len(target.files)) < 1.5 / len(target.files)
    hit[rng.integers(len(hit))] = True
    for (name, data), spoil in zip(target.files.items(), hit, strict=True):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(damage(data, rng) if spoil else data)
    with contextlib.suppress(TomThumbError):
        scenario = load(target.spec.format(folder))
        for step in scenario.steps:
            assert np.isfinite(step.t)
            if step.observations is not None:
                assert np.isfinite(step.observations.z).all()
        return True
    return False


def run(name: str, target: Target, cases: int, seed: int, stop: float = np.inf) -> dict[str, float]:
    """`cases` cases of one loader (fewer when the clock reaches `stop`)."""
    import warnings

    warnings.simplefilter("error")
    read, slowest, done = 0, 0.0, 0
    with tempfile.TemporaryDirectory(dir="/dev/shm" if Path("/dev/shm").is_dir() else None) as place:
        for case in range(cases):
            if time.monotonic() > stop:
                break
            folder = Path(place) / "case"
            folder.mkdir()
            start = time.monotonic()
            try:
                read += attempt(target, folder, np.random.default_rng([seed, case]))
            except BaseException:
                print(f"{name}: case {case} of seed {seed}", file=sys.stderr)
                raise
            slowest, done = max(slowest, time.monotonic() - start), done + 1
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
            if slowest > LIMIT_S or peak > LIMIT_KIB:
                raise SystemExit(f"{name}: case {case} of seed {seed}: {slowest:.1f} s, {peak >> 10} MiB")
            shutil.rmtree(folder)
    return {"cases": done, "read": read, "slowest_s": slowest}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--loader")
    parser.add_argument("--data", type=Path)
    options = parser.parse_args()
    for name, target in targets(options.data).items():
        if options.loader in (None, name):
            start = time.monotonic()
            result = run(name, target, options.cases, options.seed)
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss >> 10
            print(f"{name:20s} {result}, {time.monotonic() - start:.0f} s, peak {peak} MiB", flush=True)


if __name__ == "__main__":
    main()
