"""Files that are written whole or not at all: what was there before stays until then."""

from __future__ import annotations

import contextlib
import errno
import os
import shutil


@contextlib.contextmanager
def written_whole(path, suffix=""):
    """The path of a new file beside `path`, whose name ends in the suffix, and which takes its place in the end; if anything
    fails, it is removed. What is no ordinary file (a device, a pipe) is written itself. Raises OSError with the path."""
    if os.path.isdir(path):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), path)
    ordinary = os.path.isfile(path) or not os.path.exists(path)
    place = os.path.realpath(path)  # a link stays one
    temporary = f"{place}.tmp{os.getpid()}{suffix}" if ordinary else path
    try:
        yield temporary
        if ordinary:
            os.replace(temporary, place)
    except OSError as problem:
        raise OSError(problem.errno, problem.strerror or str(problem), path) from problem
    finally:
        if ordinary:
            with contextlib.suppress(OSError):
                os.remove(temporary)


@contextlib.contextmanager
def written_together(path, _=""):
    """As `written_whole`, for a file that comes with others: the path of that name in a new folder. What is in the folder in
    the end goes to where `path` is, that file last."""
    place = os.path.realpath(path)
    folder, name = os.path.split(place)
    temporary = f"{place}.tmp{os.getpid()}"
    try:
        os.mkdir(temporary)
        yield os.path.join(temporary, name)
        for other in sorted(os.listdir(temporary), key=lambda n: n == name):
            os.replace(os.path.join(temporary, other), os.path.join(folder, other))
    except OSError as problem:
        raise OSError(problem.errno, problem.strerror or str(problem), path) from problem
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
