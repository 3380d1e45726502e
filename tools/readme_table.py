"""Write the README's table and figures from ``tomthumb demo``; with --check, say whether they still hold.

python tools/readme_table.py [--check]
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from tomthumb.report.tables import OVERVIEW

ROOT = Path(__file__).resolve().parents[1]
README = ROOT / "README.md"
TABLE = re.compile(r"(<!-- demo table[^\n]*-->\n).*?(<!-- end of demo table -->)", re.DOTALL)
COLUMNS = [column for column in OVERVIEW if not column.key.startswith("associate_us")]  # times differ by machine
FIGURES = ("nn.png", "figure_7_stt_taught.png")


def table(rows: list[dict[str, object]]) -> str:
    """The rows of the demo as Markdown."""
    lines = ["| | " + " | ".join(column.heading for column in COLUMNS) + " |", "|---|" + "---:|" * len(COLUMNS)]
    for row in rows:
        lines.append(f"| {row['label']} | " + " | ".join(column.text(row) for column in COLUMNS) + " |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Run the demo, then write or compare."""
    with tempfile.TemporaryDirectory() as folder:
        call = "from tomthumb.cli.main import main; main()"
        command = [sys.executable, "-c", call, "demo", "--json", "-o", folder]
        done = subprocess.run(command, check=True, capture_output=True, text=True)
        text = README.read_text("utf-8")
        fresh = TABLE.sub(lambda found: found[1] + table(json.loads(done.stdout)["rows"]) + found[2], text)
        if "--check" in sys.argv[1:]:
            sys.exit(
                None if fresh == text else "README.md: the demo's table has moved; run python tools/readme_table.py"
            )
        README.write_text(fresh, "utf-8")
        for name in FIGURES:
            shutil.copyfile(Path(folder) / name, ROOT / "docs" / "images" / name)


if __name__ == "__main__":
    main()
