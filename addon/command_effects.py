"""`radiosity effects`: what a scene calls for, before any bake."""

from __future__ import annotations

import os
import sys
from textwrap import wrap
from time import perf_counter

import bpy

from ..core.effects import survey
from ..core.report import survey_report, write_json
from .arguments import add_scene_options, make_options
from .errors import Refused, Usage
from .files import check_writable, context_of, open_file
from .job import wanted_by
from .read_scene import read_scene
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
    effects.add_argument("scene_file", nargs="?", metavar="SCENE.blend", help="the file (inside Blender: the open one)")
    effects.add_argument("--report", metavar="R.json", help="write a report")
    add_scene_options(effects)


def run_effects(arguments):
    """Survey a scene; returns the exit code."""
    path = arguments.scene_file
    source = path or bpy.data.filepath
    try:
        if not source:
            raise Usage("no scene: name a .blend file")
        check_writable(arguments.report and os.path.abspath(arguments.report))
        if path:
            open_file(os.path.abspath(path))
        begun = perf_counter()
        scene, _ = read_scene(context_of(arguments), wanted_by(arguments.objects))
        if not len(scene.triangles):
            raise Refused("there is no mesh: no visible object with faces")
        read, settings = perf_counter() - begun, make_options(arguments).settings(scene.diagonal)
        begun = perf_counter()
        found = survey(scene, settings)
        seconds = perf_counter() - begun
        if not arguments.quiet:
            print("\n".join(lines(found)), flush=True)
        if arguments.report:
            report = survey_report(
                found, scene=os.path.abspath(source), version=version(), settings=settings, read=read, survey=seconds
            )
            write_json(report, os.path.abspath(arguments.report))
    except Usage as problem:
        print(f"radiosity: {problem}", file=sys.stderr)
        return 2
    except (Refused, OSError) as problem:
        print(f"radiosity: {source}: {problem}", file=sys.stderr)
        return 1
    return 0


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
