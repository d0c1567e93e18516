"""`radiosity export`: a baked scene as a file for engines."""

from __future__ import annotations

import os

import bpy

from ..core.layers import LAYERS
from .export import export_scene, kind_of
from .files import silent
from .progress import say
from .scene_command import exit_code, open_scene


def add(commands):
    """Add the command's parser to `commands`."""
    export = commands.add_parser(
        "export", help="write glTF or USD", description="Export the meshes of a baked scene with their vertex colors."
    )
    export.set_defaults(run=run_export)
    export.add_argument(
        "scene_file", nargs="?", metavar="LIT.blend", help="a baked file (inside Blender: the open one)"
    )
    export.add_argument("-o", "--output", required=True, metavar="OUT.glb", help=".glb, .gltf, .usd, .usda or .usdc")
    export.add_argument("--layer", default=LAYERS[0], metavar="NAME", help=f"what to export (default: {LAYERS[0]})")
    export.add_argument("--quiet", action="store_true", help="say nothing")


@exit_code
def run_export(arguments):
    """Export the scene of the command line."""
    output = os.path.abspath(arguments.output)
    kind_of(output)
    open_scene(arguments, output)
    with silent():
        scale = export_scene(bpy.context, output, arguments.layer)
    if not arguments.quiet:
        say(f"{os.path.basename(output)}: {arguments.layer} divided by {scale:.6g}")
