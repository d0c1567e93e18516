"""Error against CPU seconds of our bakes beside Cycles', and how many times less they take for the same error."""

from __future__ import annotations

import numpy as np

from cell_radiosity.core.compare import off_reference

from .law import cost_of_bakes, cost_of_samples, exponent, geometric_mean
from .scenes import Settings, bake, kind_of, opened, reference_of, run

ASKED = (0.05, 0.02, 0.01, 0.005)


def bakes_of(name, cells, seeds):
    """What bakes of a scene to each error take, by turns, once for each seed: [{asked, error, estimated, cpu, ...}], errors
    as root mean squares over the seeds, CPU seconds as medians."""
    scene, reference = opened(name), reference_of(name)
    run(bake(scene, Settings.for_error(ASKED[0]), cells))  # warms up
    found = {asked: [] for asked in ASKED}
    for seed in range(seeds):
        for asked, baked in found.items():
            b = run(bake(scene, Settings.for_error(asked, seed=seed), cells))
            baked.append((off_reference(b, reference), b.estimate.total, b.seconds["cpu"], b.rays, b.cells["host_mb"] + sum(b.cells["cells_mb"])))  # fmt: skip
    rows = []
    for asked, baked in found.items():
        error, estimated, cpu, rays, memory = np.array(baked).T
        rows.append({
            "asked": asked, "error": _rms(error), "estimated": _rms(estimated), "cpu": float(np.median(cpu)),
            "cpu_range": [float(cpu.min()), float(cpu.max())], "rays": int(np.median(rays)), "peak_memory_mb": float(memory.max()),
        })  # fmt: skip
        print(
            f"{name}: {100 * asked:g} %: {rows[-1]['cpu']:.2f} CPU s, {100 * rows[-1]['error']:.2f} % measured, "
            f"{100 * rows[-1]['estimated']:.2f} % estimated", flush=True
        )  # fmt: skip
    return {"kind": kind_of(name), "vertices": len(scene.vertices), "points": len(b.points), "bakes": rows}


def compared(ours, cycles, rate):
    """The costs of each of ASKED side by side, for a scene: our bakes as `bakes_of` has them, Cycles' as `figures` has them,
    on a machine whose bare loop casts `rate` rays per second: {"slope", "costs": [{error, ours, cycles, samples, ratio}]}."""
    runs = [(r["samples"], r["error"], r["cpu"]) for r in cycles["runs"]]
    samples, errors, _ = np.array(runs).T
    costs = []
    for error in ASKED:
        needed, cpu = cost_of_samples(runs, error)
        cpu *= cycles["rate"] / rate  # on this machine
        own = cost_of_bakes([(b["error"], b["cpu"]) for b in ours["bakes"]], error)
        costs.append({"error": error, "ours": own, "cycles": cpu, "samples": needed, "ratio": own and cpu / own})
    return {"slope": -exponent(samples, errors), "costs": costs}


def means(scenes):
    """{kind: [geometric mean of the ratios at each of ASKED]} over scenes as the results have them."""
    kinds = {
        "interiors": lambda kind: kind != "open",
        "interiors, lamps": lambda kind: kind == "lamps",
        "interiors, sun": lambda kind: kind == "sunlit",
        "open": lambda kind: kind == "open",
    }
    return {
        name: [
            geometric_mean([s["against_cycles"]["costs"][k]["ratio"] for s in scenes.values() if fits(s["kind"])])
            for k in range(len(ASKED))
        ]
        for name, fits in kinds.items()
    }


def _rms(values):
    return float(np.sqrt(np.mean(values * values)))
