"""Run the hard cases and write README.md beside this file: case, property, worst deviation, seconds.

python tests/hard_cases/write_table.py [--heavy] [--only WORD]      (--only prints the lines and writes nothing)
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent)]

import large  # noqa: E402, F401
import light  # noqa: E402, F401
import shapes  # noqa: E402, F401
from cases import CASES, Baker  # noqa: E402

from cell_radiosity.core.cells import LocalCells, make_cells  # noqa: E402

HEAD = """# Hard cases

Made by `make hard-cases`. The first scene of every case goes through the whole bake with one cell and with two, which
must give the same bits, its twins with two; light must be finite and nowhere below 0, power in balance. Beyond that each
case has a property of its own.
The deviation is the worst at any point, as a share of the mean, or what the property says; seconds are those of all
bakes of a case on two shared cores, the memory is that of host and cells at their peak.

| case | property | worst deviation | allowed | seconds | memory, MB |
|---|---|---|---|---|---|
"""


def run_case(case, cells):
    """Deviation, or the error as text, seconds and peak memory [MB] of a Case."""
    baker, begun = Baker(cells, **case.settings), time.perf_counter()
    try:
        found = case.check(baker)
    except Exception as error:
        found = f"{type(error).__name__}: {error}".splitlines()[0]
    return found, time.perf_counter() - begun, baker.memory


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--heavy", action="store_true")
    parser.add_argument("--only", default="")
    parser.add_argument("--here", action="store_true", help="in this process instead of with cells")
    arguments = parser.parse_args()
    lines = []
    cells = (LocalCells(),) if arguments.here else (make_cells(1), make_cells(2))
    try:
        for case in CASES.values():
            if (case.heavy and not arguments.heavy) or arguments.only not in case.name:
                continue
            found, seconds, memory = run_case(case, cells)
            shown = found if isinstance(found, str) else f"{found:.1e}" if found else "0"
            failed = isinstance(found, str) or not found <= case.within
            print(
                "FAILED" if failed else "      ", case.name, shown, f"{case.within:.0e}", f"{seconds:.1f} s", flush=True
            )
            lines.append(
                f"| {case.name} | {case.property} | {shown} | {case.within:g} | {seconds:.1f} | {memory:.0f} |"
            )
    finally:
        for each in cells:
            each.stop()
    if not arguments.only:
        (HERE / "README.md").write_text(HEAD + "\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
