"""Error against CPU seconds of our bakes beside Cycles', and how many times less they take for the same error."""

from __future__ import annotations

import numpy as np

from cell_radiosity.core.compare import off_reference

from .law import cost_of_bakes, cost_of_samples, exponent
from .scenes import Settings, bake, kind_of, opened, reference_of, run

ASKED = (0.05, 0.02, 0.01, 0.005)
LONG = 15.0  # CPU seconds of a bake, which is then not repeated


def bakes_of(name, cells, seeds, bare):
    """What bakes of a scene to each error take, by turns, once for each seed: {kind, points, rate, bakes: [{asked,
    error, estimated, cpu, ...}]}, errors as root mean squares over the seeds, CPU seconds as medians. bare: function
    that tells the rays per CPU second of the bare loop, meanwhile."""
    scene, reference = opened(name), reference_of(name)
    run(bake(scene, Settings.for_error(ASKED[0]), cells))  # warms up
    found, rates = {asked: [] for asked in ASKED}, []
    for seed in range(seeds):
        rates.append(bare())
        for asked, baked in found.items():
            if baked and baked[0][2] > LONG:
                continue
            b = run(bake(scene, Settings.for_error(asked, seed=seed), cells))
            baked.append((off_reference(b, reference), b.estimate.total, b.seconds["cpu"], b.rays))
    rows = []
    for asked, baked in found.items():
        error, estimated, cpu, rays = np.array(baked).T
        rows.append({
            "asked": asked, "error": _rms(error), "estimated": _rms(estimated), "cpu": float(np.median(cpu)),
            "cpu_range": [float(cpu.min()), float(cpu.max())], "rays": int(np.median(rays)),
        })  # fmt: skip
        print(
            f"{name}: {100 * asked:g} %: {rows[-1]['cpu']:.2f} CPU s, {100 * rows[-1]['error']:.2f} % measured, "
            f"{100 * rows[-1]['estimated']:.2f} % estimated", flush=True
        )  # fmt: skip
    return {
        "kind": kind_of(name),
        "vertices": len(scene.vertices),
        "points": len(b.points),
        "rate": float(np.median(rates)),
        "bakes": rows,
    }


def compared(ours, cycles):
    """The costs of each of ASKED side by side, for a scene: our bakes as `bakes_of` has them, Cycles' as `figures` has
    them, as if both were baked now and here: {"slope", "costs": [{error, ours, cycles, samples, ratio}]}."""
    runs = [(r["samples"], r["error"], r["cpu"]) for r in cycles["runs"]]
    samples, errors, _ = np.array(runs).T
    costs = []
    for error in ASKED:
        needed, cpu = cost_of_samples(runs, error)
        cpu *= cycles["rate"] / ours["rate"]
        own = cost_of_bakes([(b["error"], b["cpu"]) for b in ours["bakes"]], error)
        costs.append({"error": error, "ours": own, "cycles": cpu, "samples": needed, "ratio": own and cpu / own})
    return {"slope": -exponent(samples, errors), "costs": costs}


def ratios_by_kind(scenes):
    """{kind: [ratios at each of ASKED]}, None for errors that were not reached, of scenes as the results have them."""
    kinds = {
        "interiors": ("lamps", "sun"), "interiors that lamps light": ("lamps",), "interiors that the sun lights": ("sun",),
        "outdoors": ("open",),
    }  # fmt: skip
    return {
        name: [
            [s["against_cycles"]["costs"][k]["ratio"] for s in scenes.values() if s["kind"] in fitting]
            for k in range(len(ASKED))
        ]
        for name, fitting in kinds.items()
    }


def _rms(values):
    return float(np.sqrt(np.mean(values * values)))
