"""What runs on a worker of the cluster: it keeps arrays by what is in them, and runs batches of tasks over them.

Workers need the core alone, no Blender. A worker that has just joined knows nothing: a batch that finds arrays missing
comes back as it was, and the host sends them.
"""

from __future__ import annotations

import os
import platform
import threading
import traceback
from importlib.metadata import version

import numpy as np
from distributed import get_worker

from ..core.cells import run_task
from ..core.kernel import Kernel

SPARE = 2  # times what is in use may be kept for the next bake


def identity():
    """{what: version} that the bits of a result depend on, of this process."""
    try:
        from numpy._core._multiarray_umath import __cpu_features__ as features
    except ImportError:  # numpy 1
        from numpy.core._multiarray_umath import __cpu_features__ as features
    return {
        "cell_radiosity": version("cell_radiosity"),
        "numpy": np.__version__,
        "embreex": version("embreex"),
        "processor": platform.machine(),
        "CPU features": " ".join(sorted(name for name, there in features.items() if there)),
    }


def keep(arrays):
    """Keep arrays, {digest: array}; returns this worker's identity."""
    _store(get_worker()).arrays.update(arrays)
    return identity()


def missing(digests):
    """Those of some digests whose arrays are not here."""
    return [digest for digest in digests if digest not in _store(get_worker()).arrays]


def forget():
    """Let go of all arrays."""
    worker = get_worker()
    if hasattr(worker, "cell_radiosity"):
        del worker.cell_radiosity


def run_batch(names, tasks):
    """Run tasks [(id, task, arguments)] over the arrays {name: digest}.

    Returns this worker's address, process id and results: [("done", id, result, spent)] or ("error", id, traceback,
    None); None in their place if arrays are missing here.
    """
    worker = get_worker()
    store = _store(worker)
    kernel = store.kernel(names)
    if kernel is None:
        return worker.address, os.getpid(), None
    results = []
    for number, name, arguments in tasks:
        try:
            results.append(("done", number, *run_task(kernel, name, arguments)))
        except MemoryError:
            raise
        except Exception:
            results.append(("error", number, traceback.format_exc(), None))
    return worker.address, os.getpid(), results


class _Store:
    """The arrays of a worker by digest, and for each of its threads the kernel over those in use."""

    def __init__(self):
        self.arrays = {}
        self._threads, self._lock = threading.local(), threading.Lock()

    def kernel(self, names):
        """The Kernel over arrays {name: digest}; None if some are not here. What was built over the same is kept."""
        before, kernel = getattr(self._threads, "known", ({}, Kernel({})))
        if names == before:
            return kernel
        changed = {name: digest for name, digest in names.items() if before.get(name) != digest}
        if any(digest not in self.arrays for digest in changed.values()):
            return None
        kernel = kernel.renewed({name: self.arrays[digest] for name, digest in changed.items()})
        self._threads.known = dict(names), kernel
        self._tidy(names.values())
        return kernel

    def _tidy(self, used):
        """Drop arrays that were not used lately, beyond SPARE times what those in use take."""
        with self._lock:
            used = [digest for digest in used if digest in self.arrays]
            for digest in used:
                self.arrays[digest] = self.arrays.pop(digest)  # to the end: the oldest come first
            left = (1 + SPARE) * sum(self.arrays[digest].nbytes for digest in used)
            for digest in reversed(list(self.arrays)):
                left -= self.arrays[digest].nbytes
                if left < 0 and digest not in used:
                    del self.arrays[digest]


def _store(worker):
    if not hasattr(worker, "cell_radiosity"):
        worker.cell_radiosity = _Store()
    return worker.cell_radiosity
