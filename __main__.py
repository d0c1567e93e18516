"""`python -m cell_radiosity`: the command line, in a Python that has the bpy module."""

import atexit
import contextlib
import os
import signal
import sys


def main():
    """Run the `radiosity` command, and end the process with its exit code."""
    _have_streams()
    signal.signal(signal.SIGINT, _cancelled)
    try:
        import bpy  # noqa: F401
    except ImportError as error:
        print(f"radiosity: Blender's Python module cannot be loaded ({error}); run `make bake` once", file=sys.stderr)
        return 1
    from .addon.command import main as command

    code = command(sys.argv[1:])
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # all is done
    # Else Blender's module can wait for a thread of its own for ever when the process ends, after exports above all.
    atexit._run_exitfuncs()
    with contextlib.suppress(OSError):
        sys.stdout.flush()
        sys.stderr.flush()
    os._exit(code)


def _have_streams():
    """Put the null device where a standard stream was closed: or else the next file that is opened takes its place."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # becomes the lowest number that is free


def _cancelled(*_):
    """End at once, while nothing has begun: Blender's start takes an interrupt for an error of its own and goes on."""
    os.write(2, b"radiosity: cancelled\n")
    os._exit(130)


if __name__ == "__main__":
    sys.exit(main())
