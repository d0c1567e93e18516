"""What Cycles' own vertex bake of the same scenes takes, and how far off it is: measured once, kept in the repository.

Settings are those of the references: 32 bounces, nothing clamped, a fixed number of samples, all cores. Seconds are CPU
seconds of the bake alone.
"""

from __future__ import annotations

import json
from datetime import date
from time import process_time

import bpy
import numpy as np

from cell_radiosity.addon.files import silent
from cell_radiosity.core.compare import off_at_vertices
from cell_radiosity.core.layers import vertex_means
from cell_radiosity.core.report import write_json

from ..reference import bake_with_cycles
from .machine import describe, hall_loop, load
from .scenes import ROOT, baked_of, kind_of, mark_of, opened, reference_of

KEPT = ROOT / "docs" / "bench" / "cycles.json"
SAMPLES = (16, 64, 256)
FEW = 4  # where there is a sun, Cycles is at its best
SEED = 11  # the references were made with others


def figures(names, anew=()):
    """{name: what is kept of a scene} for `names`: what is not there, or is asked for `anew`, is measured now."""
    kept = json.loads(KEPT.read_text()) if KEPT.exists() else {}
    for name in names:
        if name in anew or kept.get(name, {}).get("reference") != mark_of(name):
            kept[name] = _measured(name)
            KEPT.parent.mkdir(exist_ok=True)
            write_json(dict(sorted(kept.items())), KEPT)
    return {name: kept[name] for name in names}


def _measured(name):
    reference, runs = reference_of(name), []
    samples = SAMPLES if kind_of(name) == "lamps" else (FEW, *SAMPLES)
    before = load()
    for count in samples:
        opened(name)
        begun = process_time()
        with silent():
            colors = bake_with_cycles(count, SEED, baked_of(name))
        cpu = process_time() - begun
        found = {o: _means(o, c, len(reference[f"{o}.A"])) for o, c in colors.items() if f"{o}.A" in reference}
        runs.append({"samples": count, "error": off_at_vertices(found, reference), "cpu": round(cpu, 3)})
        print(f"{name}: Cycles with {count} samples: {cpu:.2f} CPU s, {100 * runs[-1]['error']:.2f} %", flush=True)
    return {
        "date": date.today().isoformat(), "machine": describe(), "load": [before, load()], "rate": hall_loop()(),
        "reference": mark_of(name), "runs": runs,
    }  # fmt: skip


def _means(name, colors, count):
    """(count, 3) means of the corners at each vertex of an object."""
    mesh = bpy.data.objects[name].data
    vertex = np.empty(len(mesh.loops), np.int32)
    mesh.attributes[".corner_vert"].data.foreach_get("value", vertex)
    return vertex_means(colors, vertex, count)
