"""What is saved is read back the same; what is damaged is named."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from handmade import estimate, trace, truth
from tomthumb.errors import BrokenFile, TomThumbError
from tomthumb.metrics import score
from tomthumb.storage import SavedRun, load_lessons, load_map, load_run, save_map, save_run
from tomthumb.tale.stdp import LogMemory


@pytest.fixture
def saved() -> SavedRun:
    run = trace(
        [[0, 1], [0, 1]],
        estimate([0, 1], points=[[1, 2], [3, 4.5]], stone=[True, False]),
        final_ids=[0, 1, 0, 1],
        failure="lost at step 2",
        settings={"associator": {"gate": 0.9}},
    )
    return SavedRun(run, truth([5, 6, 5, 6], 2, landmarks=np.array([[1.0, np.nan]])), {"seed": 3})


def test_a_run_comes_back_as_it_was(tmp_path, saved):
    save_run(tmp_path / "new" / "run", saved)
    back = load_run(tmp_path / "new" / "run")
    assert score(back.trace, back.truth) == score(saved.trace, saved.truth)
    assert back.about == {"seed": 3}
    assert back.trace.settings == {"associator": {"gate": 0.9}}
    assert back.trace.failure == "lost at step 2"
    np.testing.assert_array_equal(back.truth.landmarks, saved.truth.landmarks)
    np.testing.assert_array_equal(back.trace.final.stone, [True, False])


def test_the_trajectory_is_tum(tmp_path, saved):
    pose = np.array([[1.0, 2.0, 0.0], [3.0, 4.0, np.pi / 2]])
    run = SavedRun(trace([[], []], estimate(), pose=pose, t=np.array([0.0, 1.5])), truth([], 2))
    save_run(tmp_path, run)
    table = np.loadtxt(tmp_path / "trajectory.tum")
    half = np.sqrt(0.5)
    np.testing.assert_allclose(table, [[0, 1, 2, 0, 0, 0, 0, 1], [1.5, 3, 4, 0, 0, 0, half, half]], atol=1e-8)


@pytest.mark.parametrize("name", ["map.csv", "trace.npz", "."])
def test_a_map_comes_back_from_each_of_its_forms(tmp_path, saved, name):
    save_run(tmp_path, saved)
    back = load_map(tmp_path / name)
    np.testing.assert_array_equal(back.ids, [0, 1])
    np.testing.assert_allclose(back.landmarks, [[1, 2], [3, 4.5]])
    np.testing.assert_allclose(back.covs, np.tile(np.eye(2), (2, 1, 1)))
    np.testing.assert_array_equal(back.stone, [True, False])


HEAD = "id,x_m,y_m,cov_xx_m2,cov_xy_m2,cov_yy_m2,stone\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"map\.csv:1: a map starts with the columns"),
        ("a,b\n", r"map\.csv:1: a map starts with the columns"),
        (HEAD + "1,2\n", r"map\.csv:2: 2 columns, 7 are needed"),
        (HEAD + "1,2,3,1,0,1,1\n2,x,3,1,0,1,1\n", r"map\.csv:3: not a number"),
        (HEAD + '1,2,3,1,0,1,"1\n2,3"\n', r"map\.csv:2: not a number among '1,2,3,1,0,1,1\\n2,3'"),
        (HEAD + "99999999999999999999,2,3,1,0,1,1\n", r"map\.csv:2: .*an id beyond 2\^53"),
        (HEAD + "1,nan,3,1,0,1,1\n", r"map\.csv:2: a value is not finite"),
        (HEAD + "1,2,3,1,2,1,1\n", r"map\.csv:2: the covariance is not positive definite"),
        (HEAD + "1,2,3,1,0,1,1\n1,2,3,1,0,1,1\n", "the same id stands twice"),
        ("\udcff", "is not a map"),
    ],
)
def test_a_broken_map_is_named_with_its_line(tmp_path, text, message):
    file = tmp_path / "map.csv"
    file.write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises(BrokenFile, match=message):
        load_map(file)


def test_a_map_is_written_whole_or_not_at_all(tmp_path):
    file = tmp_path / "map.csv"
    save_map(file, estimate([0, 1]), None)
    whole = file.read_bytes()
    broken = replace(estimate([0, 1, 2]), stone=np.array([True]))
    with pytest.raises(ValueError, match="zip"):  # as if killed after the first row
        save_map(file, broken)
    assert file.read_bytes() == whole
    save_map(file, estimate([0, 1, 2]))
    assert [f.name for f in tmp_path.iterdir()] == ["map.csv"]
    assert len(load_map(file).ids) == 3


def test_a_truncated_trace_is_named(tmp_path, saved):
    save_run(tmp_path, saved)
    file = tmp_path / "trace.npz"
    whole = file.read_bytes()
    for size in (0, 10, len(whole) // 2, len(whole) - 30):
        file.write_bytes(whole[:size])
        with pytest.raises(BrokenFile, match=r"trace\.npz"):
            load_run(file)


def test_a_trace_with_a_damaged_byte_is_named(tmp_path, saved):
    """Any byte: of the directory, of a header, in the middle of what is packed."""
    save_run(tmp_path, saved)
    file = tmp_path / "trace.npz"
    whole, rng = file.read_bytes(), np.random.default_rng(0)
    said = []
    for place in rng.integers(0, len(whole), 400).tolist():
        file.write_bytes(whole[:place] + bytes([whole[place] ^ 0xFF]) + whole[place + 1 :])
        try:
            load_run(file)
        except BrokenFile as reason:
            said.append(str(reason))
    assert len(said) > 200  # the rest hit a date or the like, which says nothing
    assert not any("\n" in line for line in said)


def test_a_pickle_is_refused(tmp_path):
    file = tmp_path / "trace.npz"
    np.savez(file, about=np.array([{"a": 1}], dtype=object))
    with pytest.raises(BrokenFile, match="not a trace"):
        load_run(file)


def test_absent_files_and_unwritable_places_are_named(tmp_path):
    with pytest.raises(BrokenFile, match="No such file"):
        load_run(tmp_path / "nowhere.npz")
    (tmp_path / "file").write_text("")
    with pytest.raises(TomThumbError, match="cannot be written"):
        save_map(tmp_path / "file" / "map.csv", estimate())


def test_lessons_lie_beside_the_map_and_are_read_back(tmp_path, saved):
    memory = LogMemory()
    for t in range(5):
        memory.learn([0, 1], float(t))
    learned = memory.recall([0, 1])
    save_run(tmp_path, SavedRun(replace(saved.trace, lessons=learned), saved.truth))
    for name in (".", "map.csv", "trace.npz"):
        back = load_lessons(tmp_path / name)
        for field in fields(learned):
            np.testing.assert_array_equal(getattr(back, field.name), getattr(learned, field.name))
    save_run(tmp_path, saved)  # another map without lessons: the old ones would not fit it
    assert load_lessons(tmp_path) is None


DAMAGE = ["cut", "share", "shape", "words", "fractions", "negative", "one number", "absent"]


@pytest.mark.parametrize("damage", DAMAGE)
def test_broken_lessons_are_named(tmp_path, damage):
    memory = LogMemory()
    memory.learn([0, 1], 0.0)
    good = memory.recall([0, 1])
    wrong = {
        "cut": good,
        "share": replace(good, together=1.5 * np.ones((2, 2))),
        "shape": replace(good, ids=np.arange(3)),
        "words": replace(good, together=np.array([["a", "b"], ["c", "d"]])),
        "fractions": replace(good, ids=np.array([0.0, np.nan])),
        "negative": replace(good, sightings=np.array([3, -2])),
        "one number": replace(good, ids=np.int64(4)),
        "absent": good,
    }
    save_map(tmp_path / "map.csv", estimate([0, 1]), wrong[damage])
    file = tmp_path / "map.memory.npz"
    if damage == "cut":
        file.write_bytes(file.read_bytes()[:100])
    if damage == "absent":
        np.savez_compressed(file, ids=good.ids)
    with pytest.raises(BrokenFile, match=r"map\.memory\.npz"):
        load_lessons(tmp_path / "map.csv")
