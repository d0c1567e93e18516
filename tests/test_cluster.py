"""Cells on a cluster: the same bits, whatever happens to its workers; clear words when it is gone."""

from __future__ import annotations

import json
import os
import re
import shlex
import signal
import socket
import subprocess
import sys
import textwrap
import time
from itertools import pairwise
from pathlib import Path

import dask
import numpy as np
import pytest
from test_cells import BUSY, alive, expected_busy, furnished, same
from test_state import Counted, Counting

from cell_radiosity.cluster import cells as cluster_cells
from cell_radiosity.cluster.cells import ClusterError, connect
from cell_radiosity.core.state import load_state, save_state

from scenes import bake, run

__all__ = ["expected_busy"]


@pytest.fixture(scope="module")
def cluster():
    """Two workers of this machine. They are killed again and again, which Dask would take for the end of them."""
    with dask.config.set({"distributed.deploy.lost-worker-timeout": "1h"}), connect("local:2") as made:
        yield made


def workers(cells):
    """{address: process id} of the workers."""
    return cells._client.run(os.getpid, on_error="ignore")


def settled(cells, count=2):
    """Wait until there are `count` workers again."""
    deadline = time.monotonic() + 30
    while len([pid for pid in workers(cells).values() if alive(pid)]) != count:
        assert time.monotonic() < deadline
        time.sleep(0.2)
    cells._find_workers()


def once(phase, blow):
    """What to show the progress of a bake to: strikes once, in a phase."""
    struck = []

    def show(progress):
        if progress.phase == phase and not struck:
            struck.append(True)
            blow()

    return show, struck


def test_the_same_bits_as_other_cells(cluster, expected_busy):
    result = run(bake(furnished(12), BUSY, cluster))
    assert same(result, expected_busy)
    assert result.rays == pytest.approx(expected_busy.rays, rel=0.2)
    assert result.cells["count"] == 2
    assert len(result.cells["cells_mb"]) >= 2
    assert not cluster.note


def test_workers_started_here_keep_memory(cluster):
    """What makes them give it back at once is Dask's usual way, which is not changed for others."""
    name = "MALLOC_TRIM_THRESHOLD_"
    there = cluster._client.run(lambda: os.environ.get(name)).values()
    assert list(there) == [os.environ.get(name)] * 2
    assert dask.config.get("distributed.nanny.pre-spawn-environ")[name]


def test_many_tasks_travel_together(cluster, monkeypatch):
    sent = []
    monkeypatch.setattr(
        cluster_cells, "_Batch", lambda tasks, real=cluster_cells._Batch: sent.append(tasks) or real(tasks)
    )
    run(bake(furnished(12), BUSY, cluster))
    tasks = sum(len(batch) for batch in sent)
    assert len(sent) < 0.9 * tasks


def test_arrays_are_sent_once(cluster, monkeypatch):
    """A second bake of the same scene finds it there; only what is new is sent."""
    sent, real = [], cluster._ask

    def ask(address, function, *arguments):
        if function is cluster_cells.keep:
            sent.extend(arguments[0])
        return real(address, function, *arguments)

    monkeypatch.setattr(cluster, "_ask", ask)
    run(bake(furnished(4), BUSY, cluster))
    first = len(sent)
    assert first > 0
    run(bake(furnished(4), BUSY, cluster))
    assert len(sent) - first < first / 2


@pytest.mark.parametrize(("victims", "phase"), [(1, "patches"), (1, "gather"), (2, "transport"), (2, "gather")])
def test_killed_workers_cost_nothing_but_time(cluster, expected_busy, victims, phase):
    settled(cluster)
    before = cluster.restarted

    def kill():
        for pid in list(workers(cluster).values())[:victims]:
            os.kill(pid, signal.SIGKILL)

    show, struck = once(phase, kill)
    result = run(bake(furnished(12), BUSY, cluster), show)
    assert struck
    assert same(result, expected_busy)
    settled(cluster)
    assert cluster.restarted - before == victims


def test_a_worker_that_hangs_is_worked_around(cluster, expected_busy, monkeypatch):
    monkeypatch.setattr(cluster_cells, "PATIENCE", 2.0)
    settled(cluster)
    before, pid = cluster.restarted, next(iter(workers(cluster).values()))
    show, struck = once("transport", lambda: os.kill(pid, signal.SIGSTOP))
    try:
        result = run(bake(furnished(12), BUSY, cluster), show)
    finally:
        os.kill(pid, signal.SIGKILL)
    assert struck
    assert same(result, expected_busy)
    assert cluster.restarted > before
    settled(cluster)


def test_a_worker_that_joins_gets_the_scene_and_work(cluster, expected_busy):
    settled(cluster)
    before = set(workers(cluster))

    def join():
        cluster._started.scale(3)
        cluster._client.wait_for_workers(3, timeout=30)

    show, _ = once("transport", join)
    result = run(bake(furnished(12), BUSY, cluster), show)
    assert same(result, expected_busy)
    (joined,) = set(workers(cluster)) - before
    worked = {address for address, _ in cluster.usage.busy}
    cluster._started.scale(2)
    assert joined in worked


def test_workers_that_are_not_what_the_host_is(cluster, monkeypatch):
    mine = cluster_cells.identity()
    monkeypatch.setattr(cluster_cells.DaskCells, "_identity", staticmethod(lambda: {**mine, "numpy": "0.1"}))
    address = cluster._started.scheduler_address
    with pytest.raises(ClusterError, match=r"numpy .*here 0\.1.*--allow-mixed"):
        connect(address)
    with connect(address, allow_mixed=True) as mixed:
        result = run(bake(furnished(2), BUSY, mixed))
    assert any("last bits" in f.action for f in result.survey.health)
    assert workers(cluster)  # a cluster that was there before is left as it was


def test_no_scheduler_there(monkeypatch):
    monkeypatch.setattr(cluster_cells, "ANSWER", 2.0)
    with pytest.raises(ClusterError, match="no scheduler answers"):
        connect("tcp://127.0.0.1:1")
    with pytest.raises(ClusterError, match="local:N"):
        connect("local:none")


def start(tmp_path, *words):
    return subprocess.Popen([sys.executable, "-m", "distributed.cli." + words[0], *words[1:]], cwd=tmp_path,
                            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)  # fmt: skip


@pytest.fixture
def lonely(tmp_path):
    """A cluster of a scheduler and one worker: its address, and {what: process}."""
    file = tmp_path / "scheduler.json"
    processes = {
        "scheduler": start(tmp_path, "dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard",
                          "--scheduler-file", str(file)),
    }  # fmt: skip
    try:
        processes["worker"] = start(tmp_path, "dask_worker", "--scheduler-file", str(file), "--nthreads", "1",
                                   "--no-nanny", "--no-dashboard", "--host", "127.0.0.1")  # fmt: skip
        deadline = time.monotonic() + 30
        while not file.exists() or not file.read_text().strip():
            assert time.monotonic() < deadline
            time.sleep(0.1)
        yield json.loads(file.read_text())["address"], processes
    finally:
        for process in processes.values():
            process.kill()
            process.wait()


class CountedDask(Counted, cluster_cells.DaskCells):
    """Cells on a cluster that know what they have traced."""


@pytest.fixture(scope="module")
def counted():
    """What a whole bake traces."""
    whole = Counting()
    run(bake(furnished(12), BUSY, whole))
    return whole.traced


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("victim", "words", "phase"),
    [("scheduler", "scheduler of the cluster is gone", "transport"), ("worker", "no worker", "gather")],
)
def test_a_cluster_that_is_lost(lonely, tmp_path, monkeypatch, expected_busy, counted, victim, words, phase):
    """kill -9 of the scheduler, or of all workers with none to come: one clear line, in time. What was traced is carried on
    elsewhere, to the same bits, and nothing is traced twice."""
    address, processes = lonely
    monkeypatch.setattr(cluster_cells, "DaskCells", CountedDask)
    with connect(address) as cells:
        monkeypatch.setattr(cluster_cells, "WAIT", 4.0)
        strike, struck = once(phase, processes[victim].kill)
        seen = []
        with pytest.raises(ClusterError, match=words):
            run(bake(furnished(12), BUSY, cells), lambda progress: (seen.append(progress), strike(progress)))
        assert struck
        save_state(seen[-1].state(), tmp_path / "state")
    here = Counting()
    result = run(bake(furnished(12), BUSY, here, state=load_state(tmp_path / "state")))
    assert same(result, expected_busy)
    assert not cells.traced & here.traced
    assert here.traced
    assert cells.traced + here.traced == counted


@pytest.mark.heavy
def test_a_command_whose_cluster_is_lost(lonely, tmp_path, monkeypatch, capfd):
    """Exit 1 with a line that says that what is finished is kept; the same command goes on from it, without a cluster."""
    bpy = pytest.importorskip("bpy")
    from cell_radiosity.addon.command import main
    from cell_radiosity.addon.progress import Bar

    from blender_scenes import colors, empty, lamp, plane

    empty()
    plane("floor", n=60)
    plane("table", n=8, size=0.5, location=(0, 0, 0.4))
    lamp("POINT", 30.0, location=(-0.3, 0.2, 1.2), shadow_soft_size=0.1)
    scene = tmp_path / "room.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(scene))
    address, processes = lonely
    strike, struck = once("gather", processes["scheduler"].kill)
    command = ["bake", str(scene), "--state", str(tmp_path / "s"), "--error", "0.3%", "--quiet"]
    capfd.readouterr()
    with monkeypatch.context() as patch:
        patch.setattr(Bar, "show", lambda self, progress: strike(progress))
        assert main([*command, "--cluster", address]) == 1
    assert struck
    lines = [line for line in capfd.readouterr().err.splitlines() if line.startswith("radiosity: ")]
    assert len(lines) == 1
    assert "scheduler of the cluster is gone" in lines[0]
    assert "what is finished is kept: the same command goes on from it" in lines[0]
    found = []
    for rest in (["--report", str(tmp_path / "r.json")], ["--state", str(tmp_path / "other")]):
        assert main([*command, *rest]) == 0
        bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "room_radiosity.blend"))
        found.append(colors(bpy.data.objects["floor"].data, "Radiosity"))
    assert np.array_equal(*found)


@pytest.mark.parametrize("command", [pytest.param("price", marks=pytest.mark.heavy), "cells"])
def test_other_commands_take_a_cluster_too(tmp_path, monkeypatch, command):
    """Their cells are its workers, which end with them."""
    bpy = pytest.importorskip("bpy")
    from cell_radiosity.addon.command import main

    from blender_scenes import empty, lamp, plane

    empty()
    plane("floor", n=4)
    lamp("POINT", 30.0, location=(0, 0, 1))
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "floor.blend"))
    made = []
    monkeypatch.setattr(cluster_cells, "connect", lambda *words, real=connect: made.append(real(*words)) or made[-1])
    report, more = tmp_path / "r.json", {"price": ["--errors", "10"], "cells": ["--schedule", "dynamic"]}[command]
    argv = [command, str(tmp_path / "floor.blend"), "--cluster", "local:2", "--quiet", "--report", str(report), *more]
    assert main(argv) == 0
    (cells,) = made
    assert cells.usage.busy  # somebody worked there
    assert cells._client.status == "closed"
    found = json.loads(report.read_text())
    if command == "price":
        assert found["price"][0]["seconds_predicted"] > 0
    else:
        assert [run["cells"] for run in found["runs"] if run["kind"] == "measured"] == [2]


HOST = """
import os, sys, time
from cell_radiosity.cluster.cells import connect
if __name__ == "__main__":
    cells = connect("local:2")
    ports = [a.rpartition(":")[2] for a in (cells._started.scheduler_address, *cells._workers)]
    print(*ports, *cells._client.run(os.getpid).values(), flush=True)
    {end}
"""


def listens(port):
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


@pytest.mark.parametrize(
    ("end", "number"),
    [
        pytest.param("cells.stop()", None, marks=pytest.mark.heavy),
        ("time.sleep(60)", signal.SIGKILL),
        ("time.sleep(60)", signal.SIGINT),
        pytest.param("import ctypes; ctypes.string_at(0)", None, marks=pytest.mark.heavy),
    ],
    ids=["stop", "killed", "Ctrl-C", "crash"],
)
def test_workers_started_here_end_with_the_host(tmp_path, end, number):
    """No process of theirs is left, and no port."""
    script = tmp_path / "host.py"
    script.write_text(HOST.format(end=end))
    host = subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    told = [int(word) for word in host.stdout.readline().split()]
    ports, pids = told[:3], told[3:]
    assert len(pids) == 2
    if number:
        assert all(listens(port) for port in ports)
        host.send_signal(number)
    host.wait()
    left = lambda: [pid for pid in pids if alive(pid)] + [port for port in ports if listens(port)]
    deadline = time.monotonic() + 15
    while left() and time.monotonic() < deadline:  # a port may be open a moment longer than its process is there
        time.sleep(0.1)
    assert not left()


SBATCH = """#!/bin/sh
cp "$1" job-$$.sh  # as the real one does: the file is gone soon
setsid sh job-$$.sh >/dev/null 2>&1 &
echo "Submitted batch job $!"
"""
SCANCEL = """#!/bin/sh
kill -- -"$1"
"""


def test_a_cluster_of_slurm_jobs(tmp_path, monkeypatch, expected_busy):
    """The README's lines, where a job is a process of this machine: its script starts workers that bake the same bits."""
    pytest.importorskip("dask_jobqueue")
    for name, text in (("sbatch", SBATCH), ("scancel", SCANCEL)):
        (tmp_path / name).write_text(text)
        (tmp_path / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.chdir(tmp_path)
    readme = (Path(__file__).parent.parent / "README.md").read_text()
    (lines,) = re.findall(r"^    from dask_jobqueue import .*\n(?:    .*\n)+", readme, re.MULTILINE)
    importing, making, scaling, telling = textwrap.dedent(lines).splitlines()
    assert telling.startswith("print(cluster.scheduler_address)")
    named, network = {}, 'interface="lo", scheduler_options={"dashboard_address": None}'
    exec(f"{importing}\n{making}\n", named)
    with named["cluster"] as cluster:
        script = cluster.job_script()
        address = cluster.scheduler_address
    # One job takes a machine, and as many workers of one thread as the README says start in it, in this environment.
    assert {"#SBATCH -n 1", "#SBATCH --cpus-per-task=16"} <= set(script.splitlines())
    worker = shlex.split(script.splitlines()[-1])
    assert worker[:4] == [sys.executable, "-m", "distributed.cli.dask_worker", address]
    options = dict(pairwise(worker))
    assert (options["--nworkers"], options["--nthreads"]) == ("16", "1")

    making = making.replace("16", "1").replace("32GB", "2GB").replace(")", f", {network})")
    exec(f"{importing}\n{making}\n{scaling.replace('4', '2')}\n", named)
    with named["cluster"] as cluster, connect(cluster.scheduler_address) as cells:
        cells._client.wait_for_workers(2, timeout=120)
        result = run(bake(furnished(12), BUSY, cells))
        pids = workers(cells).values()
        assert len(pids) == 2
    assert same(result, expected_busy)
    deadline = time.monotonic() + 15
    while any(alive(pid) for pid in pids) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not any(alive(pid) for pid in pids)
