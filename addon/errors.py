"""The errors that users see."""

from __future__ import annotations

import os
import re
from traceback import format_exception

from ..core.cells import CellError
from .version import version

PACKAGE = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))


class Refused(Exception):
    """The bake cannot start or cannot end well; the message names the object, what was found, and what to do."""


class Usage(Exception):
    """The command line asks for what cannot be had."""


def check_memory(needed, budget, what):
    """Raise Refused if what is needed is more than the budget [bytes]. what: there is, and what would be less."""
    if needed > budget:
        raise Refused(f"{what}, or a --memory of {needed / 1e9:.3g}G instead of {budget / 1e9:.3g}G, would do")


def told(problem):
    """What an exception says, in one line: of one that nobody foresaw also where it was raised."""
    if isinstance(problem, (Refused, Usage)):
        text = str(problem)
    elif isinstance(problem, OSError):
        text = problem.strerror or str(problem)
        text = f"{problem.filename}: {text}" if problem.filename else text
    elif isinstance(problem, MemoryError):
        text = "there is not enough memory: ask for larger patches or fewer texels, vertices or cells"
    else:
        trace = "".join(format_exception(problem))
        what = trace.splitlines()[-1] if isinstance(problem, CellError) else f"{type(problem).__name__}: {problem}"
        place = re.findall(r'File "(.*)", line (\d+)', trace)
        own = [(path, line) for path, line in place if path.startswith(PACKAGE)] or place
        where = f" ({os.path.relpath(own[-1][0], PACKAGE)}, line {own[-1][1]})" if own else ""
        text = f"{what}{where}; this is a mistake of Cell Radiosity {version()}: please report it"
    return one_line(text)


def one_line(text):
    """Text without line breaks, which names and paths may hold."""
    return " ".join(text.splitlines())
