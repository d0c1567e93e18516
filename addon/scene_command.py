"""What commands on one scene have in common: the file among their arguments, its opening, and how they end."""

from __future__ import annotations

import os
import sys
from functools import wraps

import bpy

from .errors import Usage, told
from .files import check_outputs, open_file
from .progress import say

NO_SCENE = "no scene: name a .blend file"


def add_scene_file(parser):
    """Add the file to the arguments of a command."""
    parser.add_argument("scene_file", nargs="?", metavar="SCENE.blend", help="the file (inside Blender: the open one)")


def open_scene(arguments, *outputs):
    """Open the file of a command line, once it is known that the outputs (paths or None) can be written; returns its
    path. Without one the open file is meant. Raises Usage if there is none, Refused if something is in the way."""
    source = _named(arguments)
    if not source:
        raise Usage(NO_SCENE)
    source = os.path.abspath(source)
    outputs = [path and os.path.abspath(path) for path in outputs]
    check_outputs(outputs, inputs=[source], devices=outputs)
    if arguments.scene_file:
        open_file(source)
    return source


def exit_code(command):
    """A command that returns the exit code, and says in one line why it failed, from one that raises exceptions."""

    @wraps(command)
    def run(arguments):
        try:
            return command(arguments) or 0
        except Usage as problem:
            complain(problem)
            return 2
        except Exception as problem:
            complain(problem, _named(arguments))
            return 1

    return run


def complain(problem, source=""):
    """Say in one line on stderr why a command failed, or what went wrong with a file."""
    source = f"{source}: " if source else ""
    say(f"radiosity: {source}{told(problem)}", to=sys.stderr)


def _named(arguments):
    """The file that a command line names, or the open one; "" for a command on several files."""
    if "scene_file" not in arguments:
        return ""
    return bpy.data.filepath if arguments.scene_file is None else arguments.scene_file
