"""The two schedules, the two estimators of rows, the memory that rows may take, and the replay on more cells."""

from __future__ import annotations

import itertools
import json
import os
import resource
from dataclasses import replace

import numpy as np
import pytest

from cell_radiosity.core import host
from cell_radiosity.core.cells import LocalCells, make_cells
from cell_radiosity.core.contacts import cut_contacts
from cell_radiosity.core.experiment import convergence, convergence_table, experiment, law_of, replayed, table
from cell_radiosity.core.host import costliest_first
from cell_radiosity.core.kept import RayRows
from cell_radiosity.core.kernel import Kernel, scene_arrays
from cell_radiosity.core.lights import make_sources
from cell_radiosity.core.patches import draw_on_patches, make_patches
from cell_radiosity.core.replay import MessageCost, ReplayCells, SleepingCells, TaskTimes
from cell_radiosity.core.tasks import TASKS

from scenes import Lamp, Material, Settings, bake, box, icosphere, join_meshes, run, sheet

SETTINGS = Settings(patch_edge=None, error=0.05, row_rays=256, gather_rays=32)


def room(n=4):
    """A room with a block and a glowing part of the ceiling: all patches are polygons."""
    return join_meshes(
        [
            box(n=n, faces=("x", "X", "y", "Y", "z", "Z"), materials={"x": 1}),
            box("block", (0.3, 0.3, 0.2), (0.6, 0.7, 0.5), 2, False),
            sheet("lamp", [(0.4, 0.6, 0.8), (0.6, 0.6, 0.8), (0.6, 0.4, 0.8), (0.4, 0.4, 0.8)], 2, 2, 2),
        ],
        [Material("gray", (0.6, 0.6, 0.6)), Material("red", (0.6, 0.2, 0.2)), Material("lamp", (0, 0, 0), (9, 8, 7))],
    )


@pytest.fixture(scope="module")
def solved(cells):
    """{(schedule, rows): Bake} of the room."""
    return {
        (schedule, rows): run(bake(room(), replace(SETTINGS, schedule=schedule, rows=rows), cells))
        for schedule in ("paper", "dynamic")
        for rows in ("rays", "analytic")
    }


@pytest.mark.parametrize("rows", ["rays", "analytic"])
def test_both_schedules_reach_the_same_radiosity(solved, rows):
    """Within their bounds, and what direct light from sampled faces differs from faces that shoot through rows."""
    paper, dynamic = solved["paper", rows], solved["dynamic", rows]
    assert paper.solution.converged
    assert dynamic.solution.converged
    power = np.repeat(paper.patches.area, 2)
    first, second = ((power * b.solution.reflected).sum(axis=1) for b in (paper, dynamic))
    tolerance = paper.solution.bound + dynamic.solution.bound + 0.01
    np.testing.assert_allclose(first, second, rtol=tolerance)
    # The paper's method stops while light is still to come: it is below, never above, by what it says is missing.
    energy = paper.solution.energy
    assert energy["unshot_w"] > 0
    assert energy["emitted_w"] == pytest.approx(
        energy["absorbed_w"] + energy["escaped_w"] + energy["unshot_w"], rel=1e-12
    )


def test_dynamic_needs_each_row_once(solved):
    """Kept rows: no more shots than sides; plain shooting takes several times as many for the same bound."""
    dynamic, paper = solved["dynamic", "analytic"].solution, solved["paper", "analytic"].solution
    sides = 2 * len(solved["dynamic", "analytic"].patches)
    assert dynamic.rounds[-1].shots < sides
    assert paper.rounds[-1].shots > 3 * dynamic.rounds[-1].shots


def test_paper_shoots_as_many_patches_a_round_as_there_are_cells(cells, solved):
    rounds = solved["paper", "rays"].solution.rounds
    assert cells.count == 2
    assert all(r.shots == 2 * r.number for r in rounds)


def test_unshot_power_never_grows(solved):
    unshot = [r.unshot for r in solved["paper", "rays"].solution.rounds]
    assert all(b <= a * (1 + 1e-12) for a, b in itertools.pairwise(unshot))


def test_law_of_plain_shooting(cells):
    """Shots a decade between bounds of 10 % and 0.1 %, against the law of Southwell's iteration."""
    settings = replace(SETTINGS, schedule="paper", rows="rays", error=0.01)
    rounds = run(bake(room(), settings, cells)).solution.rounds
    first, last = (next(r.shots for r in rounds if r.bound <= level) for level in (0.1, 0.001))
    assert (last - first) / 2 == pytest.approx(law_of(room(), settings).shots_per_decade, rel=0.25)


def test_dynamic_converges_with_fewer_rows_than_sides():
    """To 10, 1 and 0.1 % of the bound: never more than the law's number of rows, and never fewer for a lower level."""
    settings = replace(SETTINGS, rows="analytic")
    law, aimed = law_of(room(3), settings), convergence(room(3), settings)
    shots = [reached[1] for reached in aimed.values()]
    assert shots == sorted(shots)
    assert 0 < shots[0] <= shots[-1] <= law.sides
    assert law.shots_per_decade > shots[-1]


def test_what_a_task_finds_does_not_depend_on_how_the_work_is_cut(cells):
    """Sides alone or in company, flat or bent or of several elements: the same bits."""
    lamp = Lamp("point", (0.1, 0.2, 0.9), (5.0, 5.0, 5.0), radius=0.05)
    block = box("block", (0.1, 0.1, 0.0), (0.33, 0.37, 0.9), 3, False)
    balls = [icosphere(f"ball {n}", 0.2, n, False) for n in (1, 3)]
    scene = join_meshes([box(n=7), block, *balls], [Material("white", (0.8, 0.8, 0.8))], [lamp])
    patches = make_patches(scene, 0.1 * scene.diagonal)
    assert patches.flatness.min() < 0.999
    sources, _ = make_sources(scene)
    local = LocalCells()
    local.start(scene_arrays(scene, patches, sources))
    patches = cut_contacts(scene, patches, local)
    assert np.diff(patches.element_start).max() > 1
    kernel = Kernel(scene_arrays(scene, patches, sources))
    a, b = np.random.default_rng(1).random((2, len(patches), 4))
    parts = [slice(k, k + 7) for k in range(0, len(patches), 7)]
    for whole, *cut in zip(
        *(draw_on_patches(patches, np.arange(len(patches))[s], a[s], b[s]) for s in (slice(None), *parts))
    ):
        cut = np.concatenate([np.broadcast_to(c, (len(c), *whole.shape[1:])) for c in cut])
        assert np.array_equal(whole, cut)
    sides = np.arange(2 * len(patches))
    for task, name, arguments in (
        (TASKS["direct"], "direct", dict(samples=4)), (TASKS["rows"], "hits", dict(rays=16))
    ):  # fmt: skip
        whole = task(kernel, sides=sides, seed=0, **arguments)[name]
        parts = [task(kernel, sides=sides[k : k + 7], seed=0, **arguments)[name] for k in range(0, len(sides), 7)]
        assert np.array_equal(whole, np.concatenate(parts, axis=-1 if name == "direct" else 0)), name


def test_costliest_rows_are_dealt_first(cells):
    """In the order dealt, analytic rows take less and less time, as far as what is known of patches tells."""
    scene = room(8)
    patches = make_patches(scene, None)
    settings = replace(SETTINGS, rows="analytic")
    sides = np.arange(0, 2 * len(patches), 2)
    ordered = costliest_first(sides, patches, settings)
    assert sorted(ordered) == sides.tolist()
    sources, _ = make_sources(scene)
    kernel = Kernel(scene_arrays(scene, patches, sources))
    rays = []
    for side in ordered:
        kernel.spent()
        TASKS["analytic"](kernel, sides=np.array([side]), seed=0)
        rays.append(kernel.spent()[1])
    half = len(rays) // 2
    assert np.mean(rays[:half]) > 1.05 * np.mean(rays[half:])
    assert np.corrcoef(rays, np.arange(len(rays)))[0, 1] < -0.3


def test_rows_that_do_not_fit_are_used_and_dropped(cells, monkeypatch):
    """With memory for a tenth of the rows, as of analytic ones, the solution is the same within the bounds, and memory is kept
    to; a finding says so."""
    scene = room(10)
    full = run(bake(scene, replace(SETTINGS, error=0.02), cells))
    monkeypatch.setattr(host, "make_rows", lambda count, own: RayRows(count, own.row_rays, 60 * (4 * 256 + 8)))
    tight = run(bake(scene, replace(SETTINGS, error=0.02), cells))
    assert tight.solution.rounds[-1].shots > 1.5 * full.solution.rounds[-1].shots
    assert len(tight.solution.rows.sides) == 60
    assert [f.object for f in tight.survey.health] == ["memory"]
    assert not full.survey.health
    # Sides without a row have what was shot at them, which is noisier than what they would gather.
    weight = np.repeat(full.patches.area, 2)
    first, second = (b.solution.irradiance for b in (full, tight))
    bounds = full.solution.bound + tight.solution.bound
    np.testing.assert_allclose((weight * first).sum(axis=1), (weight * second).sum(axis=1), rtol=bounds + 0.01)
    assert (weight * (first - second) ** 2).sum() < 0.1**2 * (weight * first**2).sum()
    energy = tight.solution.energy
    assert energy["emitted_w"] == pytest.approx(
        energy["absorbed_w"] + energy["escaped_w"] + energy["unshot_w"], rel=1e-9
    )


def test_analytic_rows_give_the_same_bits_for_any_number_of_cells(solved):
    settings = replace(SETTINGS, rows="analytic")
    for count in (1, 3):
        with make_cells(count) as cells:
            again = run(bake(room(), settings, cells))
        assert np.array_equal(again.light.indirect, solved["dynamic", "analytic"].light.indirect)


def test_a_cell_that_runs_out_of_memory_is_replaced():
    settings = Settings(gather_rays=256)
    scene = room(8)
    expected = run(bake(scene, settings, LocalCells()))
    with make_cells(2) as cells:
        run(bake(room(), replace(settings, gather_rays=1), cells))  # a cell keeps what memory a bake has taken
        limited = cells._cells[0].process.pid
        with open(f"/proc/{limited}/statm") as statm:
            used = int(statm.read().split()[0]) * resource.getpagesize()
        resource.prlimit(limited, resource.RLIMIT_AS, (used, used))
        result = run(bake(scene, replace(settings, seed=0), cells))
        assert result.cells["restarted"] >= 1
        assert limited not in [c.process.pid for c in cells._cells]
    assert np.array_equal(result.light.indirect, expected.light.indirect)


MESSAGE = MessageCost(1e-4, 3e-10, 1e-4)


SLOW = MessageCost(1e-4, 3e-10, 1e-4, 1e-7, in_turn=True)


@pytest.mark.parametrize("message", [MESSAGE, SLOW], ids=["all at once", "in turn"])
@pytest.mark.parametrize("schedule", ["dynamic", "paper"])
@pytest.mark.parametrize("count", [1, 2, 8, 64])
def test_replay_books_balance(count, schedule, message):
    """Work and losses of all cells add up to cells times seconds; the result is the bake's own."""
    settings = replace(SETTINGS, schedule=schedule, error=0.3)
    cells = ReplayCells(count, TaskTimes(), message)
    steps = bake(room(), settings, cells)
    next(steps)
    cells.open_books()
    result = run(steps)
    seconds = cells.close_books()
    assert cells.busy.sum() + sum(cells.lost.values()) == pytest.approx(count * seconds, rel=1e-6)
    assert all(lost >= 0 for lost in cells.lost.values())
    if schedule == "dynamic":
        assert np.array_equal(result.light.indirect, run(bake(room(), settings, LocalCells())).light.indirect)


class Given:
    """Stands in for TaskTimes: tasks take as long as they say and answer with as many bytes."""

    def start(self, arrays):
        return {name: float(array.sum()) for name, array in arrays.items()}

    def run(self, name, arguments):
        return {"answer": np.zeros(arguments.get("size", 0) // 8)}, arguments["seconds"], 1


def replay(count, rounds, message=MessageCost(0.0, 0.0, 0.0)):
    """Seconds and losses of rounds of tasks, each taken before the next is submitted. rounds: lists of seconds."""
    cells = ReplayCells(count, Given(), message)
    cells.open_books()
    for seconds in rounds:
        cells.take([cells.submit("given", seconds=s, size=80) for s in seconds])
    return cells.close_books(), cells.lost


def near(seconds):
    return pytest.approx(seconds, abs=0.5)  # the host's own work, which is real, takes milliseconds


@pytest.mark.parametrize(
    ("count", "rounds", "seconds", "few", "waiting"),
    [
        (4, [[100.0] * 8], 200, 0, 0),
        (4, [[100.0] * 9], 300, 0, 300),
        (4, [[100.0]], 100, 300, 0),
        (3, [[100.0, 40.0]], 100, 100, 60),
        (2, [[100.0, 300.0]] * 5, 1500, 0, 1000),
        (2, [[300.0, 100.0] * 2], 600, 0, 400),
        (2, [[300.0, 300.0, 100.0, 100.0]], 400, 0, 0),
        (64, [[100.0] * 64, [100.0] * 16], 200, 4800, 0),
    ],
    ids=[
        "even",
        "one too many",
        "one shooter",
        "few and uneven",
        "barrier",
        "badly dealt",
        "costliest first",
        "few at the end",
    ],
)
def test_replay_of_given_times(count, rounds, seconds, few, waiting):
    """Schedules that can be worked out by hand, and what the cells' time is lost to."""
    found, lost = replay(count, rounds)
    assert found == near(seconds)
    assert lost["too few shooters"] == near(few)
    assert lost["waiting"] == near(waiting)


def test_replay_of_many_times_the_points():
    """Each task at points stands for so many, once they are there; the host's work too; those of the control do not."""
    cells = ReplayCells(4, Given(), MessageCost(0.0, 0.0, 0.0), copies=6)

    def busy(name, seconds):
        before = cells.busy.sum()
        cells.take([cells.submit(name, seconds=s) for s in seconds])
        return cells.busy.sum() - before

    cells.open_books()
    assert busy("rows", [100.0, 100.0]) == near(200)
    cells.multiply()
    assert busy("gather", [100.0, 40.0]) == near(840)
    assert busy("control", [100.0]) == near(100)
    assert cells.usage.rays == 2 + 12 + 1


def test_replay_of_arrays_that_reach_one_cell_after_the_other():
    """The last of four cells has them after four times as long; all at once, as soon as the first. What is there already is
    not sent again."""
    for in_turn, seconds in ((False, 10.0), (True, 40.0)):
        cells = ReplayCells(4, Given(), MessageCost(0.0, 0.0, 0.0, 0.01, in_turn))
        cells.start({"patches.area": np.zeros(125)})
        cells.take([cells.submit("rows", seconds=1.0) for _ in range(4)])
        assert cells.clock == near(seconds + 1.0)
        cells.start({"patches.area": np.zeros(125), "patches.normal": np.ones(250)})
        cells.take([cells.submit("rows", seconds=1.0) for _ in range(4)])
        assert cells.clock == near(seconds + 1.0 + 2 * seconds + 1.0)


def test_replay_counts_messages():
    """On one cell: the host's share of every task, per byte of what it carries and brings, and the way there and back."""
    seconds, lost = replay(1, [[100.0]] * 10, MessageCost(2.0, 0.05, 3.0))
    assert seconds == near(10 * (100 + 2 + 96 * 0.05 + 2 * 3))
    assert lost["messages"] == near(10 * (2 + 96 * 0.05 + 2 * 3))


def test_sleeping_cells_answer_as_the_real_ones():
    """The processes that check the replay (`make bench-cells`): every task is waited for, and answered with its result."""
    scene, settings = room(), replace(SETTINGS, error=0.3)
    times = TaskTimes()
    cells = ReplayCells(3, times, MESSAGE)
    expected = run(bake(scene, settings, cells))
    with SleepingCells(3, times) as sleepers:
        for _ in range(2):  # looks them up, and knows them
            result = run(bake(scene, settings, sleepers))
            assert np.array_equal(result.light.indirect, expected.light.indirect)
            slept = sum(result.seconds[p] for p in ("survey", "transport", "gather"))
            assert slept > cells.busy.sum() / 3


def test_experiment_tells_all(tmp_path):
    runs = list(experiment(room(2), replace(SETTINGS, error=0.5), ("paper", "dynamic"), (1, 2), (1, 2, 16)))
    assert [(r.schedule, r.cells, r.kind) for r in runs] == [
        (s, n, k) for s in ("paper", "dynamic") for k, ns in (("measured", (1, 2)), ("replayed", (1, 2, 16))) for n in ns
    ]  # fmt: skip
    for r in runs:
        assert len(r.busy) == len(r.waiting) == r.cells
        assert r.rays > 0
        assert (r.lost is None) == (r.kind == "measured")
    lines = table(runs).splitlines()
    assert len(lines) == 1 + len(runs)
    told = convergence_table(runs, law_of(room(2), SETTINGS), None).splitlines()
    assert sum(line.startswith("paper") for line in told) == 3
    assert sum("replayed" in line for line in lines) == 6


def test_cells_command(tmp_path, capfd):
    pytest.importorskip("bpy")
    from cell_radiosity.addon.command import main

    scene = os.path.join(os.path.dirname(__file__), "..", "sample_scenes", "paper_973.blend")
    report, plot = tmp_path / "cells.json", tmp_path / "cells.png"
    code = main(["cells", scene, "--max-patch", "mesh", "--counts", "1", "--schedule", "dynamic", "--error", "10%",
                 "--report", str(report), "--plot", str(plot), "--quiet"])  # fmt: skip
    assert code == 0
    out = capfd.readouterr().out
    assert "replayed" in out
    assert "rounds / shots to" in out
    runs = json.loads(report.read_text())["runs"]
    assert max(r["cells"] for r in runs) == 1024
    assert plot.stat().st_size > 10_000


def test_paper_scenes_have_as_many_patches_as_the_papers():
    bpy = pytest.importorskip("bpy")
    from cell_radiosity.addon.read_scene import read_scene
    from cell_radiosity.core.patches import make_patches

    for count in (973, 1608):
        folder = os.path.join(os.path.dirname(__file__), "..", "sample_scenes")
        bpy.ops.wm.open_mainfile(filepath=os.path.join(folder, f"paper_{count}.blend"))
        assert len(make_patches(read_scene(bpy.context)[0])) == count


def test_points_that_count_many_times_change_no_schedule():
    """A replay of four times the points has more to gather, and the same transport and control."""
    settings = replace(SETTINGS, gather_rays=24)
    own, more = (replayed(room(), settings, 4, TaskTimes(), MESSAGE, copies) for copies in (1, 4))
    assert (own.rounds, own.shots) == (more.rounds, more.shots)
    assert own.rays < more.rays < 4 * own.rays


def test_command_replays_more_points(capfd):
    pytest.importorskip("bpy")
    from cell_radiosity.addon.command import main

    scene = os.path.join(os.path.dirname(__file__), "..", "sample_scenes", "paper_973.blend")
    command = [
        "cells",
        scene,
        "--max-patch",
        "mesh",
        "--counts",
        "1",
        "--schedule",
        "dynamic",
        "--error",
        "10%",
        "--quiet",
    ]
    assert main([*command, "--points", "1e5"]) == 0
    first = capfd.readouterr().out.splitlines()[0]
    points, own, copies = (int(word) for word in first.split() if word.isdigit())
    assert "output points" in first
    assert abs(points - 1e5) <= own / 2
    assert points == own * copies
    assert main([*command, "--points", "5"]) == 2
    assert "ask for more of them" in capfd.readouterr().err
