"""Damaged files: whatever is in them, a loader gives a scenario or a TomThumbError. The long run is in benchmarks."""

import gzip
import importlib.util
import lzma
import struct
import sys
import tempfile
import time
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tomthumb.errors import BrokenFile, TomThumbError
from tomthumb.scenarios import load
from tomthumb.scenarios.reading import MAX_BYTES, numbers, read_bytes, read_member, table

BENCHMARK = Path(__file__).resolve().parents[2] / "benchmarks" / "fuzz_targets.py"
spec = importlib.util.spec_from_file_location("fuzz_targets", BENCHMARK)
fuzz = importlib.util.module_from_spec(spec)
sys.modules[spec.name] = fuzz
spec.loader.exec_module(fuzz)
OWN = fuzz.targets(None)
LOGS = ("slsjf",)


def survive(target, seed):
    with tempfile.TemporaryDirectory() as folder:
        fuzz.attempt(target, Path(folder), np.random.default_rng(seed))


@pytest.mark.parametrize("name", OWN)
@settings(max_examples=500, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(seed=st.integers(0, 2**32 - 1))
def test_damaged_files(name, seed):
    if name == "track_yaml":
        pytest.importorskip("yaml", reason="needs the extra: cones")
    survive(OWN[name], seed)


@pytest.mark.data
@pytest.mark.parametrize("name", LOGS)
@settings(max_examples=500, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(seed=st.integers(0, 2**32 - 1))
def test_damaged_logs(name, data_dir, seed):
    survive(logs(data_dir)[name], seed)


def logs(folder, kept={}):  # noqa: B006 - built once
    if not kept:
        kept |= fuzz.targets(folder)
    return kept


@pytest.mark.parametrize("name", OWN)
def test_the_undamaged_files_are_read(name, tmp_path):
    if name == "track_yaml":
        pytest.importorskip("yaml", reason="needs the extra: cones")
    fuzz.write(tmp_path, OWN[name].files)
    assert OWN[name].read(OWN[name].spec.format(tmp_path)) > 0


@pytest.mark.data
@pytest.mark.parametrize("name", LOGS)
def test_the_undamaged_logs_are_read(name, data_dir, tmp_path):
    fuzz.write(tmp_path, logs(data_dir)[name].files)
    assert logs(data_dir)[name].read(logs(data_dir)[name].spec.format(tmp_path)) > 0


@given(st.binary(max_size=300))
@settings(deadline=None)
def test_numbers_and_tables_of_anything(data):
    for read in (numbers, lambda d, p: table(d, p, 2)):
        try:
            out = read(data, "file")
        except BrokenFile:
            continue
        assert np.isfinite(out).all()


@pytest.mark.parametrize("pack", [gzip.compress, lzma.compress])
def test_a_bomb_is_refused_in_bounded_memory(tmp_path, pack):
    (tmp_path / "a.jsonl").write_bytes(pack(b"0" * (3 * MAX_BYTES)))
    (tmp_path / "b.g2o").write_bytes((tmp_path / "a.jsonl").read_bytes())
    tracemalloc.start()
    start = time.monotonic()
    with pytest.raises(BrokenFile, match="MiB"):
        load(str(tmp_path / "a.jsonl"))
    with pytest.raises(BrokenFile, match="MiB"):
        load(str(tmp_path / "b.g2o"))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 3 * MAX_BYTES
    assert time.monotonic() - start < 120


def test_zip_bombs_and_paths_that_lead_astray(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("bomb", b"0" * (MAX_BYTES + 1))
        archive.writestr("../../evil", b"1 2 3")
    with pytest.raises(BrokenFile, match="MiB"):
        read_member(tmp_path / "a.zip", "bomb")
    assert read_member(tmp_path / "a.zip", "../../evil") == b"1 2 3"  # in memory; nothing is written anywhere
    assert [p.name for p in tmp_path.iterdir()] == ["a.zip"]
    with pytest.raises(BrokenFile, match="holds no other"):
        read_member(tmp_path / "a.zip", "other")


def test_a_directory_of_an_archive_with_a_name_that_is_no_text_is_named(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        archive.writestr("\u00e9\u00e9.txt", b"1 2 3")
    data = (tmp_path / "a.zip").read_bytes()
    (tmp_path / "a.zip").write_bytes(data.replace("\u00e9\u00e9".encode(), b"\x9a\x9a\x9a\x9a"))
    with pytest.raises(BrokenFile, match="zip archive"):
        read_member(tmp_path / "a.zip", "DRS.txt")


def test_an_integer_beyond_all_floats_is_named_in_one_short_line(tmp_path):
    fuzz.write(tmp_path, OWN["csv"].files)
    (tmp_path / "scenario.toml").write_text(f"[sensor]\nmax_range = {'9' * 400}\n")
    with pytest.raises(TomThumbError, match=r"max_range=9+\.\.\.: a number is expected") as found:
        load(f"csv:{tmp_path}")
    assert len(str(found.value)) < 300


@pytest.mark.parametrize(
    ("line", "words"),
    [("std = [1e200, 0.1]", "std must be finite, and at most"), ("model = [1]", r"model \[1\]: one of")],
)
def test_settings_beyond_all_reason_are_named(tmp_path, line, words):
    fuzz.write(tmp_path, OWN["csv"].files)
    (tmp_path / "scenario.toml").write_text(f"[sensor]\n{line}\n")
    with pytest.raises(TomThumbError, match=words):
        load(f"csv:{tmp_path}")


def test_a_folder_a_missing_file_and_a_cut_archive_are_named(tmp_path):
    (tmp_path / "a.gz").write_bytes(gzip.compress(b"1 2 3" * 1000)[:-20])
    for path, words in ((tmp_path, "is a folder"), (tmp_path / "b", "no such file"), (tmp_path / "a.gz", "cannot be")):
        with pytest.raises(BrokenFile, match=words):
            read_bytes(path)


@pytest.mark.parametrize("element", [struct.pack("<II", 6, 0), struct.pack("<IIII", 6, 8, 2, 0)])
def test_a_matlab_file_of_empty_elements_is_named(tmp_path, element):
    """A matrix whose flags are empty; one that claims to be a struct and has no field names."""
    parts = element + struct.pack("<IIii", 5, 8, 1, 1) + struct.pack("<II", 1, 1) + b"o" + bytes(7)
    (tmp_path / "a.mat").write_bytes(b" " * 124 + b"\x00\x01IM" + struct.pack("<II", 14, len(parts)) + parts)
    with pytest.raises(BrokenFile, match="without"):
        load(f"golden:{tmp_path}/a.mat")


def test_a_matlab_text_of_fractions_is_named(tmp_path):
    """Text is of integers; NaN as a letter would be a warning of numpy's."""
    parts = (
        struct.pack("<IIII", 6, 8, 4, 0) + struct.pack("<IIii", 5, 8, 1, 1) + struct.pack("<II", 1, 1) + b"o" + bytes(7)
    )
    parts += struct.pack("<IId", 9, 8, float("nan"))
    (tmp_path / "a.mat").write_bytes(b" " * 124 + b"\x00\x01IM" + struct.pack("<II", 14, len(parts)) + parts)
    with pytest.raises(BrokenFile, match="text made of fractions"):
        load(f"golden:{tmp_path}/a.mat")


def test_a_matlab_file_that_unfolds_is_refused(tmp_path):
    import zlib

    packed = zlib.compress(b"\0" * (MAX_BYTES + 100), 9)
    head = b" " * 124 + b"\x00\x01IM"
    (tmp_path / "a.mat").write_bytes(head + struct.pack("<II", 15, len(packed)) + packed)
    with pytest.raises(TomThumbError, match="MiB when unpacked"):
        load(f"golden:{tmp_path}/a.mat")
