"""`radiosity export`: a baked scene as a file for engines."""

from __future__ import annotations

import os
import sys

import bpy

from ..core.layers import LAYERS
from .errors import Refused
from .export import export_scene, kind_of
from .files import check_writable, open_file, silent


def add(commands):
    """Add the command's parser to `commands`."""
    export = commands.add_parser(
        "export", help="write glTF or USD", description="Export the meshes of a baked scene with their vertex colors."
    )
    export.set_defaults(run=run_export)
    export.add_argument("scene", nargs="?", metavar="LIT.blend", help="a baked file (inside Blender: the open one)")
    export.add_argument("-o", "--output", required=True, metavar="OUT.glb", help=".glb, .gltf, .usd, .usda or .usdc")
    export.add_argument("--layer", default=LAYERS[0], metavar="NAME", help=f"what to export (default: {LAYERS[0]})")
    export.add_argument("--quiet", action="store_true", help="say nothing")


def run_export(arguments):
    """Export the scene of the command line; returns the exit code."""
    if not arguments.scene and not bpy.data.filepath:
        print("radiosity: no scene: name a .blend file", file=sys.stderr)
        return 2
    output = os.path.abspath(arguments.output)
    try:
        kind_of(output)
        check_writable(output)
        if arguments.scene:
            open_file(os.path.abspath(arguments.scene))
        with silent():
            scale = export_scene(bpy.context, output, arguments.layer)
    except (Refused, OSError) as problem:
        print(f"radiosity: {arguments.scene or bpy.data.filepath}: {problem}", file=sys.stderr, flush=True)
        return 1
    if not arguments.quiet:
        print(f"{os.path.basename(output)}: {arguments.layer} divided by {scale:.6g}", flush=True)
    return 0
