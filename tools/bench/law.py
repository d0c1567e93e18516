"""What a few measurements say of those in between: costs at an error, and exponents.

A cost law is an array (K, 2) of (error, CPU seconds). Pure functions of numbers.
"""

from __future__ import annotations

import numpy as np

BEYOND = 1.25  # how far below the smallest error that was measured a cost is told


def exponent(x, y):
    """The exponent of y ~ x^exponent through all measurements."""
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])


def cost_of_samples(runs, error):
    """(samples, CPU seconds) that an error costs whoever takes samples at a fixed rate: error ~ samples^-b and seconds ~
    a + c samples, fitted to `runs`, (K, 3) of (samples, error, CPU seconds). There is no less than one sample."""
    samples, errors, cpu = np.array(runs, float).T
    b = -exponent(samples, errors)
    first = np.exp(np.mean(np.log(errors) + b * np.log(samples)))
    needed = max((first / error) ** (1 / b), 1.0)
    # Each measurement counts by its share, or the longest would decide alone.
    each, once = np.polyfit(samples, cpu, 1, w=1 / cpu)
    return float(needed), float(max(once, 0.0) + each * needed)


def cost_of_bakes(law, error):
    """CPU seconds of the cheapest bake that comes to an error: between two bakes on the straight line of logarithms, and
    no less than the cheapest bake there is. None if it is far below what was measured."""
    best = frontier(law)
    errors, cpu = best.T
    if error >= errors[0]:
        return float(cpu[0])
    if error < errors[-1] and (len(best) < 2 or error * BEYOND < errors[-1]):
        return None
    k = min(int((errors > error).sum()), len(best) - 1)
    (e1, c1), (e2, c2) = best[k - 1], best[k]
    return float(c1 * (c2 / c1) ** (np.log(e1 / error) / np.log(e1 / e2)))


def frontier(law):
    """(K, 2) the bakes of a law that no other one beats in both error and cost, the cheapest first."""
    law = np.array(law, float)
    law = law[np.lexsort(law.T)]
    best = np.minimum.accumulate(law[:, 0])
    return law[np.append(True, best[1:] < best[:-1])]


def geometric_mean(values):
    """Geometric mean of those values that are there; None if none is."""
    known = [v for v in values if v is not None]
    return float(np.exp(np.mean(np.log(known)))) if known else None
