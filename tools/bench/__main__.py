"""Measure how fast bakes are: `make bench`, or python -m tools.bench [PART ...].

Writes docs/bench: a dated JSON with all figures, a page of tables, plots; and the table in the README. Parts that are not
named keep the figures they have in today's file.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from datetime import date

from cell_radiosity.addon.job import default_cells
from cell_radiosity.core.cells import make_cells
from cell_radiosity.core.report import write_json

from . import cycles as cycles_bakes
from . import errors, growth, page, phases
from .machine import describe, hall_loop, load
from .scenes import NAMES, ROOT, SAMPLES


def measure_errors(arguments, before):
    """Error and CPU seconds of our bakes beside Cycles'."""
    cycles = cycles_bakes.figures(arguments.scenes, arguments.cycles)
    bare, scenes = hall_loop(), dict(before.get("scenes", {}))
    with make_cells(default_cells()) as cells:
        for name in arguments.scenes:
            scenes[name] = errors.bakes_of(name, cells, arguments.seeds, bare)
            scenes[name]["against_cycles"] = errors.compared(scenes[name], cycles[name])
    return {"seeds": arguments.seeds, "scenes": {name: scenes[name] for name in NAMES if name in scenes}}


def measure_phases(arguments, _):
    """Where the time goes."""
    bare = hall_loop()
    with make_cells(default_cells()) as cells:
        embree = phases.embree_shares("hall", cells, bare, arguments.seeds)
    return {"embree": embree, "commands": phases.commands(SAMPLES, arguments.seeds)}


def measure_growth(*_):
    """How cost grows with size."""
    return {name: growth.series(name) for name in growth.SIZES}


def measure_tools(*_):
    """What the tools that measure cells and effects print."""
    asked = {"cells": ["bench_cells.py"], "effects": ["effects_table.py"]}
    return {name: _printed(*command) for name, command in asked.items()}


def _printed(tool, *arguments):
    command = [sys.executable, str(ROOT / "tools" / tool), *arguments]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


PARTS = {"errors": measure_errors, "phases": measure_phases, "growth": measure_growth, "tools": measure_tools}


def main():
    """Read the command line, measure, write."""
    parser = argparse.ArgumentParser(prog="python -m tools.bench", description=__doc__.split("\n\n")[0])
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"of {', '.join(PARTS)} (default: all)")
    parser.add_argument(
        "--scenes", type=lambda text: text.split(","), default=NAMES, help="default: all with a reference"
    )
    parser.add_argument(
        "--cycles", type=lambda text: text.split(","), default=(), help="scenes that Cycles is measured on anew"
    )
    parser.add_argument("--seeds", type=int, default=3, help="bakes to each error (default: 3)")
    arguments = parser.parse_args()
    unknown = {*arguments.parts} - {*PARTS} or {*arguments.scenes, *arguments.cycles} - {*NAMES}
    if unknown:
        parser.error(
            f"there is no {', '.join(sorted(unknown))}: parts are {', '.join(PARTS)}; scenes {', '.join(NAMES)}"
        )

    page.FOLDER.mkdir(exist_ok=True)
    file = page.FOLDER / f"{date.today().isoformat()}.json"
    results = json.loads(file.read_text()) if file.exists() else {}
    results["machine"] = describe()
    for part in arguments.parts or PARTS:
        before = load()
        results[part] = {**PARTS[part](arguments, results.get(part, {})), "load": [before, load()]}
        results = rounded(results)
        write_json(results, file)
    page.write(results)


def rounded(value):
    """A document with numbers of five digits that count."""
    if isinstance(value, dict):
        return {key: rounded(part) for key, part in value.items()}
    if isinstance(value, (list, tuple)):
        return [rounded(part) for part in value]
    return float(f"{value:.5g}") if isinstance(value, float) else value


if __name__ == "__main__":
    main()
