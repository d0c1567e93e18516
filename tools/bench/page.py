"""The results as a page of tables, as plots, and as the table in the README."""

from __future__ import annotations

import json

from cell_radiosity.addon.plots import COLORS, pyplot

from .errors import ASKED, ratios_by_kind
from .growth import SIZES
from .law import geometric_mean
from .phases import PHASES
from .scenes import ROOT, SAMPLES

FOLDER = ROOT / "docs" / "bench"
MARK = "<!-- make bench: {} -->"  # before and after a table in the README
TITLES = {
    "cornell_box": "Cornell box", "hall": "Hall", "sunlit_room": "Sunlit room", "door": "Two rooms, a door ajar",
    "small_lamps": "Small bright lamps", "many_emitters": "Hundreds of glowing faces", "window": "Sun through a window",
    "shaft": "A skylight shaft", "courtyard": "Courtyard, sun and sky", "sunlit_room indoors": "Sunlit room, indoors only",
    "shaft indoors": "A skylight shaft, indoors only", "window indoors": "Sun through a window, indoors only",
}  # fmt: skip


def table(head, rows):
    """A table in Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(str(cell) for cell in line) + " |" for line in lines)


def number(value, digits=2):
    """A number with so many digits that count, "-" for None."""
    if value is None:
        return "-"
    text = f"{value:.{digits}g}"
    return f"{value:.0f}" if "e" in text else text


def mean_of(ratios):
    """The geometric mean of ratios, and of how many, if some are None."""
    known = [r for r in ratios if r is not None]
    return number(geometric_mean(ratios)) + (f" ({len(known)} of {len(ratios)})" if len(known) < len(ratios) else "")


def percent(value):
    """An error in percent."""
    return "-" if value is None else f"{100 * value:.2f}"


def ratio_table(scenes):
    """How many times less CPU seconds than Cycles for the same measured error, by scene, with geometric means."""
    rows = []
    for name, scene in scenes.items():
        costs = scene["against_cycles"]["costs"]
        one = costs[ASKED.index(0.01)]
        rows.append([TITLES[name], *[number(c["ratio"]) for c in costs], number(one["ours"]), number(one["cycles"])])
    for kind, ratios in ratios_by_kind(scenes).items():
        if ratios[0]:
            rows.append([f"*geometric mean, {kind}*", *[mean_of(r) for r in ratios], "", ""])
    return table(["scene", *[f"{100 * e:g} %" for e in ASKED], "CPU seconds at 1 %", "Cycles'"], rows)


def bakes_table(scenes):
    """What each bake asked for, reached and took."""
    rows = []
    for name, scene in scenes.items():
        cells = [f"{percent(b['estimated'])} / {percent(b['error'])} %, {number(b['cpu'])} s" for b in scene["bakes"]]
        rows.append([TITLES[name], scene["points"], *cells])
    return table(["scene", "points", *[f"{100 * e:g} %" for e in ASKED]], rows)


def cycles_table(scenes, cycles):
    """What Cycles took, as it was measured."""
    rows = []
    for name, scene in scenes.items():
        runs = cycles[name]["runs"]
        cells = ", ".join(f"{r['samples']}: {percent(r['error'])} % in {number(r['cpu'])} s" for r in runs)
        rows.append([TITLES[name], cells, f"{scene['against_cycles']['slope']:.2f}", cycles[name]["date"]])
    return table(["scene", "samples: error, CPU seconds", "error falls with the power", "measured"], rows)


def draw_errors(scenes, cycles, path):
    """Error against CPU seconds, our bakes and Cycles', a panel for each scene."""
    plt = pyplot()
    columns = min(len(scenes), 3)
    rows = -(-len(scenes) // columns)
    size = dict(figsize=(3.2 * columns, 2.7 * rows), squeeze=False, sharex=True, sharey=True)
    figure, axes = plt.subplots(rows, columns, **size)
    for axis in axes.flat[len(scenes) :]:
        axis.set_visible(False)
    for axis, (name, scene) in zip(axes.flat, scenes.items()):
        bakes, runs, costs = scene["bakes"], cycles[name]["runs"], scene["against_cycles"]["costs"]
        scale, errors = cycles[name]["rate"] / scene["rate"], lambda rows: [100 * row["error"] for row in rows]
        axis.plot([c["cycles"] for c in costs], errors(costs), color="0.7", lw=1, ls="--")
        axis.plot([scale * r["cpu"] for r in runs], errors(runs), "s-", color=COLORS["paper"], ms=4, label="Cycles")
        axis.plot([b["cpu"] for b in bakes], errors(bakes), "o-", color=COLORS["dynamic"], ms=4, label="Cell Radiosity")
        axis.set(xscale="log", yscale="log", title=TITLES[name], ylim=(0.1, 40))
        for ticks, places in ((axis.set_xticks, (0.1, 1, 10, 100, 1000)), (axis.set_yticks, (0.1, 0.3, 1, 3, 10, 30))):
            ticks(places, [f"{x:g}" for x in places])
        axis.minorticks_off()
        axis.grid(color="0.92")
    for axis in axes[:, 0]:
        axis.set_ylabel("error, percent")
    for axis in axes[-1]:
        axis.set_xlabel("CPU seconds")
    axes[0, 0].legend(frameon=False, loc="upper right")
    figure.tight_layout()
    figure.savefig(path)
    plt.close(figure)


def write(results):
    """Write the page and the plots of results, and the README's table."""
    machine = results["machine"]
    parts = [
        "# Speed\n\nMade by `make bench`; figures to compare are ratios. "
        f"{machine['processor']}, {machine['cores']} cores, Python {machine['python']}, Blender {machine['blender']}."
    ]
    if "errors" in results:
        parts += [_of_errors(results["errors"])]
        update_readme(results["errors"]["scenes"])
    for name, told in (("phases", _of_phases), ("growth", _of_growth), ("tools", _of_tools)):
        if name in results:
            parts += [told(results[name])]
    parts += [f"## So far\n\n{history()}"]
    (FOLDER / "README.md").write_text("\n\n".join(parts) + "\n")


def _of_errors(found):
    """The part of the page about errors; draws the plots."""
    scenes = found["scenes"]
    cycles = json.loads((FOLDER / "cycles.json").read_text())
    draw_errors(scenes, cycles, FOLDER / "errors.png")
    samples = {n: scenes[n] for n in SAMPLES if n in scenes}
    rates = [scene["rate"] / 1e6 for scene in scenes.values()]
    if samples:
        draw_errors(samples, cycles, FOLDER / "samples.png")
    return f"""## Error against seconds

How many times less CPU seconds than Cycles' own vertex bake, for the same measured error; "-": it was not reached.
Between two bakes costs lie on a straight line of logarithms; where the cheapest bake is better than that error, it counts as it is.

{ratio_table(scenes)}

![Error against CPU seconds](errors.png)

Estimated and measured error, and CPU seconds of survey, patches, transport and gather, of bakes asked for an error:

{bakes_table(scenes)}

Cycles (32 bounces, nothing clamped, fixed samples, all cores; the bake alone):

{cycles_table(scenes, cycles)}

A bare Embree loop in the hall casts {min(rates):.1f} to {max(rates):.1f} million rays per CPU second here; by what it cast where Cycles was
measured, Cycles' seconds are carried over. Processes that wanted a core meanwhile: {found["load"][0]} to {found["load"][1]}."""


def _of_phases(found):
    """The part of the page about where time goes."""
    embree, rows = found["embree"], []
    for part in ("transport", "gather", "both"):
        p = embree[part]
        shares = [f"{100 * p[k]:.0f} %" for k in ("of_wall", "of_cpu")]
        rows.append([part, f"{p['wall']:.2f} s", f"{p['cpu']:.2f} s", *shares, f"{p['rays'] / 1e6:.2f}"])
    inside = table(["", "wall", "CPU", "of cells x wall inside Embree", "of CPU seconds", "million rays"], rows)
    rows = []
    for name, c in found["commands"].items():
        told, whole = c["seconds"], c["command"]
        shares = [whole - told["total"], *(told[k] or 0.0 for k in PHASES)]
        rows.append([TITLES[name], f"{whole:.1f} s", *[f"{100 * s / whole:.0f} %" for s in shares], f"{told['cpu']:.2f} s", f"{c['peak_memory_mb']:.0f} MB"])  # fmt: skip
    shares = table(["scene", "the command", "Blender", *PHASES, "CPU", "peak memory"], rows)
    return f"""## Where the time goes

{TITLES[embree["scene"]]} at 1 %, {embree["cells"]} cells; gather is all that comes after transport, placing points, filter and estimate too:

{inside}

Inside Embree a CPU second casts {embree["rate"] / 1e6:.1f} million rays (rays to sources among them), in a bare loop over cosine rays from the
same points {embree["bare"] / 1e6:.1f} million.

`radiosity bake` at 1 % from its first to its last moment, wall seconds; "Blender" is its module's start, and the saving of the file; cells
start meanwhile; the pilot counts in survey:

{shares}"""


def _of_growth(found):
    """The part of the page about size; draws the plot."""
    draw_growth(found, FOLDER / "growth.png")
    rows = []
    for name in SIZES:
        if name in found:
            s = found[name]
            cells = ", ".join(f"{r['size']}: {number(r['cpu'])} s" for r in s["runs"])
            rows.append([name, cells, f"{s['exponent']:.2f}", f"{s['end']:.2f}"])
    lines = [table(["", "CPU seconds", "exponent of all", "of the last two"], rows)]
    if "points" in found:
        before, last = found["points"]["runs"][-2:]
        more = last["size"] - before["size"]
        each = [(last[k] - before[k]) / more * 1e6 for k in ("host_mb", "cells_mb")]
        lines += [
            f"Peak memory at {last['size']} points: {last['host_mb'] + last['cells_mb']:.0f} MB; each further million takes "
            f"{each[0]:.0f} MB of the host's and {each[1]:.0f} MB of all cells'."
        ]
    if "objects" in found:
        last = found["objects"]["runs"][-1]
        lines += [f"{last['size']} objects: read in {last['read']:.1f} CPU seconds, written in {last['write']:.1f}."]
    if "emitters" in found:
        hard = [r for r in found["emitters"]["runs"] if not r["converged"]]
        lines += [
            f"{r['size']} emitters: the error asked for, 2 %, was not reached ({percent(r['estimated'])} %)."
            for r in hard
        ]
    return "\n\n".join(["## Cost against size", "![CPU seconds against size](growth.png)", *lines])


def draw_growth(found, path):
    """CPU seconds against size, a panel for each series."""
    plt = pyplot()
    figure, axes = plt.subplots(1, len(SIZES), figsize=(3.0 * len(SIZES), 2.8), sharey=True)
    for axis, name in zip(axes, SIZES):
        if name in found:
            runs = found[name]["runs"]
            axis.plot([r["size"] for r in runs], [r["cpu"] for r in runs], "o-", color=COLORS["dynamic"], ms=4)
            axis.set_title(f"exponent {found[name]['exponent']:.2f}")
        axis.set(xscale="log", yscale="log", xlabel=name)
        axis.grid(color="0.92")
    axes[0].set_ylabel("CPU seconds")
    figure.tight_layout()
    figure.savefig(path)
    plt.close(figure)


def _of_tools(found):
    """What other tools print."""
    return "\n\n".join(
        [f"## Cells\n\n```\n{found['cells'].strip()}\n```", f"## Effects left out\n\n{found['effects'].strip()}"]
    )


def history():
    """A table of all dated results."""
    rows, at = [], ASKED.index(0.01)
    for path in sorted(FOLDER.glob("20*.json")):
        kept = json.loads(path.read_text())
        if "errors" not in kept:
            continue
        mean = {k: geometric_mean(r[at]) for k, r in ratios_by_kind(kept["errors"]["scenes"]).items()}
        hall = kept["errors"]["scenes"].get("hall")
        rays = hall and hall["against_cycles"]["costs"][at]["ours"] * hall["rate"] / 1e6
        rows.append([path.stem, kept["machine"]["commit"], number(mean["interiors"]), number(mean["outdoors"]), number(rays, 3)])  # fmt: skip
    head = ["date", "commit", "interiors, times Cycles at 1 %", "outdoors", "hall at 1 %, in millions of bare rays"]
    return table(head, rows)


def readme_tables(scenes):
    """{name: table} of those that the README has, between two marks each."""
    return {"ratios": ratio_table(scenes), "bakes": bakes_table(scenes)}


def update_readme(scenes, path=ROOT / "README.md"):
    """Put the tables between their marks in the README."""
    text = path.read_text()
    for name, made in readme_tables(scenes).items():
        before, mark, after = text.partition(MARK.format(name))
        _, last, after = after.partition(mark)
        text = f"{before}{mark}\n{made}\n{last}{after}"
    path.write_text(text)
