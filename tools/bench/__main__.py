"""Measure how fast bakes are: `make bench`, or python -m tools.bench [PART ...].

Writes docs/bench: a dated JSON with all figures, a page of tables, plots; and the table in the README. Parts that are not
named keep the figures they have in today's file.
"""

from __future__ import annotations

import argparse
import json
from datetime import date

from cell_radiosity.addon.job import default_cells
from cell_radiosity.core.cells import make_cells
from cell_radiosity.core.report import write_json

from . import cycles as cycles_bakes
from . import errors, page
from .machine import describe, hall_loop, load
from .scenes import NAMES


def measure_errors(arguments):
    """Error and CPU seconds of our bakes beside Cycles'."""
    cycles = cycles_bakes.figures(arguments.scenes, arguments.cycles)
    bare, scenes = hall_loop(), {}
    rates = [bare()]
    with make_cells(default_cells()) as cells:
        for name in arguments.scenes:
            scenes[name] = errors.bakes_of(name, cells, arguments.seeds)
            rates.append(bare())
    rate = sorted(rates)[len(rates) // 2]
    for name, scene in scenes.items():
        scene["against_cycles"] = errors.compared(scene, cycles[name], rate)
    return {"rate": rate, "rates": rates, "seeds": arguments.seeds, "scenes": scenes}


PARTS = {"errors": measure_errors}


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
        results[part] = {**PARTS[part](arguments), "load": [before, load()]}
        write_json(results, file)
    page.write(results)


if __name__ == "__main__":
    main()
