"""`python -m cell_radiosity`: the command line, in a Python that has the bpy module."""

import atexit
import os
import sys


def main():
    """Run the `radiosity` command; returns its exit code."""
    try:
        import bpy  # noqa: F401
    except ImportError as error:
        print(f"radiosity: Blender's Python module cannot be loaded ({error}); run `make bake` once", file=sys.stderr)
        return 1
    from .addon.command import main as command

    code = command(sys.argv[1:])
    if "io_scene_gltf2" in sys.modules:
        # After a glTF export Blender's module can wait for a thread of its own for ever when the process ends.
        atexit._run_exitfuncs()
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    return code


if __name__ == "__main__":
    sys.exit(main())
