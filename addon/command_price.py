"""`radiosity price`: what accuracy costs in time, for this scene."""

from __future__ import annotations

import os
import sys
from dataclasses import replace

import bpy
import numpy as np

from ..core.bake import PRICED, bake, price, run
from ..core.cells import make_cells
from ..core.layers import layer_colors, vertex_means
from ..core.report import price_row, write_json
from .arguments import add_scene_options, count, make_options, percent
from .errors import Refused, Usage
from .files import check_writable, context_of, open_file
from .job import default_cells, wanted_by
from .plots import plot_price, pyplot
from .progress import Bar
from .read_scene import read_scene


def add(commands):
    """Add the command's parser to `commands`."""
    parser = commands.add_parser(
        "price", help="what accuracy costs in time",
        description="Foretells the seconds and the memory of bakes to several errors, from the first rays of one.",
    )  # fmt: skip
    parser.set_defaults(run=run_price)
    parser.add_argument("scene_file", nargs="?", metavar="SCENE.blend", help="the file (inside Blender: the open one)")
    parser.add_argument("--errors", type=_errors, default=PRICED, metavar="10,5,2,1,0.5", help="in percent")
    parser.add_argument("--measure", action="store_true", help="bake to each error, and measure it against the finest")
    parser.add_argument("--reference", metavar="R.npz", help="measure against this: irradiance / pi at the vertices")
    parser.add_argument("--report", metavar="R.json", help="write the list")
    parser.add_argument("--plot", metavar="P.png", help="draw error against seconds")
    parser.add_argument("--cells", type=count, default=0, metavar="N", help="processes (default: one per core)")
    add_scene_options(parser)


def run_price(arguments):
    """Print the price list of a scene; returns the exit code."""
    path = arguments.scene_file
    source = path or bpy.data.filepath
    try:
        if not source:
            raise Usage("no scene: name a .blend file")
        if arguments.plot:
            pyplot()
        for place in (arguments.report, arguments.plot):
            check_writable(place and os.path.abspath(place))
        reference = _open_reference(arguments.reference)
        if path:
            open_file(os.path.abspath(path))
        scene, targets = read_scene(context_of(arguments), wanted_by(arguments.objects))
        if not targets:
            raise Refused("there is nothing to bake")
        options = make_options(arguments)
        settings = options.settings(scene.diagonal)
        with make_cells(arguments.cells or default_cells()) as cells, Bar(quiet=arguments.quiet) as bar:
            prices = run(price(scene, settings, cells, arguments.errors), bar.show)
            rows = [price_row(p) for p in prices]
            if arguments.measure or reference is not None:
                rows = _measured(scene, targets, options, prices, cells, reference, bar)
        print("\n".join(lines(rows)), flush=True)
        if arguments.report:
            write_json({"scene": os.path.abspath(source), "price": rows}, os.path.abspath(arguments.report))
        if arguments.plot:
            plot_price(rows, os.path.abspath(arguments.plot), os.path.basename(source))
    except Usage as problem:
        print(f"radiosity: {problem}", file=sys.stderr)
        return 2
    except (Refused, OSError) as problem:
        print(f"radiosity: {source}: {problem}", file=sys.stderr)
        return 1
    return 0


def lines(rows):
    """The rows of a price list as lines of text."""
    yield f"{'error':>8}{'seconds':>10}{'memory':>11}{'measured':>12}{'error':>10}"
    for r in rows:
        took = "" if r["seconds_measured"] is None else f"{r['seconds_measured']:.2f} s"
        off = "" if r["error_measured"] is None else f"{100 * r['error_measured']:.2f} %"
        yield (f"{100 * r['error']:6.3g} %{r['seconds_predicted']:8.2f} s{r['memory_mb']:8.0f} MB{took:>12}{off:>10}")


def _errors(text):
    return tuple(percent(part) for part in text.split(","))


def _open_reference(path):
    """The arrays of a reference file, or None. Raises Refused if it cannot be read."""
    if path is None:
        return None
    try:
        return dict(np.load(path))
    except (OSError, ValueError) as problem:
        raise Refused(f"cannot read {path}: {problem}") from None


def _measured(scene, targets, options, prices, cells, reference, bar):
    """The rows of a price list with what bakes to each error took, and how far off they are: from the reference, or from
    the finest of them."""
    baked = []
    for p in prices:
        settings = replace(options, error=p.error, time=None).settings(scene.diagonal)
        baked.append(run(bake(scene, settings, cells), bar.show))
    finest = baked[int(np.argmin([p.error for p in prices]))]
    rows = []
    for p, found in zip(prices, baked):
        seconds = sum(found.seconds[phase] for phase in ("survey", "patches", "transport", "gather"))
        if reference is not None:
            off = off_reference(found, targets, reference)
        else:
            off = None if found is finest else _off(found, finest)
        rows.append(price_row(p, float(seconds), off))
    return rows


def _off(found, finest):
    """Relative error of a Bake against a finer one at the same points."""
    area, light, truth = found.points.area, found.light.total, finest.light.total
    return float(np.sqrt((area * (light - truth) ** 2).sum() / max((area * truth**2).sum(), 1e-300)))


def off_reference(found, targets, reference):
    """Relative error of a Bake against a reference: NAME.A, NAME.mask, NAME.EA and NAME.EB at the vertices of objects."""
    colors, vertex = layer_colors(found, "Lighting"), found.scene.corner_vertex
    off = truth = 0.0
    for target in targets:
        if f"{target.object}.A" not in reference:
            continue
        area, mask, one, other = (reference[f"{target.object}.{k}"] for k in ("A", "mask", "EA", "EB"))
        own = vertex[target.first : target.last]
        mean = vertex_means(colors[target.first : target.last], own - own.min(), len(area))
        area = (area * mask)[:, None]
        off += (area * (mean - one) * (mean - other)).sum()
        truth += (area * one * other).sum()
    return float(np.sqrt(max(off, 0.0) / truth)) if truth > 0 else None
