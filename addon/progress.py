"""What a command tells while it works and when it is done: a bar on a terminal, plain lines in a log.

Where nobody can read it any more (a pipe that was closed, a log on a full disk), the work goes on all the same.
"""

from __future__ import annotations

import sys
from contextlib import suppress
from time import monotonic

from tqdm import tqdm

from .errors import one_line

PAUSE = 5.0  # seconds between the lines of a log


class Bar:
    """Shows Progress records on stderr; a context manager that ends its line."""

    def __init__(self, quiet=False):
        self._quiet, self._phase, self._shown = quiet, None, 0.0
        self._bar = None
        if not quiet and sys.stderr.isatty():
            self._bar = tqdm(total=1.0, leave=False, bar_format="{percentage:3.0f} % |{bar:24}| {desc}")

    def __enter__(self):
        return self

    def __exit__(self, *_):
        if self._bar:
            with suppress(OSError):
                self._bar.close()

    def show(self, progress):
        """Show where the bake stands; in a log only now and then."""
        with suppress(OSError):
            if self._bar:
                self._bar.n = progress.done
                self._bar.set_description_str(progress_text(progress))
            elif not self._quiet and (progress.phase != self._phase or monotonic() - self._shown > PAUSE):
                self._shown, self._phase = monotonic(), progress.phase
                say(f"{100 * progress.done:3.0f} %  {progress_text(progress)}", to=sys.stderr)


def say(*lines, to=None):
    """Print lines about what was done, or what is being done (to: sys.stderr)."""
    with suppress(OSError):
        print("\n".join(map(one_line, lines)), file=to, flush=True)


def answer(*lines, elsewhere=None):
    """Print lines that were asked for. elsewhere: a file that has what they say too, or None: then OSError is raised where they
    cannot be written, but for a pipe whose reader has read enough."""
    try:
        print("\n".join(map(one_line, lines)), flush=True)
    except BrokenPipeError:
        pass
    except OSError as problem:
        if not elsewhere:
            raise OSError(problem.errno, problem.strerror, "standard output") from problem


def progress_text(progress):
    """Where a bake stands, in words."""
    parts = [progress.phase]
    if progress.round:
        parts.append(f"round {progress.round}")
    if progress.bound is not None:
        parts.append(f"bound {100 * progress.bound:.3g} %")
    if progress.rays and progress.seconds:
        parts.append(f"{progress.rays / progress.seconds / 1e6:.2f} Mrays/s")
    if progress.left is not None:
        parts.append(f"{progress.left:.0f} s left")
    return ", ".join(parts)


def summary(bake):
    """One line about a finished bake."""
    wall = sum(bake.seconds[k] for k in ("survey", "patches", "transport", "gather"))
    return (
        f"{len(bake.points)} points, {len(bake.patches)} patches, {bake.rays / 1e6:.2f} M rays in {wall:.2f} s"
        f" ({len(bake.solution.rounds)} rounds, bound {100 * bake.solution.bound:.2g} %)"
    )
