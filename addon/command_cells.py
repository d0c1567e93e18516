"""`radiosity cells`: the paper's experiment, time against the number of cells."""

from __future__ import annotations

import argparse
import os
import sys
from contextlib import nullcontext

from ..core.experiment import as_dictionary, convergence, convergence_table, experiment, law_of, table
from ..core.health import mend
from ..core.points import make_points
from ..core.report import write_json
from ..core.settings import SCHEDULES
from .arguments import add_scene_options, count, make_options, points
from .cluster import add_cluster_options, cells_for
from .errors import Usage
from .files import context_of, silent
from .job import check_scene, default_cells, wanted_by
from .plots import check_plot, plot_cells
from .progress import answer, say
from .read_scene import read_scene
from .scene_command import add_scene_file, exit_code, open_scene


def add(commands):
    """Add the command's parser to `commands`."""
    cells = commands.add_parser(
        "cells", help="time against cells",
        description="The paper's experiment: time against the number of cells, measured on this machine's cores and "
        "replayed beyond them.",
    )  # fmt: skip
    cells.set_defaults(run=run_cells)
    add_scene_file(cells)
    cells.add_argument("--counts", type=_counts, metavar="1,2,4", help="cells to measure (default: 1 up to the cores)")
    cells.add_argument("--schedule", type=_schedules, default=SCHEDULES, metavar="paper,dynamic", help="default: both")
    cells.add_argument(
        "--points",
        type=points,
        metavar="1e7",
        help="replay as if the scene had so many output points (default: its own)",
    )
    cells.add_argument("--report", metavar="R.json", help="write all figures")
    cells.add_argument("--plot", metavar="P.png", help="draw speed-up and losses")
    add_cluster_options(cells)
    add_scene_options(cells)


@exit_code
def run_cells(arguments):
    """Measure and replay a scene on many cells."""
    if arguments.cluster and arguments.counts:
        raise Usage("--counts is for this machine's cells; a cluster is measured as it is")
    if arguments.plot:
        check_plot(arguments.plot)
    source = open_scene(arguments, arguments.report, arguments.plot)
    with silent():
        scene, targets = read_scene(context_of(arguments), wanted_by(arguments.objects))
    options, scene = make_options(arguments), mend(scene)
    check_scene(scene, targets, options)
    settings, own = options.settings(scene), len(make_points(scene))
    copies = round((arguments.points or own) / own)
    if copies < 1:
        raise Usage(f"--points {arguments.points}: the scene has {own} already; ask for more of them")
    replayed = copies * own if arguments.points else None
    with cells_for(arguments) if arguments.cluster else nullcontext() as joined:
        cores = joined.count if joined else default_cells()
        counts = arguments.counts or tuple(n for n in (1, 2, 4, 8, 16, 32, 64) if n < cores and not joined) + (cores,)
        replays = tuple(sorted({*counts, *(2**k for k in range(11))}))
        runs = []
        for run in experiment(scene, settings, arguments.schedule, counts, replays, joined, copies):
            runs.append(run)
            if not arguments.quiet:
                say(f"{run.schedule}, {run.cells} cells, {run.kind}: {run.seconds:.2f} s", to=sys.stderr)
    if replayed:
        say(f"replayed for {replayed} output points: what is done at one of {own} counts {copies} times")
    answer(*table(runs).splitlines(), elsewhere=arguments.report)
    law = law_of(scene, settings)
    aimed = convergence(scene, settings) if "dynamic" in arguments.schedule else None
    answer(*convergence_table(runs, law, aimed).splitlines(), elsewhere=arguments.report)
    if arguments.report:
        write_json(as_dictionary(source, runs, law, aimed, replayed), os.path.abspath(arguments.report))
    if arguments.plot:
        plot_cells(runs, os.path.abspath(arguments.plot), os.path.basename(source))


def _counts(text):
    return tuple(dict.fromkeys(count(part) for part in text.split(",")))


def _schedules(text):
    names = tuple(dict.fromkeys(text.split(",")))
    if unknown := [name for name in names if name not in SCHEDULES]:
        raise argparse.ArgumentTypeError(f"{', '.join(unknown)}: schedules are {', '.join(SCHEDULES)}")
    return names
