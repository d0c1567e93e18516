"""Work in short steps, between which Blender has its turn: generators that yield whenever they can wait."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor, wait
from math import inf
from time import perf_counter


def in_steps(work, step):
    """Drive a generator, giving way only after `step` seconds of work; returns what it returns."""
    begun = perf_counter()
    while True:
        try:
            next(work)
        except StopIteration as end:
            return end.value
        if perf_counter() - begun > step:
            yield
            begun = perf_counter()


def aside(step, function, *arguments, **named):
    """What a function of plain arrays returns. It runs in a thread, for which this waits in steps of so many seconds;
    at once if a step may take forever."""
    if step == inf:
        return function(*arguments, **named)
    with ThreadPoolExecutor(1, "radiosity aside") as thread:
        result = thread.submit(function, *arguments, **named)
        while not wait([result], step).done:
            yield
    return result.result()
