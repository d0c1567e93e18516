"""Frozen records of arrays as plain dictionaries, for messages, state files and printing."""

from __future__ import annotations

from dataclasses import fields

import numpy as np


def to_arrays(prefix, record):
    """{"prefix.field": array} of all fields of a record; None is left out."""
    return {
        f"{prefix}.{f.name}": np.asarray(getattr(record, f.name), order="C")
        for f in fields(record)
        if getattr(record, f.name) is not None
    }


def from_arrays(cls, prefix, arrays):
    """The record that `to_arrays` packed; a field that is missing becomes None."""
    return cls(**{f.name: arrays.get(f"{prefix}.{f.name}") for f in fields(cls)})
