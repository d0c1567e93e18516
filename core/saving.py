"""Files that are written whole or not at all: what was there before stays until then."""

from __future__ import annotations

import contextlib
import errno
import os
import re
import shutil
import sys
from time import time

UNTOUCHED = 60.0  # seconds: a younger leftover may be the file of a process on another machine that shares the folder


@contextlib.contextmanager
def written_whole(path, suffix=""):
    """The path of a new file beside `path`, whose name ends in the suffix, and which takes its place in the end; if
    anything fails, it is removed, and if the process is killed, by the next that writes `path`. What is no ordinary
    file (a device, a pipe) is written itself. Raises OSError with the path."""
    if os.path.isdir(path):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), path)
    ordinary = os.path.isfile(path) or not os.path.exists(path)
    place = os.path.realpath(path)  # a link stays one
    temporary = f"{place}.tmp{os.getpid()}{suffix}" if ordinary else path
    if ordinary:
        _sweep(place, suffix)
    try:
        yield temporary
        if ordinary:
            if os.path.exists(place):
                shutil.copymode(place, temporary)  # who may read it stays as it was
            os.replace(temporary, place)
    except OSError as problem:
        raise OSError(problem.errno, problem.strerror or str(problem), path) from problem
    finally:
        if ordinary:
            with contextlib.suppress(OSError):
                os.remove(temporary)


@contextlib.contextmanager
def written_together(path, _=""):
    """As `written_whole`, for a file that comes with others: the path of that name in a new folder. What is in the
    folder in the end goes to where `path` is, that file last."""
    place = os.path.realpath(path)
    folder, name = os.path.split(place)
    temporary = f"{place}.tmp{os.getpid()}"
    _sweep(place)
    try:
        os.mkdir(temporary)
        yield os.path.join(temporary, name)
        for other in sorted(os.listdir(temporary), key=lambda n: n == name):
            os.replace(os.path.join(temporary, other), os.path.join(folder, other))
    except OSError as problem:
        raise OSError(problem.errno, problem.strerror or str(problem), path) from problem
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _sweep(place, suffix=""):
    """Remove what processes that were killed while they wrote `place` have left beside it."""
    folder, name = os.path.split(place)
    ours = re.compile(re.escape(name) + r"\.tmp(\d+)" + re.escape(suffix) + "@?")  # Blender adds the @ while it saves
    with contextlib.suppress(OSError):
        for other in os.listdir(folder):
            left = ours.fullmatch(other)
            if left and not _alive(int(left[1])):
                _remove_untouched(os.path.join(folder, other))


def _remove_untouched(path):
    """Remove a file, or a folder with all that is in it, if nothing of it has changed of late."""
    with contextlib.suppress(OSError):
        inside = [os.path.join(path, name) for name in os.listdir(path)] if os.path.isdir(path) else []
        if max(os.stat(p).st_mtime for p in (path, *inside)) > time() - UNTOUCHED:
            return
        if os.path.isdir(path):
            shutil.rmtree(path)
        else:
            os.remove(path)


def _alive(process):
    """Whether a process with this id may be running, other than this one."""
    if process == os.getpid():
        return False
    if sys.platform == "win32":  # there a signal of 0 would be an interrupt
        import ctypes

        kernel, synchronize, still_running = ctypes.windll.kernel32, 0x100000, 258
        handle = kernel.OpenProcess(synchronize, False, process)
        if not handle:
            return kernel.GetLastError() == 5  # it is there, and not ours to look at
        try:
            return kernel.WaitForSingleObject(handle, 0) == still_running
        finally:
            kernel.CloseHandle(handle)
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        return True
    return True
