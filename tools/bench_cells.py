"""How well cells scale on this machine, and whether the replay tells the truth: `make bench-cells`.

Prints the speed-up of two cells over one (from the patches to the light, cells warm; the best of five runs each, taken in
turn) and the host's part in the CPU seconds; how much longer two workers of a Dask cluster take than two cells at 1 %; and
the replay's seconds beside those of real processes that sleep as long as the tasks were measured to take. Only a quiet
machine gives figures worth telling.
"""

from __future__ import annotations

import argparse
import os
from dataclasses import replace

import numpy as np

from cell_radiosity.cluster.cells import connect
from cell_radiosity.core.cells import make_cells
from cell_radiosity.core.experiment import replayed, timed
from cell_radiosity.core.replay import SleepingCells, TaskTimes, measure_messages
from cell_radiosity.core.settings import Settings

HALL = os.path.join(os.path.dirname(os.path.dirname(os.path.abspath(__file__))), "sample_scenes", "hall.blend")


def opened(file):
    """The Scene of a .blend."""
    # Here and not above: the processes of a cluster load this file anew, in a Python that may have no bpy.
    import bpy

    from cell_radiosity.addon.files import silent
    from cell_radiosity.addon.read_scene import read_scene

    with silent():
        bpy.ops.wm.open_mainfile(filepath=file)
    return read_scene(bpy.context)[0]


def speed_up(scene, settings, runs):
    """Prints the seconds of one and two cells, and the CPU seconds of the host."""
    with make_cells(1) as one, make_cells(2) as two:
        found = {one: [], two: []}
        for cells in found:
            timed(scene, settings, cells)  # warms them up
        for _ in range(runs):
            for cells, times in found.items():
                baked, seconds, busy = timed(scene, settings, cells)
                times.append(seconds)
        best = {cells.count: min(times) for cells, times in found.items()}
    host = baked.seconds["cpu"] - sum(busy)
    print(f"{baked.seconds['cpu']:.1f} CPU seconds, {host:.2f} of them the host's")
    print(
        f"best of {runs}: one cell {best[1]:.2f} s, two {best[2]:.2f} s; speed-up {best[1] / best[2]:.3f}", flush=True
    )


def against_workers(scene, runs):
    """Prints how much longer two workers of a Dask cluster take than two cells, and whether they find the same bits."""
    settings, ratios = Settings.for_error(0.01), []
    with make_cells(2) as cells, connect("local:2") as workers:
        for made in (cells, workers):
            timed(scene, settings, made)  # warms them up
        for _ in range(runs):
            (own, here, _), (theirs, there, _) = (timed(scene, settings, made) for made in (cells, workers))
            ratios.append(there / here)
    same = "the same" if np.array_equal(own.light.total, theirs.light.total) else "OTHER"
    print(f"two Dask workers over two cells at 1 %: {np.median(ratios):.3f}, median of {runs}; {same} bits", flush=True)


def check_replay(scene, settings, counts):
    """Prints the replay's seconds beside those of sleeping processes, the best of three."""
    times = TaskTimes()
    for count in counts:
        with make_cells(1) as one:
            message = measure_messages(one)
        expected = replayed(scene, settings, count, times, message)
        with SleepingCells(count, times) as cells:
            found = min([timed(scene, settings, cells)[1] for _ in range(4)][1:])  # the first is to look tasks up
        efficient = sum(expected.busy) / (count * expected.seconds)
        print(
            f"{count:3} cells: replayed {expected.seconds:.2f} s, slept {found:.2f} s, "
            f"{100 * (found / expected.seconds - 1):+.0f} %; busy {100 * efficient:.0f} %", flush=True
        )  # fmt: skip


def main():
    """Read the command line and measure."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("scene", nargs="?", default=HALL)
    parser.add_argument("--error", type=float, default=0.5, help="percent (default: 0.5)")
    parser.add_argument("--gather-rays", type=int, default=1536, help="of a point (default: 1536)")
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--counts", default="1,2,8,32,64", help="sleeping processes")
    arguments = parser.parse_args()
    scene = opened(arguments.scene)
    settings = replace(Settings.for_error(arguments.error / 100), gather_rays=arguments.gather_rays)
    speed_up(scene, settings, arguments.runs)
    against_workers(scene, arguments.runs)
    check_replay(scene, settings, [int(n) for n in arguments.counts.split(",")])


if __name__ == "__main__":
    main()
