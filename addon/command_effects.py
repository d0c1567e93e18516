"""`radiosity effects`: what a scene calls for, before any bake."""

from __future__ import annotations

import os
from textwrap import wrap
from time import perf_counter

from ..core.effects import survey
from ..core.report import survey_report, write_json
from .arguments import add_scene_options, make_options
from .errors import Refused
from .files import context_of, silent
from .job import wanted_by
from .progress import answer
from .read_scene import read_scene
from .scene_command import add_scene_file, exit_code, open_scene
from .version import version

WIDTH = 112  # of a line


def add(commands):
    """Add the command's parser to `commands`."""
    effects = commands.add_parser(
        "effects", help="what a scene calls for",
        description="Says which effects of light a scene calls for at the error asked for, and why; what cannot be "
        "simulated; and what is wrong with the data.",
    )  # fmt: skip
    effects.set_defaults(run=run_effects)
    add_scene_file(effects)
    effects.add_argument("--report", metavar="R.json", help="write a report")
    add_scene_options(effects)


@exit_code
def run_effects(arguments):
    """Survey a scene."""
    source = open_scene(arguments, arguments.report)
    begun = perf_counter()
    with silent():
        scene, _ = read_scene(context_of(arguments), wanted_by(arguments.objects))
    if not len(scene.triangles):
        raise Refused("there is no mesh: no visible object with faces")
    read, settings = perf_counter() - begun, make_options(arguments).settings(scene)
    begun = perf_counter()
    found = survey(scene, settings)
    seconds = perf_counter() - begun
    if not arguments.quiet:
        answer(*lines(found), elsewhere=arguments.report)
    if arguments.report:
        report = survey_report(found, scene=source, version=version(), settings=settings, read=read, survey=seconds)
        write_json(report, os.path.abspath(arguments.report))


def lines(found):
    """A Survey as lines of text."""
    rows = [(e.name, "needed" if e.needed else "left out", e.reason) for e in found.effects]
    rows += [(name, "ignored", reason) for name, reason in found.ignored]
    rows += [(f.object, "health", f"{f.finding}; {f.action}") for f in found.health]
    first = max(len(row[0]) for row in rows)
    for name, word, reason in rows:
        text = wrap(reason, max(WIDTH - first - 12, 40)) or [""]
        yield f"{name:{first}}  {word:8}  {text[0]}"
        yield from (f"{'':{first}}  {'':8}  {line}" for line in text[1:])
