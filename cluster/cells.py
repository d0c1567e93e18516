"""Cells that are the workers of a Dask cluster, on this machine or on many.

Owns what Dask does not: many small tasks go into one of Dask's, a bounded number of these is under way at a time, each
result is let go as soon as it is here, and the host keeps what it has sent. So a worker may die, hang, leave or join at
any time; the bits are those of cells of any other kind. Transport, encryption and scheduling are Dask's own.
"""

from __future__ import annotations

import queue
import warnings
from collections import deque
from contextlib import suppress
from hashlib import blake2b
from time import monotonic

import dask
import numpy as np
from distributed import Client, LocalCluster, wait

from ..core.cells import CellError, Cells
from .worker import forget, identity, keep, missing, run_batch

BATCH_SECONDS = 0.3  # of one of Dask's tasks: its own cost is some milliseconds
UNDER_WAY = 2  # of Dask's tasks per worker thread
PATIENCE = 30.0  # seconds without a result from a worker that has work, after which others get it too
ANSWER = 10.0  # seconds for a scheduler to answer
WAIT = 60.0  # seconds without any worker, after which the bake is given up
FAREWELL = 3.0  # seconds for workers to let go of what they kept
ATTEMPTS = 4  # at a batch that ends its worker
# Workers that are started here keep the memory of one task for the next: Dask's usual ones give it back at once, and their
# tasks take a quarter longer.
OF_WORKERS = {"distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": None}


class ClusterError(OSError):
    """The cluster cannot be reached, is gone, or is not what this machine is; the message says what to do."""


def connect(address, allow_mixed=False):
    """Cells on the cluster of a scheduler's address ("tcp://host:8786"), or on one started here ("local:4", 4 workers)
    that ends with them. allow_mixed: accept workers whose results may differ in the last bits from this machine's."""
    kind, _, number = address.partition(":")
    started = None
    try:
        if kind == "local":
            if not number.isdigit() or not int(number):
                raise ClusterError(f"--cluster {address}: write local:N, N the number of workers")
            with dask.config.set(OF_WORKERS):
                started = LocalCluster(
                    n_workers=int(number), threads_per_worker=1, host="127.0.0.1", dashboard_address=None,
                    silence_logs=50,
                )  # fmt: skip
            client = Client(started, set_as_default=False)
        else:
            client = Client(address, timeout=ANSWER, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as problem:
        raise ClusterError(f"--cluster {address}: no scheduler answers there ({problem})") from None
    try:
        return DaskCells(client, started, allow_mixed)
    except BaseException:
        client.close()
        if started:
            started.close()
        raise


class DaskCells(Cells):
    """Cells that are the workers of a Dask client's cluster. started: the cluster, if it is to end with them.

    Raises ClusterError if there is no worker, or if workers are not what the host is and `allow_mixed` is not given.
    """

    in_turn = True
    flow_each = 64  # enough for Dask's tasks that are under way, and as many again
    _identity = staticmethod(identity)  # of the host

    def __init__(self, client, started=None, allow_mixed=False):
        super().__init__()
        # Tasks are small; what is large on purpose is sent to see how long that takes.
        warnings.filterwarnings("ignore", "Sending large graph", UserWarning, "distributed")
        self._client, self._started, self._mixed = client, started, allow_mixed
        self._arrays, self._names = {}, {}
        self._waiting, self._batches, self._done = deque(), {}, queue.SimpleQueue()
        self._heard, self._avoided, self._seen = {}, set(), set()
        self._task_seconds, self._nobody = None, None
        self._workers = {}
        self._await_workers()
        self._check(client.run(identity, on_error="return"))

    def start(self, arrays):
        for name, array in arrays.items():
            array = np.ascontiguousarray(array)
            digest = blake2b(array.data.cast("B") if array.size else b"", digest_size=16)
            digest.update(str((array.dtype.str, array.shape)).encode())
            self._names[name] = digest.hexdigest()
            self._arrays[self._names[name]] = array
        # A worker gets what it lacks when it first finds that it does: one that hangs holds up nobody.
        self._arrays = {digest: self._arrays[digest] for digest in self._names.values()}

    def submit(self, name, **arguments):
        self._waiting.append((self._next, name, arguments))
        self._next += 1
        return self._next - 1

    def results(self):
        while self._ready or self._waiting or self._batches:
            if self._ready:  # a batch brings many, and who asks may stop at any of them
                yield self._ready.popleft()
                continue
            self._deal()
            try:
                key = self._done.get(timeout=1.0)
            except queue.Empty:
                self._look_around()
                continue
            batch = self._batches.pop(key, None)
            if batch is not None:
                self._collect(batch)

    def clear(self):
        self._waiting.clear()
        self._ready.clear()
        self._kept.clear()
        with suppress(Exception):
            self._client.cancel([batch.future for batch in self._batches.values()], force=True)
        self._batches = {}

    def stop(self):
        self.clear()
        with suppress(Exception):
            usable = [address for address in self._workers if address not in self._avoided]
            wait([self._client.submit(forget, workers=[address], pure=False) for address in usable], timeout=FAREWELL)
        self._client.close()
        if self._started:
            self._started.close()

    def _deal(self):
        """Send batches of waiting tasks while few are under way: of BATCH_SECONDS each, smaller toward the end."""
        self._find_workers()
        while self._waiting and len(self._batches) < UNDER_WAY * max(self.count, 1):
            share = -(-len(self._waiting) // (UNDER_WAY * max(self.count, 1)))
            size = min(int(BATCH_SECONDS / self._task_seconds) if self._task_seconds else 1, share)
            tasks = [self._waiting.popleft() for _ in range(min(max(size, 1), len(self._waiting)))]
            self._launch(_Batch(tasks))

    def _launch(self, batch, again=False):
        """Give a batch to Dask, for any worker that is not avoided; `again` if the last time was not its own fault."""
        batch.attempts, batch.begun = batch.attempts + (not again), monotonic()
        usable = [address for address in self._workers if address not in self._avoided]
        self._alive()
        batch.future = self._client.submit(
            run_batch, dict(self._names), batch.tasks, pure=False, retries=0,
            workers=usable if self._avoided and usable else None,
        )  # fmt: skip
        self._batches[batch.future.key] = batch
        batch.future.add_done_callback(lambda future: self._done.put(future.key))

    def _collect(self, batch):
        """Take the results of a batch that is done; deal it again where its worker is gone or lacks the arrays."""
        future, begun = batch.future, monotonic()
        try:
            address, process, results = future.result(timeout=PATIENCE)
        except TimeoutError:
            if monotonic() - begun >= PATIENCE:  # or else it was another's: the worker is gone
                self._avoid(*self._holders(future))
            self._launch(batch, again=True)
            return
        except Exception as problem:  # Dask's own errors have many classes: the worker died, its future was lost
            self._mourn()
            if batch.attempts >= ATTEMPTS:
                raise CellError(f"a batch of tasks failed {ATTEMPTS} times on the cluster: {problem}") from None
            self._launch(batch)
            return
        finally:
            future.release()
        self._heard[address] = monotonic()
        if results is None:  # it has just joined
            self._send(address)
            self._launch(batch, again=True)
            return
        for kind, number, payload, spent in results:
            if number in batch.over:
                continue
            batch.over.add(number)
            if kind == "error":
                raise CellError(payload)
            self.usage.add((address, process), spent)
            seconds = max(spent[0], 1e-4)
            self._task_seconds = seconds if self._task_seconds is None else 0.8 * self._task_seconds + 0.2 * seconds
            self._ready.append((number, payload))

    def _send(self, address):
        """Send a worker the arrays that it lacks; it says what it is."""
        digests = self._ask(address, missing, list(self._arrays))
        if digests:
            told = self._ask(address, keep, {digest: self._arrays[digest] for digest in digests})
            if told:
                self._check({address: told})

    def _ask(self, address, function, *arguments):
        """The answer of one worker; None if it is gone or hangs."""
        self._alive()
        future = self._client.submit(function, *arguments, workers=[address], pure=False)
        try:
            return future.result(timeout=PATIENCE)
        except TimeoutError:
            self._avoid(address)
        except Exception:  # of many classes: the worker died meanwhile
            self._alive()
        finally:
            future.release()
        return None

    def _check(self, identities):
        """Whether workers are what the host is."""
        mine = self._identity()
        for address, theirs in identities.items():
            if not isinstance(theirs, dict):
                raise ClusterError(
                    f"worker {address} cannot run cell_radiosity: {theirs}; install the same version there"
                )
            differ = [
                f"{k} {_short(theirs.get(k), v)}, here {_short(v, theirs.get(k))}"
                for k, v in mine.items()
                if theirs.get(k) != v
            ]
            if not differ:
                continue
            if not self._mixed:
                raise ClusterError(
                    f"worker {address} is not what this machine is: {'; '.join(differ)}; the last bits of results may "
                    "differ. Install the same there, or accept it with --allow-mixed"
                )
            self.note = f"workers differ from this machine ({'; '.join(differ)}): results may differ in the last bits"

    def _find_workers(self):
        """Who is there: {address: threads}; counts those that are gone."""
        told = self._client.scheduler_info(n_workers=-1).get("workers")
        if told is None:  # the client has just lost the scheduler; whether it comes back is asked elsewhere
            return
        found = {address: worker["nthreads"] for address, worker in told.items()}
        # For a moment the scheduler may not name a worker that is there: who comes back was not lost.
        self._seen |= found.keys()
        self._workers = found
        self._count_lost()
        self.count = sum(n for a, n in found.items() if a not in self._avoided) or 1

    def _mourn(self):
        """A batch came to nothing: the scheduler is gone, or a worker."""
        self._alive()
        self._find_workers()
        if not self._workers:
            self._await_workers()

    def _look_around(self):
        """Nothing has come for a second: is anybody there, and does everyone answer?"""
        self._alive()
        self._find_workers()
        now = monotonic()
        if not self._workers:
            self._nobody = self._nobody or now
            if now - self._nobody > WAIT:
                raise ClusterError(f"the cluster has had no worker for {WAIT:.0f} s; start workers and bake again")
            return
        self._nobody = None
        for address, keys in self._ask_processing().items():
            mine = [key for key in keys if key in self._batches]
            since = max([self._heard.get(address, 0.0)] + [self._batches[key].begun for key in mine])
            silent = mine and now - since > PATIENCE and address not in self._avoided
            if silent and len(self._workers) - len(self._avoided) > 1:
                self._avoid(address)
                for key in mine:
                    batch = self._batches.pop(key)
                    batch.future.release()
                    self._launch(batch, again=True)

    def _avoid(self, *addresses):
        """Give no more work to workers that hang."""
        self._avoided |= set(addresses)
        self._count_lost()

    def _count_lost(self):
        """Workers that are gone, or were given up."""
        self.restarted = len((self._seen - self._workers.keys()) | self._avoided)

    def _ask_processing(self):
        with suppress(Exception):
            return self._client.processing()
        return {}

    def _holders(self, future):
        with suppress(Exception):
            return next(iter(self._client.who_has([future]).values()))
        return ()

    def _alive(self):
        if self._client.status != "running":
            raise ClusterError("the scheduler of the cluster is gone; start it and bake again")

    def _await_workers(self):
        try:
            self._client.wait_for_workers(1, timeout=WAIT)
        except TimeoutError:
            raise ClusterError(
                f"the cluster has had no worker for {WAIT:.0f} s; start workers and bake again"
            ) from None
        self._find_workers()


class _Batch:
    """Tasks that travel together: [(id, name, arguments)], the future of their results, and the ids that are over."""

    def __init__(self, tasks):
        self.tasks, self.future, self.attempts, self.over, self.begun = tasks, None, 0, set(), monotonic()


def _short(value, other):
    """What of a version or a list of words is not in another."""
    words = [w for w in str(value).split() if w not in str(other).split()]
    return " ".join(words) or "-"
