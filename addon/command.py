"""The command line: `radiosity bake SCENE.blend ...`, the same in a shell and as `blender --command radiosity ...`.

Exit codes: 0 done; 1 failed, with one clear line on stderr; 2 usage; 130 cancelled. Every command has a module of its
own, `command_NAME.py`, that adds its parser and runs it.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys

from . import command_bake, command_cells, command_effects, command_export, command_price, command_relight
from .version import version

COMMANDS = (command_bake, command_cells, command_effects, command_export, command_price, command_relight)


def main(argv):
    """Run the command line `argv` (without the program's name); returns the exit code."""
    _write_anything()
    # Blender swallows Ctrl-C otherwise; who is told to end keeps what is finished, too.
    previous = {kind: signal.signal(kind, signal.default_int_handler) for kind in (signal.SIGINT, signal.SIGTERM)}
    try:
        parser = _parser()
        for text in argv:
            if text.startswith("--") and text.endswith("=--"):  # argparse would take it for an empty list
                parser.error(f"argument {text[:-3]}: '--' is not a value")
        arguments = parser.parse_args(argv)
        return arguments.run(arguments)
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else 2
    except KeyboardInterrupt:
        print("radiosity: cancelled", file=sys.stderr, flush=True)
        return 130
    finally:
        for kind, handler in previous.items():
            if handler is not None:  # None: a handler that is not Python's and cannot be put back
                signal.signal(kind, handler)


def _write_anything():
    """Let names be printed that the terminal's encoding lacks, and anything where there is no stream at all."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115
        elif hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")


def _parser():
    parser = argparse.ArgumentParser("radiosity", description="Bakes interreflected light into Blender meshes.")
    parser.add_argument("--version", action="version", version=version())
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    for command in COMMANDS:
        command.add(commands)
    return parser
