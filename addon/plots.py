"""Plots of measurements, with matplotlib, which the extension does not carry: the command line's own Python has it."""

from __future__ import annotations

import os
from math import prod

from ..core.knobs import frontier
from ..core.saving import written_whole
from .errors import Usage

SUFFIXES = (".png", ".pdf", ".svg")
COLORS = {"paper": "#b5523b", "dynamic": "#2f6f9f"}
KNOB_COLORS = {
    "patches": "#c46b4e", "row rays": "#d9a441", "gather rays": "#5f9e6e", "light samples": "#8d6cab", "bounces": "#4f9da6",
}  # fmt: skip
CAUSE_COLORS = {
    "too few shooters": "#d9a441",
    "waiting": "#c46b4e",
    "messages": "#7d8f69",
    "serial host work": "#5b6c8f",
}


def pyplot():
    """matplotlib's pyplot, drawing to files. Raises Usage where there is none."""
    try:
        import matplotlib
    except ImportError:
        raise Usage("--plot needs matplotlib, which this Python does not have; use .venv/bin/radiosity") from None
    matplotlib.use("Agg")
    from matplotlib import pyplot

    pyplot.rcParams.update({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False, "savefig.dpi": 110})
    return pyplot


def check_plot(path):
    """Raise Usage if no plot can be drawn to a file of that name."""
    pyplot()
    if _suffix(path) not in SUFFIXES:
        raise Usage(f"--plot {path}: its name must end in {', '.join(SUFFIXES)}")


def _suffix(path):
    return os.path.splitext(path)[1].lower()


def _save(figure, path):
    with written_whole(path) as temporary:
        figure.savefig(temporary, format=_suffix(path)[1:])


def plot_cells(runs, path, title):
    """Speed-up and seconds against cells for each schedule, measured and replayed, and what cells' time was lost to."""
    plt = pyplot()
    schedules = list(dict.fromkeys(r.schedule for r in runs))
    figure, axes = plt.subplots(1, 2 + len(schedules), figsize=(6.6 + 3.2 * len(schedules), 3.6))
    speed, time = axes[:2]
    most = max(r.cells for r in runs)
    speed.plot([1, most], [1, most], color="0.8", lw=1, zorder=0)
    for schedule in schedules:
        for kind, style in (("replayed", dict(ls="--", lw=1.2)), ("measured", dict(ls="", marker="o", ms=5))):
            mine = [r for r in runs if (r.schedule, r.kind) == (schedule, kind)]
            alone = next((r.seconds for r in mine if r.cells == 1), None)
            if alone:
                x, y = [r.cells for r in mine], [alone / r.seconds for r in mine]
                speed.plot(x, y, color=COLORS[schedule], label=f"{schedule}, {kind}", **style)
                time.plot(x, [r.seconds for r in mine], color=COLORS[schedule], **style)
    speed.set(xscale="log", yscale="log", xlabel="cells", ylabel="speed-up over one cell")
    time.set(xscale="log", yscale="log", xlabel="cells", ylabel="seconds, transport and gather")
    speed.legend(frameon=False, fontsize=8)
    for axis, schedule in zip(axes[2:], schedules):
        mine = [r for r in runs if (r.schedule, r.kind) == (schedule, "replayed")]
        below = [sum(r.busy) / (r.cells * r.seconds) for r in mine]
        place = range(len(mine))
        axis.bar(place, below, color="0.85", label="work")
        for cause, color in CAUSE_COLORS.items():
            share = [r.lost[cause] / r.seconds for r in mine]
            axis.bar(place, share, bottom=below, color=color, label=cause)
            below = [a + b for a, b in zip(below, share)]
        axis.set(title=f"{schedule}, replayed", xlabel="cells", ylabel="share of the cells' time", ylim=(0, 1))
        axis.set_xticks(list(place), [r.cells for r in mine], fontsize=6)
    axes[-1].legend(frameon=False, fontsize=7, loc="lower left")
    figure.suptitle(title)
    figure.tight_layout()
    _save(figure, path)
    plt.close(figure)


def knob_value(knob):
    """What a knob was turned to, in words."""
    name, value = knob["knob"], knob["value"]
    if value is None:
        return "all"
    return {"patches": f"{value:.2g} m", "light samples": f"x {value:g}"}.get(name, f"{value:g}")


def plot_price(rows, objects, knobs, falls, path, title):
    """Error against seconds: foretold and measured, what each knob does alone, the cheapest of all that was baked, and how
    steeply the error falls. rows, objects, knobs: as the report has them; falls: the power of the seconds, or None."""
    plt = pyplot()
    from matplotlib.patheffects import withStroke

    figure, axis = plt.subplots(figsize=(8.2, 4.8) if knobs else (6.2, 4.2))

    def draw(points, **style):
        axis.plot([s for s, _ in points], [100 * e for _, e in points], **style)

    foretold = [(r["seconds_predicted"], r["error"]) for r in rows]
    measured = [(r["seconds_measured"], r["error_measured"]) for r in rows if r["error_measured"]]
    turned = [k for k in knobs if k["error"]]
    outline = withStroke(linewidth=3, foreground="white")  # words stay legible on lines
    best = frontier([*measured, *((k["seconds"], k["error"]) for k in turned)])
    if best:
        draw(best, color="0.85", lw=7, solid_capstyle="round", zorder=0, label="cheapest of all that was baked")
    for name, color in KNOB_COLORS.items():
        own = [k for k in turned if k["knob"] == name]
        if not own:
            continue
        draw([(k["seconds"], k["error"]) for k in own], color=color, marker="o", ms=3.5, lw=1, label=f"{name} alone")
        for k, off, side in ((own[0], -5, "right"), (own[-1], 5, "left")):
            if not k["chosen"]:
                place, style = (
                    (k["seconds"], 100 * k["error"]),
                    dict(fontsize=8, color=color, ha=side, va="center", path_effects=[outline], zorder=5),
                )
                axis.annotate(knob_value(k), place, (off, 0), textcoords="offset points", **style)
    each = [
        (r["seconds_measured"], error) for r, errors in zip(rows, objects) for error in errors.values() if error > 0
    ]
    if each:
        draw(each, color="0.6", marker="_", ms=8, ls="", zorder=1, label="each object, measured")
    draw(
        foretold,
        color=COLORS["dynamic"],
        marker="o",
        mfc="white",
        ms=5,
        lw=1,
        ls=":",
        label="errors asked for, foretold",
    )
    if measured:
        draw(measured, color=COLORS["dynamic"], marker="s", ms=5, lw=1.6, label="errors asked for, measured")
    for chosen in [k for k in turned if k["chosen"]][:1]:
        draw(
            [(chosen["seconds"], chosen["error"])],
            color="0.15",
            marker="*",
            ms=12,
            ls="",
            label="where knobs are turned from",
        )
    points = frontier(measured or foretold)
    if falls is not None:
        # Through the middle of what it was fitted to.
        x, y = (prod(values) ** (1 / len(points)) for values in zip(*points))
        line = [(s, y * (s / x) ** falls) for s in (points[0][0], points[-1][0])]
        draw(line, color="0.15", lw=1, ls="--", label=f"slope {falls:.2f}")
    axis.set(xscale="log", yscale="log", xlabel="seconds", ylabel="error in percent", title=title)
    for one in (axis.xaxis, axis.yaxis):
        _plain_ticks(one)
    axis.grid(color="0.94")
    axis.legend(frameon=False, fontsize=8, loc="center left", bbox_to_anchor=(1.01, 0.5))
    figure.tight_layout()
    _save(figure, path)
    plt.close(figure)


def _plain_ticks(axis):
    """Ticks of an axis of logarithms as plain numbers, more of them where few decades show."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    low, high = axis.get_view_interval()
    axis.set_major_locator(LogLocator(subs=(1, 2, 5) if high < 1000 * low else (1,)))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
