"""`radiosity price`: what accuracy costs in time, for this scene."""

from __future__ import annotations

import os
import sys
from dataclasses import replace
from itertools import zip_longest
from math import inf

import numpy as np

from ..core.bake import bake, price, run
from ..core.compare import of_all, of_objects, parts_off_finer, parts_off_reference
from ..core.health import mend
from ..core.knobs import knob_values, slope, turns
from ..core.prices import PRICED
from ..core.report import price_row, write_json
from .arguments import add_scene_options, count, make_options, percent
from .cluster import add_cluster_options, cells_for
from .errors import Refused, told
from .files import context_of, silent
from .job import check_scene, wanted_by
from .plots import check_plot, knob_value, plot_price
from .progress import Bar, answer, say
from .read_scene import read_scene
from .scene_command import add_scene_file, exit_code, open_scene

SOME_RAYS = 100  # of a point: how many knobs can be turned how often does not depend on it


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
    parser.add_argument(
        "--plot", metavar="P.png", help="draw error against seconds; with --measure, what each knob does alone too"
    )
    parser.add_argument("--cells", type=count, default=0, metavar="N", help="processes (default: one per core)")
    add_cluster_options(parser)
    add_scene_options(parser)


@exit_code
def run_price(arguments):
    """Print the price list of a scene."""
    if arguments.plot:
        check_plot(arguments.plot)
    reference = _open_reference(arguments.reference)
    source = open_scene(arguments, arguments.report, arguments.plot)
    with silent():
        scene, targets = read_scene(context_of(arguments), wanted_by(arguments.objects))
    options, scene = make_options(arguments), mend(scene)
    check_scene(scene, targets, options)
    settings = options.settings(scene)
    knobs, falls, objects = [], None, []
    with cells_for(arguments, arguments.cells) as cells, Bar(quiet=arguments.quiet) as bar:
        _await(cells)
        prices = run(price(scene, settings, cells, arguments.errors), bar.show)
        rows = [price_row(p) for p in prices]
        if arguments.measure or reference is not None:
            if not arguments.quiet:
                _announce(len(rows), 1 + len(turns(settings, SOME_RAYS)) if arguments.plot else 0)
            rows, objects, off = _measured(scene, options, prices, cells, reference, bar)
            if arguments.plot:
                knobs = _turned(scene, settings, cells, off, bar)
    answer(*lines(rows, objects), elsewhere=arguments.report)
    if arguments.plot:
        falls = slope(_pairs(rows))
        answer(*knob_lines(knobs, falls), elsewhere=arguments.report)
        plot_price(rows, objects, knobs, falls, os.path.abspath(arguments.plot), os.path.basename(source))
    if arguments.report:
        report = {"scene": source, "price": rows, "objects": objects, "knobs": knobs, "slope": falls}
        write_json(report, os.path.abspath(arguments.report))


def lines(rows, objects=()):
    """The rows of a price list as lines of text. objects: {object: error} as measured in each, with the worst told."""
    told = f"{'error':>8}{'seconds':>10}{'memory':>11}{'measured':>12}{'error':>10}"
    yield told + ("  least exact object" if any(objects) else "")
    for r, errors in zip_longest(rows, objects, fillvalue={}):
        took = "" if r["seconds_measured"] is None else f"{r['seconds_measured']:.2f} s"
        off, worst = _percent(r["error_measured"]), max(errors, key=errors.get, default=None)
        told = f"{100 * r['error']:6.3g} %{r['seconds_predicted']:8.2f} s{r['memory_mb']:8.0f} MB{took:>12}{off:>10}"
        yield told + (f"{_percent(errors[worst]):>10}, {worst}" if errors else "")


def knob_lines(knobs, falls):
    """What each knob does alone, as lines of text, and how steeply the error falls."""
    if knobs:
        yield f"{'one knob alone':28}{'patches':>10}{'rays':>10}{'seconds':>10}{'error':>10}"
    for k in [k for k in knobs if k["chosen"]][:1] + [k for k in knobs if not k["chosen"]]:
        name = "none: as the error chose" if k["chosen"] else f"{k['knob']}: {knob_value(k)}"
        yield f"{name:28}{k['patches']:>10}{k['rays'] / 1e6:>8.2f} M{k['seconds']:>8.2f} s{_percent(k['error']):>10}"
    if falls is not None:
        yield f"error falls as seconds to the power of {falls:.2f}"


def _percent(error):
    return "" if error is None else f"{100 * error:.2f} %"


def _pairs(rows):
    """(seconds, error) of a price list, as they were measured, or else foretold."""
    measured = [(r["seconds_measured"], r["error_measured"]) for r in rows if r["error_measured"]]
    return measured or [(r["seconds_predicted"], r["error"]) for r in rows]


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
    the finest of them. Also {object: error} of each, and the function that tells the former of a Bake."""
    baked = []
    for p in prices:
        settings = replace(options, error=p.error, time=None).settings(scene)
        baked.append(run(bake(scene, settings, cells), bar.show))
    finest = baked[int(np.argmin([p.error for p in prices]))]

    def parts(found):
        if reference is None:
            return {} if found is finest else parts_off_finer(found, finest)
        try:
            return parts_off_reference(found, reference)
        except (KeyError, ValueError):  # arrays that are not there, or of another size
            raise Refused("the reference does not fit: it is of another scene, or another kind of file") from None

    off = [parts(found) for found in baked]
    rows = [price_row(p, _seconds(found), of_all(parts)) for p, found, parts in zip(prices, baked, off)]
    return rows, [of_objects(parts) for parts in off], lambda found: of_all(parts(found))


def _await(cells):
    """Wait until cells run: a price is of such."""
    cells.take([cells.submit("wait", seconds=0.0, sizes=np.zeros(0, int)) for _ in range(cells.count)])


def _announce(errors, more):
    """Say how many bakes are to come."""
    turned = f", and {more} to turn each knob alone" if more else ""
    say(f"{errors} bakes to measure{turned}", to=sys.stderr)


def _turned(scene, settings, cells, off, bar):
    """What each knob does alone around the settings that an error has chosen: [{knob, value, chosen, patches, rays,
    seconds, error}], knob by knob from the cheapest to the dearest. off: of a Bake. All have another seed than the finest
    that they may be held against."""
    settings = replace(settings, seconds=None, seed=settings.seed + 1)
    chosen = run(bake(scene, settings, cells), bar.show)
    rays = int(sum(r.rays for r in chosen.state().gathered.replicates if r.asked.all()))
    values, error = knob_values(chosen.settings, rays), off(chosen)
    baked = [
        (turn.knob, turn.value, run(bake(scene, turn.settings, cells), bar.show))
        for turn in turns(chosen.settings, rays)
    ]
    rows = []
    for knob in dict.fromkeys(knob for knob, _, _ in baked):
        own = [(value, found) for name, value, found in baked if name == knob] + [(values[knob], chosen)]
        own.sort(key=lambda pair: inf if pair[0] is None else -pair[0] if knob == "patches" else pair[0])
        for value, found in own:
            rows.append(dict(
                knob=knob, value=value * scene.focus if knob == "patches" else value, chosen=found is chosen,
                patches=len(found.patches), rays=found.rays, seconds=_seconds(found),
                error=error if found is chosen else off(found),
            ))  # fmt: skip
    return rows


def _seconds(found):
    """Wall seconds of a Bake, as a price list has them."""
    return float(sum(found.seconds[phase] for phase in ("survey", "patches", "transport", "gather")))
