"""tomthumb demo, with a newcomer's associator beside ours."""

from __future__ import annotations

from pathlib import Path

EXAMPLE = Path(__file__).parents[2] / "examples" / "my_associator.py"


def test_demo_compares_draws_and_writes_the_report(tomthumb, tmp_path):
    said = tomthumb("demo", "-o", tmp_path, "--json", "--associator", f"{EXAMPLE}:Mine")
    assert said.code == 0
    rows = {row["label"]: row for row in said.json["rows"]}
    assert list(rows) == ["ground truth", "NN", "JCBB", "STT untaught", "STT taught", f"{EXAMPLE}:Mine"]
    assert rows["ground truth"]["match_rate"] == 1.0
    assert rows["JCBB"]["match_rate"] > 0.995 > rows["NN"]["match_rate"]
    assert rows["STT taught"]["match_rate"] == 1.0
    assert rows["STT taught"]["wrong_ids"] == 0
    for name in ("figure_5_ground_truth", "figure_6_jcbb", "figure_7_stt_taught"):
        assert (tmp_path / f"{name}.svg").stat().st_size > 10_000
        assert (tmp_path / f"{name}.png").read_bytes().startswith(b"\x89PNG")
    page = (tmp_path / "report.html").read_text()
    assert "my_associator.py:Mine" in page
    assert page.count("<img") == len(rows)


def test_the_table_fits_a_terminal(tomthumb, tmp_path, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    said = tomthumb("demo", "-o", tmp_path)
    for label in ("ground truth", "STT taught"):
        assert any(line.strip().startswith(label) for line in said.out.splitlines())
    assert max(map(len, said.out.splitlines())) <= 80
    assert "report.html" in said.err
