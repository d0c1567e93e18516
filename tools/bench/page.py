"""The results as a page of tables, as plots, and as the table in the README."""

from __future__ import annotations

import json
import re

from cell_radiosity.addon.plots import COLORS, pyplot

from .errors import ASKED, means
from .scenes import ROOT, SAMPLES

FOLDER = ROOT / "docs" / "bench"
MARKS = "<!-- table of make bench -->", "<!-- end -->"
TITLES = {
    "cornell_box": "Cornell box", "hall": "Hall", "sunlit_room": "Sunlit room", "door": "Two rooms, a door ajar",
    "small_lamps": "Small bright lamps", "many_emitters": "Hundreds of glowing faces", "window": "Sun through a window",
    "shaft": "A skylight shaft", "courtyard": "Courtyard, sun and sky",
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


def percent(value):
    """An error in percent."""
    return "-" if value is None else f"{100 * value:.2f}"


def ratio_table(scenes):
    """How many times less CPU seconds than Cycles for the same measured error, by scene, with geometric means."""
    rows = []
    for name, scene in scenes.items():
        costs = scene["against_cycles"]["costs"]
        one = costs[ASKED.index(0.01)]
        rows.append(
            [
                TITLES[name],
                *[number(c["ratio"]) for c in costs],
                f"{number(one['ours'])} s",
                f"{number(one['cycles'])} s",
            ]
        )
    for kind, ratios in means(scenes).items():
        if any(ratios):
            rows.append([f"*geometric mean, {kind}*", *[number(r) for r in ratios], "", ""])
    return table(["scene", *[f"{100 * e:g} %" for e in ASKED], "ours at 1 %", "Cycles at 1 %"], rows)


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


def draw_errors(scenes, cycles, rate, path):
    """Error against CPU seconds, our bakes and Cycles', a panel for each scene. rate: of the bare loop."""
    plt = pyplot()
    columns = min(len(scenes), 3)
    rows = -(-len(scenes) // columns)
    size = dict(figsize=(3.2 * columns, 2.7 * rows), squeeze=False, sharex=True, sharey=True)
    figure, axes = plt.subplots(rows, columns, **size)
    for axis in axes.flat[len(scenes) :]:
        axis.set_visible(False)
    for axis, (name, scene) in zip(axes.flat, scenes.items()):
        bakes, runs, costs = scene["bakes"], cycles[name]["runs"], scene["against_cycles"]["costs"]
        scale, errors = cycles[name]["rate"] / rate, lambda rows: [100 * row["error"] for row in rows]
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
        parts += [_of_errors(results["errors"]), f"## So far\n\n{history()}"]
        update_readme(results["errors"]["scenes"])
    (FOLDER / "README.md").write_text("\n\n".join(parts) + "\n")


def _of_errors(found):
    """The part of the page about errors; draws the plots."""
    scenes = found["scenes"]
    cycles = json.loads((FOLDER / "cycles.json").read_text())
    draw_errors(scenes, cycles, found["rate"], FOLDER / "errors.png")
    samples = {n: scenes[n] for n in SAMPLES if n in scenes}
    if samples:
        draw_errors(samples, cycles, found["rate"], FOLDER / "samples.png")
    return f"""## Error against seconds

How many times less CPU seconds than Cycles' own vertex bake, for the same measured error:

{ratio_table(scenes)}

![Error against CPU seconds](errors.png)

Estimated and measured error, and CPU seconds of survey, patches, transport and gather, of bakes asked for an error:

{bakes_table(scenes)}

Cycles (32 bounces, nothing clamped, fixed samples, all cores; the bake alone):

{cycles_table(scenes, cycles)}

A bare Embree loop in the hall casts {found["rate"] / 1e6:.1f} million rays per CPU second here; by what it cast where Cycles was
measured, Cycles' seconds are carried over. Processes that wanted a core meanwhile: {found["load"][0]} to {found["load"][1]}."""


def history():
    """A table of all dated results."""
    rows = []
    for path in sorted(FOLDER.glob("20*.json")):
        kept = json.loads(path.read_text())
        if "errors" not in kept:
            continue
        mean = means(kept["errors"]["scenes"])
        at = ASKED.index(0.01)
        hall = kept["errors"]["scenes"].get("hall")
        rays = hall and hall["against_cycles"]["costs"][at]["ours"] * kept["errors"]["rate"] / 1e6
        rows.append([path.stem, kept["machine"]["commit"], number(mean["interiors"][at]), number(mean["open"][at]), number(rays, 3)])  # fmt: skip
    head = ["date", "commit", "interiors, times Cycles at 1 %", "open", "hall at 1 %, in millions of bare rays"]
    return table(head, rows)


def update_readme(scenes, path=ROOT / "README.md"):
    """Put the table of ratios between its marks in the README."""
    begin, end = MARKS
    text = path.read_text()
    path.write_text(
        re.sub(f"{begin}.*?{end}", lambda _: f"{begin}\n{ratio_table(scenes)}\n{end}", text, flags=re.DOTALL)
    )
