"""The report of a bake: one JSON document that other programs read.

Owns its schema. A figure that does not exist is null; a number is never NaN.
"""

from __future__ import annotations

import json

import numpy as np

from .health import direct_check
from .saving import written_whole

_NUMBER = {"type": ["number", "null"]}
_COUNT = {"type": ["integer", "null"]}
_TEXT = {"type": ["string", "null"]}
_FLAG = {"type": ["boolean", "null"]}


def _record(**fields):
    return {"type": "object", "properties": fields, "required": list(fields), "additionalProperties": False}


def _list(item):
    return {"type": "array", "items": item}


SCHEMA = {
    "$schema": "https://json-schema.org/draft/2020-12/schema",
    "title": "Report of a Cell Radiosity bake",
    **_record(
        scene={"type": "string"},
        version={"type": "string"},
        cells=_COUNT,
        seed=_COUNT,
        effects=_list(_record(name={"type": "string"}, needed={"type": "boolean"}, reason={"type": "string"}, seconds=_NUMBER, estimated=_FLAG)),
        ignored=_list(_record(object={"type": "string"}, reason={"type": "string"})),
        health=_list(_record(object={"type": "string"}, finding={"type": "string"}, action={"type": "string"})),
        patches=_COUNT,
        output_points=_COUNT,
        rays=_COUNT,
        peak_memory_mb=_NUMBER,
        memory=_record(host_mb=_NUMBER, cells_mb=_list(_NUMBER)),
        cells_restarted=_COUNT,
        converged=_FLAG,
        seconds=_record(
            **dict.fromkeys(("start", "read", "survey", "patches", "transport", "gather", "write", "total", "cpu", "embree_cpu"), _NUMBER)
        ),
        transport=_record(
            rounds=_COUNT, shots=_COUNT, schedule=_TEXT,
            curve=_list(_record(seconds=_NUMBER, unshot=_NUMBER, bound=_NUMBER)), converged=_FLAG,
        ),
        error=_record(
            requested=_NUMBER, estimated=_NUMBER, interior=_NUMBER, sampling=_NUMBER, patches=_NUMBER, solve=_NUMBER,
            floor=_FLAG, worst={"anyOf": [{"type": "null"}, _record(object={"type": "string"}, error=_NUMBER)]},
        ),
        energy=_record(**dict.fromkeys(("emitted_w", "absorbed_w", "escaped_w", "unshot_w", "direct_check"), _NUMBER)),
        price=_list(
            _record(**dict.fromkeys(("error", "seconds_predicted", "seconds_measured", "error_measured", "memory_mb"), _NUMBER))
        ),
        layers=_list({"type": "string"}),
        objects=_list(_record(name={"type": "string"}, points=_COUNT, domain=_TEXT, error=_NUMBER)),
        copies=_record(meshes=_COUNT, memory_mb=_NUMBER),
        lightmaps=_list(
            _record(of={"type": "string"}, width=_COUNT, height=_COUNT, texels=_COUNT, charts=_COUNT, unwrap_seconds=_NUMBER)
        ),
    ),
}  # fmt: skip


def make_report(bake, *, scene, version, layers, domain, start, read, write, lightmaps=(), copies=None):
    """The report (a dictionary that fits SCHEMA) of a Bake. scene: its file; start, read, write: seconds. copies: the
    count and bytes of meshes that were copied because objects share them."""
    solution, seconds, cells = bake.solution, bake.seconds, bake.cells
    phases = {k: seconds.get(k) for k in ("survey", "patches", "transport", "gather")}
    return {
        "scene": scene,
        "version": version,
        "cells": cells["count"],
        "seed": bake.settings.seed,
        **_of_survey(bake.survey),
        "patches": len(bake.patches),
        "output_points": len(bake.points),
        "rays": bake.rays,
        "peak_memory_mb": cells["host_mb"] + sum(cells["cells_mb"]),
        "memory": {"host_mb": cells["host_mb"], "cells_mb": cells["cells_mb"]},
        "cells_restarted": cells["restarted"],
        "converged": bake.converged,
        "seconds": {
            "start": start, "read": read, **phases, "write": write,
            "total": start + read + write + sum(v for v in phases.values() if v),
            "cpu": seconds["cpu"], "embree_cpu": seconds["embree_cpu"],
        },
        "transport": {
            "rounds": len(solution.rounds),
            "shots": solution.rounds[-1].shots if solution.rounds else 0,
            "schedule": bake.settings.schedule,
            "curve": [dict(seconds=r.seconds, unshot=r.unshot, bound=r.bound) for r in solution.rounds],
            "converged": solution.converged,
        },
        "error": _error(bake),
        "energy": {**solution.energy, "direct_check": direct_check(bake.scene, solution)},
        "price": [price_row(p) for p in bake.price],
        "layers": list(layers),
        "objects": [dict(name=n, points=c, domain=domain, error=e) for n, c, e in _objects(bake)],
        "copies": {"meshes": copies and copies.count, "memory_mb": copies and copies.bytes / 1e6},
        "lightmaps": list(lightmaps),
    }  # fmt: skip


def price_row(price, seconds=None, error=None):
    """A row of the report's price list. seconds, error: measured, if they were."""
    return dict(
        error=price.error, seconds_predicted=price.seconds, seconds_measured=seconds, error_measured=error,
        memory_mb=price.memory_mb,
    )  # fmt: skip


def survey_report(found, *, scene, version, settings, read, survey):
    """The report of a Survey alone; what only a bake can tell is null. read, survey: seconds."""
    report = {**_blank(SCHEMA), **_of_survey(found), "scene": scene, "version": version, "seed": settings.seed}
    report["seconds"].update(read=read, survey=survey, total=read + survey)
    report["error"]["requested"] = settings.error
    return report


def _of_survey(found):
    """The fields of a report that a Survey fills."""
    return {
        "effects": [
            dict(
                name=e.name,
                needed=e.needed,
                reason=e.reason,
                seconds=e.seconds,
                estimated=not e.needed and e.seconds is not None,
            )
            for e in found.effects
        ],
        "ignored": [dict(object=o, reason=r) for o, r in found.ignored],
        "health": [dict(object=f.object, finding=f.finding, action=f.action) for f in found.health],
    }


def _blank(schema):
    """A document that fits a schema and says nothing."""
    if schema.get("type") == "object":
        return {name: _blank(field) for name, field in schema["properties"].items()}
    return [] if schema.get("type") == "array" else None


def write_json(report, path):
    """Write a report to a file, whole or not at all. Raises OSError."""
    with written_whole(path) as temporary, open(temporary, "w", encoding="utf-8") as file:
        json.dump(report, file, indent=1, allow_nan=False)
        file.write("\n")


def _error(bake):
    """The report's part about the error."""
    found, bound = bake.estimate, bake.solution.bound
    error = dict.fromkeys(("estimated", "interior", "sampling", "patches", "worst"))
    if found:
        worst = found.worst()
        error = dict(
            estimated=found.furthest, interior=found.interior, sampling=found.sampling, patches=found.patches,
            worst=worst and dict(object=bake.scene.objects[worst[0]], error=worst[1]),
        )  # fmt: skip
    timed = bake.settings.seconds is not None  # then no error was asked for
    asked = dict(requested=None if timed else bake.settings.error, floor=None if timed else bake.floor)
    return {**asked, **error, "solve": found.solve if found else bound}


def _objects(bake):
    """(name, points, error or None) of each written object."""
    count = np.bincount(bake.points.object, minlength=len(bake.scene.objects))
    errors = np.full(len(count), np.nan)
    if bake.estimate:
        errors[: len(bake.estimate.objects)] = bake.estimate.objects
    errors = [None if np.isnan(e) else float(e) for e in errors]
    return [x[:3] for x in zip(bake.scene.objects, map(int, count), errors, bake.scene.written) if x[3]]
