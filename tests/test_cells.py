"""Cells: the same bits however many there are, and whatever happens to them."""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

from cell_radiosity.core.cells import APART, CellError, LocalCells, _packed, _Process, make_cells, unpacked

from scenes import Lamp, Material, Settings, World, bake, box, icosphere, join_meshes, run

SETTINGS = Settings(gather_rays=64, row_rays=16, patch_edge=1 / 20)


def furnished(n=6):
    """A colored room with a block, a ball, two lamps and an emitting ceiling."""
    materials = [Material("w", (0.7, 0.7, 0.7)), Material("r", (0.6, 0.1, 0.1)), Material("e", (0, 0, 0), (2, 2, 1))]
    return join_meshes(
        [
            box(n=n, materials={"x": 1, "Z": 2}),
            box("block", (0.2, 0.2, 0.0), (0.5, 0.5, 0.4), 3, False),
            icosphere("ball", 0.15, 2, False),
        ],
        materials,
        [Lamp("point", (0.2, 0.3, 0.4), (0.8, 0.7, 0.8), radius=0.05), Lamp("point", (0.5, 0.2, 0.2), (0.2, 0.8, 0.3))],
        World((0.1, 0.1, 0.2)),
    )


def same(a, b):
    """Whether two bakes have the same light, and the same estimate of its error, to which rays go."""
    light = np.array_equal(a.light.direct, b.light.direct) and np.array_equal(a.light.indirect, b.light.indirect)
    return light and a.estimate.total == b.estimate.total > 0


@pytest.fixture(scope="module")
def expected():
    return run(bake(furnished(), SETTINGS, LocalCells()))


@pytest.mark.parametrize("count", [1, 2, 3])
def test_any_number_of_cells_gives_the_same_bits(expected, count):
    with make_cells(count) as cells:
        assert cells.count == count
        assert not cells.note
        result = run(bake(furnished(), SETTINGS, cells))
    assert same(result, expected)
    # Points of a task share what is cast for their neighbors; how large tasks are goes by how many cells there are.
    assert result.rays == pytest.approx(expected.rays, rel=0.2)


def test_as_many_cells_as_there_is_work_for_give_the_same_bits(expected):
    class Many(LocalCells):
        """Cells that say how many they are."""

        def __init__(self):
            super().__init__()
            self.count = 64

    assert same(run(bake(furnished(), SETTINGS, Many())), expected)


def test_arrays_of_any_kind_pass_a_pipe_whole(rng):
    """Large ones, which are sent without a copy, and small, empty, strided and transposed ones; the receiver's are its own."""
    large = rng.random((300, 1000))
    sent = {
        "large": large, "small": large[0, :3].copy(), "empty": np.zeros((0, 3)), "strided": large[::2, ::3],
        "transposed": large.T, "fixed": np.broadcast_to(large[0], (200, 1000)), "bool": large > 0.5,
    }  # fmt: skip
    here, there = multiprocessing.Pipe()
    message = _packed(("arrays", sent), APART)
    assert sum(isinstance(part, memoryview) for part in message) == 3
    writer = threading.Thread(target=lambda: [here.send_bytes(part) for part in message])
    writer.start()
    kind, found = unpacked(there)
    writer.join()
    assert kind == "arrays"
    assert found.keys() == sent.keys()
    for name, array in sent.items():
        assert found[name].dtype == array.dtype
        assert np.array_equal(found[name], array)
    found["large"][:] = 0
    assert large.any()


BUSY = Settings(gather_rays=512, patch_edge=1 / 30)  # with these, cells have work for a while in every phase


@pytest.fixture(scope="module")
def expected_busy():
    return run(bake(furnished(12), BUSY, LocalCells()))


def strike(cells, phase, blow):
    """A function that is shown the progress of a bake and calls `blow(cell)` for chosen cells, once, in a phase."""
    struck = []

    def show(progress):
        if progress.phase == phase and not struck:
            struck.extend(blow(cells))

    return show, struck


def kill(number):
    """A blow: kill -9 of the first `number` cells; returns their process ids."""

    def blow(cells):
        pids = [cell.process.pid for cell in cells._cells[:number]]
        for pid in pids:
            os.kill(pid, signal.SIGKILL)
        return pids

    return blow


@pytest.mark.parametrize("phase", ["patches", "transport", "gather"])
@pytest.mark.parametrize("victims", [1, 2])
def test_killed_cells_are_replaced(expected_busy, phase, victims):
    """kill -9 of one cell or of all, while they have work: the same bits, and the count tells."""
    with make_cells(2) as cells:
        show, struck = strike(cells, phase, kill(victims))
        result = run(bake(furnished(12), BUSY, cells), show)
        assert len(struck) == victims
    assert same(result, expected_busy)
    assert result.cells["restarted"] == victims


@pytest.mark.parametrize("victims", [1, 2])
def test_cells_killed_at_the_start_are_replaced(expected, victims):
    """Before the first of them has said a word: while Python itself still starts there."""
    with make_cells(2) as cells:
        kill(victims)(cells)
        result = run(bake(furnished(), SETTINGS, cells))
    assert same(result, expected)
    assert result.cells["restarted"] == victims


def test_a_cell_killed_again_after_its_restart_is_replaced_again(expected_busy):
    with make_cells(2) as cells:
        blows = [strike(cells, phase, kill(1)) for phase in ("patches", "transport", "gather")]
        result = run(bake(furnished(12), BUSY, cells), lambda progress: [show(progress) for show, _ in blows])
        struck = [pid for _, pids in blows for pid in pids]
    assert len(set(struck)) == 3
    assert same(result, expected_busy)
    assert result.cells["restarted"] == 3


@pytest.mark.parametrize(("left", "phase"), [(1, "patches"), (1, "gather"), (0, "transport"), (0, "gather")])
def test_cells_that_must_not_work_end_in_the_middle_and_come_back(expected, expected_busy, left, phase):
    """What they had is dealt again; where none is left this process does it."""
    with make_cells(3) as cells:
        pids = [cell.process.pid for cell in cells._cells]

        def limit(cells):
            cells.limit(left)
            return pids[left:]

        cells_within = "cell_radiosity.core.course.cells_within"
        with pytest.MonkeyPatch.context() as patch:
            show, ended = strike(cells, phase, limit)
            patch.setattr(cells_within, lambda *_, **__: left if ended else 3)
            result = run(bake(furnished(12), BUSY, cells), show)
        assert len(ended) == 3 - left
        assert same(result, expected_busy)
        assert result.cells["restarted"] == 0
        assert (result.cells["count"], len(cells._cells)) == (1, left)
        assert f"only {left} of 3 cells fit" in cells.note
        assert any(f.action == cells.note or cells.note in str(f) for f in result.survey.health)
        assert not any(alive(pid) for pid in ended)
        cells.limit(7)
        assert (cells.count, len(cells._cells), cells.note) == (3, 3, "")
        assert same(run(bake(furnished(), SETTINGS, cells)), expected)


@pytest.mark.parametrize("phase", ["transport", "gather"])
def test_a_cell_that_stops_answering_is_replaced(expected_busy, phase, monkeypatch):
    """SIGSTOP: it is alive and its pipe is open, but no sign of life comes."""

    def stop(cells):
        monkeypatch.setattr("cell_radiosity.core.cells.PATIENCE", 4.0)  # not sooner: cells need time to start
        os.kill(cells._cells[1].process.pid, signal.SIGSTOP)
        return [cells._cells[1].process.pid]

    with make_cells(2) as cells:
        show, struck = strike(cells, phase, stop)
        result = run(bake(furnished(12), BUSY, cells), show)
    assert same(result, expected_busy)
    assert result.cells["restarted"] == len(struck) == 1
    assert not alive(struck[0])


@pytest.mark.parametrize("allowed", [0, 1])
def test_where_processes_are_refused_fewer_do_the_work(expected, monkeypatch, allowed):
    """As policies and virus scanners have it: without one process the work is done here; one does it alone."""
    started = []

    def start(index, real=_Process):
        if len(started) == allowed:
            raise PermissionError(1, "Operation not permitted")
        started.append(real(index))
        return started[-1]

    monkeypatch.setattr("cell_radiosity.core.cells._Process", start)
    with make_cells(2) as cells:
        assert isinstance(cells, LocalCells) == (not allowed)
        assert cells.count == 1
        result = run(bake(furnished(), SETTINGS, cells))
    assert same(result, expected)
    assert any(f.object == "cells" and "not permitted" in f"{f.finding} {f.action}" for f in result.survey.health)


def test_without_a_python_the_work_is_done_here(expected, monkeypatch):
    monkeypatch.setattr(sys, "executable", "")
    with make_cells(2) as cells:
        assert isinstance(cells, LocalCells)
        result = run(bake(furnished(), SETTINGS, cells))
    assert same(result, expected)
    assert any(f.object == "cells" for f in result.survey.health)


def test_cells_that_keep_dying_end_in_this_process(expected, monkeypatch):
    with make_cells(2) as cells:
        for cell in cells._cells:
            cell.process.kill()
        monkeypatch.setattr(
            "cell_radiosity.core.cells._Process", lambda index: (_ for _ in ()).throw(OSError("no more"))
        )
        result = run(bake(furnished(), SETTINGS, cells))
    assert same(result, expected)
    assert "no more" in cells.note


def test_an_error_in_a_task_reaches_the_host(cells):
    small = run(bake(furnished(2), SETTINGS, cells))
    cells.submit("rows", sides=np.array([10**9]), rays=4, seed=0)
    with pytest.raises(CellError, match="IndexError"):
        list(cells.results())
    cells.clear()
    assert same(run(bake(furnished(2), SETTINGS, cells)), small)


def test_a_bake_that_is_given_up_leaves_no_trace(cells, expected):
    """Its tasks are dropped, and the next bake with the same cells is what it would have been."""
    steps = bake(furnished(12), Settings(gather_rays=2048), cells)
    while next(steps).phase != "gather":
        pass
    steps.close()
    assert same(run(bake(furnished(), SETTINGS, cells)), expected)


HOST = """
import sys, time
sys.path.insert(0, {tests!r})
from test_cells import furnished
from scenes import Settings, bake
from cell_radiosity.core.cells import make_cells
cells = make_cells(2)
steps = bake(furnished(12), Settings(gather_rays=4096), cells)
for progress in steps:
    if progress.phase == "gather":
        print(*[c.process.pid for c in cells._cells], flush=True)
        {end}
"""
ENDS = {
    "killed": "time.sleep(60)",
    "exit": "sys.exit(0)",
    "exception": "raise RuntimeError('as if')",
    "crash": "import ctypes; ctypes.string_at(0)",
}


@pytest.mark.parametrize("end", ENDS)
def test_no_cell_outlives_its_host(end):
    shared = shared_memory()
    code = HOST.format(tests=os.path.dirname(__file__), end=ENDS[end])
    host = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    pids = [int(word) for word in host.stdout.readline().split()]
    assert len(pids) == 2
    assert all(alive(pid) for pid in pids) or end != "killed"
    if end == "killed":
        host.kill()
    host.wait()
    deadline = time.monotonic() + 5
    while any(alive(pid) for pid in pids) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not any(alive(pid) for pid in pids)
    assert shared_memory() <= shared


def shared_memory():
    """Names of the shared memory blocks of this machine."""
    return set(os.listdir("/dev/shm")) if os.path.isdir("/dev/shm") else set()


def alive(pid):
    try:
        with open(f"/proc/{pid}/stat") as stat:
            return stat.read().rsplit(")", 1)[1].split()[0] not in "ZX"
    except OSError:
        return False


def test_a_dead_cell_does_not_end_a_host_that_has_sigpipe_at_its_default():
    """Some Blenders leave SIGPIPE at its default: a write to a dead cell would end the whole program."""
    code = (
        "import signal; signal.signal(signal.SIGPIPE, signal.SIG_DFL)\n"
        f"import sys; sys.path.insert(0, {os.path.dirname(__file__)!r})\n"
        "from test_cells import furnished, SETTINGS\n"
        "from scenes import bake, run\n"
        "from cell_radiosity.core.cells import make_cells\n"
        "cells = make_cells(2)\n"
        "for c in cells._cells: c.process.kill(); c.process.join()\n"
        "result = run(bake(furnished(2), SETTINGS, cells)); cells.stop()\n"
        "print('restarted', result.cells['restarted'])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "restarted 2"


def test_a_flow_makes_arguments_no_sooner_than_cells_need_them():
    """Results come in order; of hundreds of tasks only a few have been made when the first results are there."""
    with make_cells(2) as cells:
        made = 0

        def each():
            nonlocal made
            for number in range(300):
                made += 1
                yield dict(seconds=0.0, sizes=np.array([number]))

        for number, result in enumerate(cells.flow("wait", each())):
            assert len(result["0"]) == number
            assert made <= min(number + cells.flow_each * cells.count + 1, 300)
        assert made == number + 1 == 300
        assert list(cells.flow("wait", [])) == []
