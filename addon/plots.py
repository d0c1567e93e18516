"""Plots of measurements, with matplotlib, which the extension does not carry: the command line's own Python has it."""

from __future__ import annotations

from .errors import Usage

COLORS = {"paper": "#b5523b", "dynamic": "#2f6f9f"}
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
    figure.savefig(path)
    plt.close(figure)


def plot_price(rows, path, title):
    """Error against seconds, foretold and measured."""
    plt = pyplot()
    figure, axis = plt.subplots(figsize=(5, 3.8))
    axis.plot(
        [r["seconds_predicted"] for r in rows], [100 * r["error"] for r in rows], color=COLORS["dynamic"], marker="o",
        ms=4, label="foretold",
    )  # fmt: skip
    known = [r for r in rows if r["seconds_measured"] is not None and r["error_measured"]]
    if known:
        axis.plot(
            [r["seconds_measured"] for r in known], [100 * r["error_measured"] for r in known], color=COLORS["paper"],
            ls="", marker="s", ms=5, label="measured",
        )  # fmt: skip
    axis.set(xscale="log", yscale="log", xlabel="seconds", ylabel="error in percent", title=title)
    axis.legend(frameon=False)
    figure.tight_layout()
    figure.savefig(path)
    plt.close(figure)
