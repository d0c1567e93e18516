"""`radiosity price`: what accuracy costs in time, for this scene."""

from __future__ import annotations

import os
from dataclasses import replace

import numpy as np

from ..core.bake import PRICED, bake, price, run
from ..core.compare import off_finer, off_reference
from ..core.health import mend
from ..core.report import price_row, write_json
from .arguments import add_scene_options, count, make_options, percent
from .cluster import add_cluster_options, cells_for
from .errors import Refused, told
from .files import context_of
from .job import check_scene, wanted_by
from .plots import plot_price, pyplot
from .progress import Bar
from .read_scene import read_scene
from .scene_command import add_scene_file, exit_code, open_scene


def add(commands):
    """Add the command's parser to `commands`."""
    parser = commands.add_parser(
        "price", help="what accuracy costs in time",
        description="Foretells the seconds and the memory of bakes to several errors, from the first rays of one.",
    )  # fmt: skip
    parser.set_defaults(run=run_price)
    add_scene_file(parser)
    parser.add_argument("--errors", type=_errors, default=PRICED, metavar="10,5,2,1,0.5", help="in percent")
    parser.add_argument("--measure", action="store_true", help="bake to each error, and measure it against the finest")
    parser.add_argument("--reference", metavar="R.npz", help="measure against this: irradiance / pi at the vertices")
    parser.add_argument("--report", metavar="R.json", help="write the list")
    parser.add_argument("--plot", metavar="P.png", help="draw error against seconds")
    parser.add_argument("--cells", type=count, default=0, metavar="N", help="processes (default: one per core)")
    add_cluster_options(parser)
    add_scene_options(parser)


@exit_code
def run_price(arguments):
    """Print the price list of a scene."""
    if arguments.plot:
        pyplot()
    reference = _open_reference(arguments.reference)
    source = open_scene(arguments, arguments.report, arguments.plot)
    scene, targets = read_scene(context_of(arguments), wanted_by(arguments.objects))
    options, scene = make_options(arguments), mend(scene)
    check_scene(scene, targets, options)
    settings = options.settings(scene)
    with cells_for(arguments, arguments.cells) as cells, Bar(quiet=arguments.quiet) as bar:
        prices = run(price(scene, settings, cells, arguments.errors), bar.show)
        rows = [price_row(p) for p in prices]
        if arguments.measure or reference is not None:
            rows = _measured(scene, options, prices, cells, reference, bar)
    print("\n".join(lines(rows)), flush=True)
    if arguments.report:
        write_json({"scene": source, "price": rows}, os.path.abspath(arguments.report))
    if arguments.plot:
        plot_price(rows, os.path.abspath(arguments.plot), os.path.basename(source))


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
        with np.load(path) as file:
            return dict(file)
    except OSError as problem:
        raise Refused(f"cannot read {told(problem)}") from None
    except Exception:  # whatever numpy and zipfile make of it
        raise Refused(f"cannot read {path}: it is not a file of arrays (.npz), or is damaged") from None


def _measured(scene, options, prices, cells, reference, bar):
    """The rows of a price list with what bakes to each error took, and how far off they are: from the reference, or from
    the finest of them."""
    baked = []
    for p in prices:
        settings = replace(options, error=p.error, time=None).settings(scene)
        baked.append(run(bake(scene, settings, cells), bar.show))
    finest = baked[int(np.argmin([p.error for p in prices]))]
    rows = []
    for p, found in zip(prices, baked):
        seconds = sum(found.seconds[phase] for phase in ("survey", "patches", "transport", "gather"))
        if reference is not None:
            try:
                off = off_reference(found, reference)
            except (KeyError, ValueError):  # arrays that are not there, or of another size
                raise Refused("the reference does not fit: it is of another scene, or another kind of file") from None
        else:
            off = None if found is finest else off_finer(found, finest)
        rows.append(price_row(p, float(seconds), off))
    return rows
