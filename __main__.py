"""`python -m cell_radiosity`: the command line, in a Python that has the bpy module."""

import sys


def main():
    """Run the `radiosity` command; returns its exit code."""
    try:
        import bpy  # noqa: F401
    except ImportError as error:
        print(f"radiosity: Blender's Python module cannot be loaded ({error}); run `make bake` once", file=sys.stderr)
        return 1
    from .addon.command import main as command

    return command(sys.argv[1:])


if __name__ == "__main__":
    sys.exit(main())
