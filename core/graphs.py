"""Graphs in arrays: which things hang together."""

from __future__ import annotations

import numpy as np


def components(first, second, count):
    """(count,) number of the connected part that each of `count` nodes belongs to: 0, 1, ... in order of first nodes.

    first, second: (E,) the nodes at the ends of the edges. Roots are hooked to lower ones and paths halved, so the
    number of rounds grows with the logarithm of the count.
    """
    root = np.arange(count, dtype=np.int32)
    first, second = np.asarray(first, np.int32), np.asarray(second, np.int32)
    while len(first):
        a, b = root[first], root[second]
        apart = a != b
        first, second, a, b = first[apart], second[apart], a[apart], b[apart]
        np.minimum.at(root, np.maximum(a, b), np.minimum(a, b))
        while True:
            shorter = root[root]
            if np.array_equal(shorter, root):
                break
            root = shorter
    return (np.cumsum(root == np.arange(count)) - 1)[root]  # a root is the first node of its part


def linked(owner, key):
    """Edges (first, second) that join owners (K,) with equal keys (K,), a chain through each run of equals."""
    order = np.argsort(key, kind="stable")
    same = key[order][1:] == key[order][:-1]
    return owner[order[:-1][same]], owner[order[1:][same]]
