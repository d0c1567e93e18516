"""Where the time of a bake goes: inside Embree and beside it, and in which phase."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path
from time import perf_counter, process_time

import numpy as np

from .scenes import ROOT, Settings, bake, opened

PHASES = ("start", "read", "survey", "patches", "transport", "gather", "write")
ERROR = 0.01


def embree_shares(name, cells, bare, runs):
    """What transport and gather of a scene at ERROR spend inside Embree: {"transport" and "gather": {wall, cpu, embree,
    rays, of_wall, of_cpu}, "both": the same, "rate", "bare"}. Seconds; of_wall: share of cells x wall that is inside
    Embree; of_cpu: the same of the CPU seconds of host and cells, which other programs change less. Gather is all that
    comes after transport: placing points, filter and estimate too. rate, bare: rays per CPU second inside Embree, and
    of the bare loop."""
    scene = opened(name)
    found = [watched(scene, Settings.for_error(ERROR), cells) for _ in range(runs + 1)][1:]
    parts = {
        part: {key: float(np.median([f[part][key] for f in found])) for key in found[0][part]} for part in found[0]
    }
    both = {key: sum(p[key] for p in parts.values()) for key in ("wall", "cpu", "embree", "rays")}
    parts["both"] = both
    for part in parts.values():
        part["of_wall"] = part["embree"] / (cells.count * part["wall"])
        part["of_cpu"] = part["embree"] / part["cpu"]
    return {
        "scene": name,
        "cells": cells.count,
        **parts,
        "rate": both["rays"] / both["embree"],
        "bare": float(np.median([bare() for _ in range(runs)])),
    }


def watched(scene, settings, cells):
    """One bake: {"transport" and "gather": {wall, cpu, embree, rays}}."""

    def mark():
        used = cells.usage
        return np.array([perf_counter(), process_time() + used.cpu - used.here, used.embree, used.rays])

    last, generator = {}, bake(scene, settings, cells)
    while True:
        try:
            progress = next(generator)
        except StopIteration as end:
            done, baked = mark(), end.value
            break
        last[progress.phase] = mark()
    begun = last["patches"]
    # Rows are all there at the last round; what the host does until the transport's end is known by its wall seconds.
    transport = last.get("transport", begun) - begun
    rest = baked.seconds["transport"] - transport[0]
    transport[:2] += rest
    gather = done - begun - transport
    return {
        part: dict(zip(("wall", "cpu", "embree", "rays"), x))
        for part, x in (("transport", transport), ("gather", gather))
    }


def commands(names, runs):
    """What `radiosity bake` of sample scenes takes from its first to its last moment, each the run of median seconds:
    {name: {"command": wall seconds, "seconds": of the report, "peak_memory_mb", "points"}}."""
    found = {name: [] for name in names}
    with tempfile.TemporaryDirectory() as folder:
        for _ in range(runs):
            for name, taken in found.items():
                taken.append(_command(ROOT / "sample_scenes" / f"{name}.blend", Path(folder)))
    return {name: sorted(taken, key=lambda t: t["command"])[len(taken) // 2] for name, taken in found.items()}


def _command(scene, folder):
    report = folder / "report.json"
    asked = [sys.executable, "-m", "cell_radiosity", "bake", str(scene), "-o", str(folder / "out.blend")]
    asked += ["--error", f"{100 * ERROR:g}%", "--report", str(report), "--quiet"]
    begun = perf_counter()
    subprocess.run(asked, check=True, stdout=subprocess.DEVNULL)
    wall = perf_counter() - begun
    told = json.loads(report.read_text())
    return {
        "command": wall,
        "seconds": told["seconds"],
        "peak_memory_mb": told["peak_memory_mb"],
        "points": told["output_points"],
    }
