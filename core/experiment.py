"""The paper's experiment: the time of a bake against the number of cells, measured as far as the machine goes and
replayed beyond.

The replay runs the same schedule code against task times measured on one cell; it is labeled as such everywhere.
Seconds are those from the patches to the light: transport, and all that is gathered and estimated, with the cells
running.
"""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import asdict, dataclass, replace
from math import log
from time import perf_counter

import numpy as np

from .bake import bake, run
from .cells import LocalCells, make_cells
from .host import make_rows, solve, submit_rows
from .kernel import scene_arrays
from .lights import make_sources
from .patches import make_patches, patch_size
from .points import make_points
from .records import to_arrays
from .replay import CAUSES, ReplayCells, TaskTimes, measure_messages
from .sky import split_sky
from .surfaces import make_surfaces

LEVELS = (0.1, 0.01, 0.001)  # of the bound, to which rounds and shots are counted


@dataclass(frozen=True)
class Run:
    """One bake of the experiment. kind: "measured" or "replayed". busy: (cells,) seconds each cell worked; waiting:
    (cells,) the rest. lost: {cause: seconds, mean over the cells} of a replay, None for a measured run.
    reached: {level: (rounds, shots)} until the bound was below a level."""

    schedule: str
    cells: int
    kind: str
    seconds: float
    rays: int
    rounds: int
    shots: int
    busy: tuple
    waiting: tuple
    lost: dict | None
    reached: dict


def experiment(scene, settings, schedules, counts, replays, joined=None, copies=1):
    """Bakes of a scene by `schedules` on `counts` cells, measured, and on `replays` cells, replayed: a generator that
    yields the Runs as they are done. joined: cells to measure, and messages to replay with, in place of processes.
    copies: as how many each output point counts in replays."""
    with nullcontext(joined) if joined else make_cells(1) as cells:
        message = measure_messages(cells)
    for schedule in schedules:
        chosen = replace(settings, schedule=schedule, rows="analytic" if schedule == "paper" else settings.rows)
        for count in counts:
            yield measured(scene, chosen, count, joined)
        times = TaskTimes()
        for count in replays:
            yield replayed(scene, chosen, count, times, message, copies)


def measured(scene, settings, count, cells=None):
    """The Run of a bake on `count` process cells, after a first one that warms them up."""
    made = cells or make_cells(count)
    try:
        if settings.schedule == "dynamic":
            timed(scene, settings, made)
        result, seconds, busy = timed(scene, settings, made)
    finally:
        if cells is None:
            made.stop()
    return _run(result, count, "measured", seconds, busy, None)


def timed(scene, settings, cells):
    """A Bake by some cells, its seconds, and those that each process has worked."""
    before = []
    result = _drive(bake(scene, settings, cells), lambda: before.append((perf_counter(), dict(cells.usage.busy))))
    begun, worked = before[-1]
    busy = [seconds - worked.get(cell, 0.0) for cell, seconds in cells.usage.busy.items()]
    return result, perf_counter() - begun, busy


def replayed(scene, settings, count, times, message, copies=1):
    """The Run of a bake on `count` cells that are not there. times: TaskTimes, shared by replays of one scene. copies: as
    how many each output point counts: its tasks are dealt so often, and the host works so long."""
    cells = ReplayCells(count, times, message, copies)

    def place(scene, flipped, cells, *_):
        cells.multiply()
        points = make_points(scene, flipped, cells)
        return scene, points, to_arrays("points", points)
        yield

    result = _drive(bake(scene, settings, cells, place if copies > 1 else None), cells.open_books)
    seconds = cells.close_books()
    return _run(result, count, "replayed", seconds, cells.busy, {c: cells.lost[c] / count for c in CAUSES})


@dataclass(frozen=True)
class Law:
    """What theory says of shooting: sides, the number N of patch sides that light reaches and that reflect it, which is
    how many rows are all there is to know; and the shots that plain shooting needs for each decade of the error,
    N ln 10 / (2 ln (1 / l)), l the spectral radius of reflectance times form factors (None where nothing reflects).

    Source: the convergence of Southwell's iteration. K shots at a time need 1 + K / N times as many.
    """

    sides: int
    shots_per_decade: float | None


def law_of(scene, settings):
    """The Law of a scene, by power iteration over ray rows and not by trial."""
    patches, surfaces, _, cells = _ground(scene, settings)
    sides = np.arange(2 * len(patches))
    ray_settings = replace(settings, rows="rays", row_rays=256)
    rows = make_rows(len(sides), ray_settings)
    rows.add(sides, cells.take(submit_rows(cells, sides, ray_settings)))
    light, growth = np.ones((len(surfaces.found), len(sides))), 0.0
    for _ in range(60):
        arriving = rows.gather(surfaces.send(light), np.zeros(len(light)))
        growth = arriving.sum() / light.sum()
        light = arriving / growth if growth > 0 else light
    lit = int(((light.sum(axis=0) > 0) & (surfaces.returned.sum(axis=0) > 0)).sum())
    return Law(lit, lit * log(10) / (2 * log(1 / growth)) if 0 < growth < 1 else None)


def convergence(scene, settings):
    """{level: (rounds, shots)} that the dynamic schedule takes to bring the bound below each of LEVELS, when it aims at
    it: it solves over its rows at the end, so a run to one level says nothing of those on the way. None if it fails."""
    patches, surfaces, sky, cells = _ground(scene, settings)
    found = {}
    for level in LEVELS:
        solution = run(solve(patches, surfaces, sky, cells, replace(settings, error=10 * level)))
        last = solution.rounds[-1]
        found[str(level)] = (last.number, last.shots) if solution.bound <= level else None
    return found


def _ground(scene, settings):
    """What a solve starts from: Patches, Surfaces, the sky and cells in this process."""
    patches = make_patches(scene, *patch_size(scene, settings))
    sources, sampled = make_sources(scene)
    cells = LocalCells()
    sky, _ = split_sky(scene.world)
    cells.start(scene_arrays(scene, patches, sources, len(sky)))
    return patches, make_surfaces(scene, patches, sampled), np.pi * sky.T, cells


def table(runs):
    """The Runs as lines of text."""
    lines = [
        f"{'schedule':9}{'cells':>6} {'kind':9}{'seconds':>9}{'speed-up':>9}{'busy':>7}{'rounds':>8}{'shots':>9}  lost to"
    ]
    alone = {(r.schedule, r.kind): r.seconds for r in runs if r.cells == 1}
    for r in runs:
        speed = alone.get((r.schedule, r.kind), float("nan")) / r.seconds
        lost = ", ".join(f"{c} {100 * s / r.seconds:.0f} %" for c, s in (r.lost or {}).items() if s > 0.005 * r.seconds)
        share = 100 * sum(r.busy) / (r.cells * r.seconds)
        lines.append(
            f"{r.schedule:9}{r.cells:6} {r.kind:9}{r.seconds:9.2f}{speed:9.2f}{share:6.0f}%{r.rounds:8}{r.shots:9}  {lost}"
        )
    return "\n".join(lines)


def convergence_table(runs, law, aimed):
    """Lines that say after how many rounds and shots the bound was below each of LEVELS, beside the Law: of the runs of
    the paper's schedule, by cells, and of the dynamic one as `convergence` has it."""

    def line(name, cells, values, theory=""):
        return f"{name:18}{cells:>6}" + "".join(f"{v:>17}" for v in values) + f"  {theory}"

    def both(reached):
        return "-" if reached is None else f"{reached[0]} / {reached[1]}"

    lines = [line("rounds / shots to", "cells", [f"{100 * level:g} %" for level in LEVELS], "by law")]
    paper = {r.cells: r for r in runs if r.schedule == "paper"}
    alone = paper.get(1)
    for count, r in sorted(paper.items()):
        first = alone.reached[str(LEVELS[-1])] if alone else None
        theory = f"{first[1] * (1 + count / law.sides):.0f} shots" if first and count > 1 else ""
        lines.append(line("paper", count, [both(r.reached[str(level)]) for level in LEVELS], theory))
    if law.shots_per_decade:
        lines.append(
            line("  from level to level", "", ["", *[f"+ {law.shots_per_decade:.0f}"] * (len(LEVELS) - 1)], "")
        )
    if aimed:
        values = [both(aimed[str(level)]) for level in LEVELS]
        lines.append(line("dynamic", "any", values, f"{law.sides} rows are all there is to know"))
    return "\n".join(lines)


def as_dictionary(scene, runs, law, aimed, points=None):
    """The experiment as one document for JSON. points: that the replays stand for, None for the scene's own."""
    runs = [asdict(r) for r in runs]
    return {"scene": scene, "law": asdict(law), "convergence": aimed, "replayed_points": points, "runs": runs}


def _drive(generator, at_transport):
    """Run a bake, and call `at_transport` when its patches are made."""
    while True:
        try:
            progress = next(generator)
        except StopIteration as end:
            return end.value
        if progress.phase == "patches":
            at_transport()


def _run(result, count, kind, seconds, busy, lost):
    busy = [*busy, *[0.0] * (count - len(busy))]
    rounds = result.solution.rounds
    reached = {}
    for level in LEVELS:
        found = next((r for r in rounds if r.bound <= level), None)
        reached[str(level)] = (found.number, found.shots) if found else None
    return Run(
        schedule=result.settings.schedule,
        cells=count,
        kind=kind,
        seconds=float(seconds),
        rays=result.rays,
        rounds=len(rounds),
        shots=rounds[-1].shots if rounds else 0,
        busy=tuple(float(b) for b in busy),
        waiting=tuple(float(max(seconds - b, 0.0)) for b in busy),
        lost=lost,
        reached=reached,
    )
