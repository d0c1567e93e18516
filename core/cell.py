"""A cell at work: takes tasks from its pipe, runs them one by one, sends the results.

Three threads, so that neither side ever waits for the other: one reads ahead, one works, one writes (and gives a sign
of life every second while there is work). When the host is gone, however it went, the cell ends at once.
"""

from __future__ import annotations

import multiprocessing
import os
import queue
import signal
import threading
import traceback
from multiprocessing import connection

from .cells import run_task, unpacked
from .kernel import Kernel

BEAT = 1.0  # seconds between signs of life


def serve(pipe):
    """Serve the host at the other end of `pipe` until it closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the host's to handle
    inbox, outbox, busy = queue.SimpleQueue(), queue.SimpleQueue(), threading.Event()
    threading.Thread(target=_read, args=(pipe, inbox), daemon=True).start()
    threading.Thread(target=_write, args=(pipe, outbox, busy), daemon=True).start()
    kernel = Kernel({})
    while True:
        kind, *rest = inbox.get()
        if kind == "arrays":
            kernel = kernel.renewed(*rest)
            continue
        number, name, arguments = rest
        busy.set()
        try:
            outbox.put(("done", number, *run_task(kernel, name, arguments)))
        except MemoryError:
            os._exit(4)  # the host deals the task again, to a fresh cell
        except Exception:
            outbox.put(("error", number, traceback.format_exc(), None))
        if inbox.empty():
            busy.clear()


def _read(pipe, inbox):
    """Pass on what the host sends; end the process when the host does."""
    parent = multiprocessing.parent_process()
    ends = [pipe] if parent is None else [pipe, parent.sentinel]
    try:
        while pipe in connection.wait(ends):
            inbox.put(unpacked(pipe))
    except (EOFError, OSError):
        pass
    os._exit(3)


def _write(pipe, outbox, busy):
    """Send results, and signs of life while there is work."""
    try:
        while True:
            try:
                pipe.send(outbox.get(timeout=BEAT))
            except queue.Empty:
                if busy.is_set():
                    pipe.send(("alive",))
    except OSError:
        os._exit(3)
