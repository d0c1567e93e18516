"""What machine a measurement was made on, and how fast it is: a bare loop around Embree, which nothing here can speed
up."""

from __future__ import annotations

import os
import platform
import subprocess
from time import thread_time

import bpy
import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from cell_radiosity.core.points import make_points
from cell_radiosity.core.sampling import hemisphere, lattice, tangents

from .scenes import ROOT, opened

RAYS = 16  # of a point
BLOCK = 1 << 14
OFFSET = 1e-5


def bare_loop(scene, points):
    """A function that does nothing but cast gather's rays, from the points of a core Scene, cosine distributed, in blocks,
    and returns how many that were per CPU second."""
    low, high = scene.bounds
    place = lambda x: (x - (low + high) / 2) / scene.diagonal
    embree = EmbreeScene(robust=True)
    TriangleMesh(embree, place(scene.vertices).astype(np.float32), scene.triangles[scene.usable])
    t1, t2 = tangents(points.normal)
    frame = np.stack([t1, t2, points.normal], axis=1)
    directions = np.einsum("rk,pkd->prd", hemisphere(*lattice(RAYS)), frame).reshape(-1, 3).astype(np.float32)
    origins = np.repeat(place(points.position) + OFFSET * points.geometric, RAYS, axis=0).astype(np.float32)

    def rate():
        begun = thread_time()
        for k in range(0, len(origins), BLOCK):
            embree.run(origins[k : k + BLOCK], directions[k : k + BLOCK], output=True)
        return len(origins) / (thread_time() - begun)

    rate()  # warms up
    return rate


def hall_loop():
    """The bare loop that machines are compared by: in the hall."""
    scene = opened("hall")
    return bare_loop(scene, make_points(scene))


def describe():
    """What the machine and its programs are called."""
    return {
        "processor": _processor(), "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "system": platform.platform(terse=True), "python": platform.python_version(), "numpy": np.__version__,
        "blender": bpy.app.version_string, "commit": _commit(),
    }  # fmt: skip


def load():
    """Mean number of processes that wanted a core in the last minute; None where the system does not say."""
    return round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None


def _processor():
    try:
        with open("/proc/cpuinfo") as file:
            return next(line.split(":")[1].strip() for line in file if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()


def _commit():
    """The commit that is checked out, with a + if it was changed since; None outside of git."""
    asked = ["git", "describe", "--always", "--dirty=+"]
    try:
        return subprocess.run(asked, cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return None
