"""State files: a bake broken off or finished is carried on, and nothing is traced twice."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from cell_radiosity.core import state as core_state
from cell_radiosity.core.bake import bake, restored, run
from cell_radiosity.core.cells import LocalCells
from cell_radiosity.core.choices import DEEPER
from cell_radiosity.core.course import SOLVED, Course
from cell_radiosity.core.settings import Settings
from cell_radiosity.core.state import FORMAT, StateError, load_state, save_state

from scenes import Lamp, Material, World, box, join_meshes, sheet

MATERIALS = (
    Material("walls", (0.7, 0.7, 0.6)),
    Material("red", (0.6, 0.2, 0.1)),
    Material("panel", (0, 0, 0), (30, 28, 25)),
)
LAMP = Lamp("point", (1, 1, 0.9), (0.3, 0.2, 0.6), name="Key", radius=0.05)


def room(materials=MATERIALS, lamps=(LAMP,), high=0.45, n=8):
    """A room of two reflectances with a block in it, a panel, a lamp and a window to the sky."""
    panel = sheet("panel", [(0.35, 0.65, 0.98), (0.65, 0.65, 0.98), (0.65, 0.35, 0.98), (0.35, 0.35, 0.98)], 2, 2, 2)
    block = box("block", (0.2, 0.3, 0.0), (0.5, 0.6, high), n // 2, False, dict.fromkeys("xXyYzZ", 1), "xXyYZ")
    return join_meshes([box("room", n=n, faces="xXyYz"), block, panel], materials, lamps, World((0.2, 0.3, 0.5)))


class Counted:
    """Of cells that know what they have traced: {(task, seed, side or point): how often}."""

    def __init__(self, *arguments):
        super().__init__(*arguments)
        self.traced, self._told = Counter(), {}

    def submit(self, name, **arguments):
        self._told[self._next] = name, arguments
        return super().submit(name, **arguments)

    def take(self, ids):
        results = super().take(ids)
        for number in ids:
            self._count(number)
        return results

    def brought(self, ids):
        results = super().brought(ids)
        for number in results:
            self._count(number)
        return results

    def _count(self, number):
        name, told = self._told[number]
        seed = told.get("seed"), told.get("rays")
        items = told["ids"][: len(told["degree"])] if "degree" in told else told.get("sides", ())
        own = [(name, *seed, int(k)) for k in items]
        self.traced.update(own or [(name, str({k: np.asarray(v).tobytes() for k, v in told.items()}))])


class Counting(Counted, LocalCells):
    """Such cells in this process."""


def through(path, state):
    """A State that has been through a file."""
    save_state(state, path)
    return load_state(path)


def to_file(state):
    """All that a State's file holds, to compare."""
    arrays, told = core_state._packed(state)
    return {name: np.asarray(array).tobytes() for name, array in arrays.items()}, json.dumps(told)


def same(a, b):
    pairs = [(getattr(a.light, n), getattr(b.light, n)) for n in ("direct", "indirect", "variance", "blurred")]
    return all(np.array_equal(*pair) for pair in pairs)


def broken(scene, settings, cells, stop, **more):
    """The last Progress of a bake that `stop`, a function of the Progress, has broken off."""
    baking = bake(scene, settings, cells, **more)
    for progress in baking:
        if stop(progress):
            baking.close()
            return progress
    raise AssertionError("the bake was never broken off")


STOPS = [("patches", 0), ("transport", 0), ("transport", 2), ("gather", 0), ("gather", 1), ("error", 1), ("gather", 5)]


SETTINGS = Settings(error=0.007, occlusion=0.3)


@pytest.fixture(scope="module")
def straight():
    """The bake that ran through in one go, and what it traced."""
    cells = Counting()
    return run(bake(room(), SETTINGS, cells)), cells.traced


@pytest.mark.parametrize(("phase", "number"), STOPS)
def test_a_bake_broken_off_is_carried_on_to_the_same_bits(tmp_path, straight, phase, number):
    """Whatever it was at; what both parts have traced is what one bake traces, and they share nothing."""
    expected, traced = straight
    seen = Counter()

    def stop(progress):
        seen[progress.phase] += 1
        return progress.phase == phase and seen[phase] > number

    first, second = Counting(), Counting()
    state = through(tmp_path / "s", broken(room(), SETTINGS, first, stop).state())
    result = run(bake(room(), SETTINGS, second, state=state))
    assert same(result, expected)
    assert result.estimate.total == expected.estimate.total
    assert np.array_equal(result.openness, expected.openness)
    assert result.converged == expected.converged
    assert not first.traced & second.traced
    assert first.traced + second.traced == traced


def test_a_finished_bake_traces_nothing_more(tmp_path, straight):
    expected, _ = straight
    cells = Counting()
    result = run(bake(room(), SETTINGS, cells, state=through(tmp_path / "s", expected.state())))
    assert same(result, expected)
    assert not cells.traced
    assert result.rays == 0


class Shuffled(Counting):
    """Cells that bring the last of six tasks first."""

    def results(self):
        while self._waiting:
            ahead = self._waiting[5] if len(self._waiting) > 5 else None
            if ahead:
                del self._waiting[5]
                self._waiting.appendleft(ahead)
            first, others = self._waiting.popleft(), list(self._waiting)
            self._waiting.clear()
            self._waiting.append(first)
            yield from super().results()
            self._waiting.extend(others)


@pytest.mark.parametrize("phase", ["transport", "gather"])
def test_what_came_out_of_turn_is_kept_too(tmp_path, straight, phase):
    """Of a bake that is broken off, results that nobody has asked for yet."""
    expected, traced = straight
    first, second = Shuffled(), Counting()
    progress = broken(room(), SETTINGS, first, lambda p: p.phase == phase and (p.points > 60 or p.round > 1))
    late = first.traced - Counter()
    state = through(tmp_path / "s", progress.state())
    result = run(bake(room(), SETTINGS, second, state=state))
    assert same(result, expected)
    assert not late & second.traced
    assert late + second.traced == traced


def test_carried_on_to_more_rays_is_the_bake_of_the_same_replicates(tmp_path, monkeypatch):
    few, many = (Settings(error=0.01, gather_rays=n) for n in (40, 100))
    first, second = Counting(), Counting()
    state = through(tmp_path / "s", run(bake(room(), few, first)).state())
    result = run(bake(room(), many, second, state=state))
    wanted = iter([[(24, None)], [(60, None)], []])
    monkeypatch.setattr(Course, "wanted", lambda course: next(wanted))
    expected = run(bake(room(), many, LocalCells()))
    assert same(result, expected)
    assert not first.traced & second.traced
    assert {name for name, *_ in second.traced} <= {"gather", "control"}
    assert [r.rays for r in result.state().gathered.replicates] == [8, 8, 24, 60]


@pytest.mark.parametrize(("coarse", "fine"), [(0.03, 0.01), (0.20, 0.01)])
def test_a_smaller_error_is_reached_by_going_on(tmp_path, coarse, fine):
    """A transport whose bound is not good enough is solved anew over rows that are known, to the bits of a bake that began
    with the smaller error on the same patches."""
    first, second = Counting(), Counting()
    state = through(tmp_path / "s", run(bake(room(), Settings.for_error(coarse), first)).state())
    result = run(bake(room(), Settings.for_error(fine), second, state=state))
    kept = {name: getattr(state.settings, name) for name in ("patch_edge", "row_rays", "patch_samples")}
    anew = run(bake(room(), replace(Settings.for_error(fine), **kept), LocalCells()))
    assert result.converged
    assert result.estimate.total <= fine
    again = {name for name, *_ in first.traced & second.traced}
    assert again <= {"cast", "lit"}  # the survey looks anew whether a smaller error calls for more effects
    off, light = result.light.total - anew.light.total, anew.light.total
    assert np.sqrt((off**2).sum() / (light**2).sum()) < 1.5 * fine
    kept = result.state().gathered.replicates
    for old, new in zip(state.gathered.replicates, kept):
        assert np.array_equal(old.reflected, new.reflected)
    assert len(kept) > len(state.gathered.replicates)
    good = state.solution.bound <= SOLVED * fine
    assert good == (coarse < 0.05)
    assert np.array_equal(result.solution.irradiance, (state if good else anew).solution.irradiance)
    # And again, with nothing left to do.
    third = Counting()
    again = run(bake(room(), Settings.for_error(fine), third, state=through(tmp_path / "s", result.state())))
    assert not third.traced
    assert same(again, result)


def test_a_larger_error_needs_nothing(tmp_path, straight):
    expected, _ = straight
    cells = Counting()
    result = run(bake(room(), replace(SETTINGS, error=0.05), cells, state=through(tmp_path / "s", expected.state())))
    assert same(result, expected)
    assert not cells.traced
    assert result.converged


def test_coarse_patches_are_kept_and_named(tmp_path):
    """0.5 % wants finer patches than 2 %: those of the state stay, and the bake says so."""
    state = through(tmp_path / "s", run(bake(room(), Settings.for_error(0.02), LocalCells())).state())
    result = run(bake(room(), Settings.for_error(0.005), LocalCells(), state=state))
    assert np.array_equal(result.patches.centroid, state.patches.centroid)
    (finding,) = [f for f in result.survey.health if f.object == "patches"]
    assert "0.5 % asks for" in finding.finding
    assert "they were kept" in finding.action


def test_short_rows_of_a_state_are_the_memorys_as_long_as_it_holds_no_longer_ones(tmp_path):
    low = Settings.for_error(0.007, memory=1e6, gather_rays=16)
    first = run(bake(room(), low, LocalCells()))
    state = through(tmp_path / "s", first.state())
    for memory, named in ((low.memory, "memory"), (4e9, "patches")):
        result = run(bake(room(), replace(low, memory=memory), LocalCells(), state=state))
        assert same(result, first)
        *crowded, finding = sorted(result.survey.health, key=lambda f: not f.finding.startswith("this process takes"))
        assert len(crowded) == (memory == low.memory)
        assert finding.object == named
        assert (finding in first.survey.health) == (named == "memory")


@pytest.mark.parametrize("edge", [1 / 4, None])
def test_control_is_as_deep_as_long_patches_of_a_state_call_for(tmp_path, edge):
    """Also where they are not asked for again: else they would seem better than they are."""
    first = replace(Settings.for_error(0.03), patch_edge=edge)
    progress = broken(room(), first, LocalCells(), lambda p: p.phase == "error")
    state = through(tmp_path / "s", progress.state())
    depths = set()

    class Cells(LocalCells):
        def submit(self, name, **arguments):
            depths.update([arguments["further"]] if name == "control" else ())
            return super().submit(name, **arguments)

    run(bake(room(), Settings.for_error(0.03), Cells(), state=state))
    assert depths == {DEEPER}


def test_patches_that_forbid_the_error_end_the_bake(tmp_path):
    """Where patches alone are off by more than is asked for, no ray can help: none is cast."""
    coarse = replace(Settings.for_error(0.02), patch_edge=1 / 3, gather_rays=300)
    state = through(tmp_path / "s", run(bake(room(), coarse, LocalCells())).state())
    assert state.settings.patch_edge == 1 / 3
    cells = Counting()
    result = run(bake(room(), Settings.for_error(0.002), cells, state=state))
    assert result.estimate.patches > 0.002
    assert not result.converged
    assert "gather" not in {name for name, *_ in cells.traced}


@pytest.mark.parametrize("more", [dict(rows="analytic", patch_edge=1 / 4), dict(side="lit"), dict(side="back")])
@pytest.mark.parametrize("groups", [None, lambda name: name])
def test_other_ways_to_bake(tmp_path, cells, more, groups):
    """Analytic rows, other sides, light groups; the second part by processes."""
    scene = room(n=2 if "rows" in more else 8)
    settings = Settings(error=0.02, gather_rays=40, **more)
    expected = run(bake(scene, settings, LocalCells(), group_of=groups))
    for phase in ("transport", "gather"):
        progress = broken(scene, settings, LocalCells(), lambda p, at=phase: p.phase == at, group_of=groups)
        result = run(bake(scene, settings, cells, group_of=groups, state=through(tmp_path / "s", progress.state())))
        assert same(result, expected)
        if groups:
            assert np.array_equal(result.by_group.indirect, expected.by_group.indirect)


def test_objects_one_by_one(tmp_path):
    """Replicates at the points of some objects are carried on, too; and control points of each object are drawn where they
    were not, without a sample of the former ones."""
    settings = Settings.for_error(0.008, per_object=True)
    cells = Counting()
    expected = run(bake(room(), settings, cells))
    some = [k for k, r in enumerate(expected.state().gathered.replicates) if not r.asked.all()]
    assert some
    first, second = Counting(), Counting()
    progress = broken(room(), settings, first, lambda p: p.phase == "gather" and p.error and p.done < 0.8 and len(p.state().gathered.replicates) > some[0])  # fmt: skip
    result = run(bake(room(), settings, second, state=through(tmp_path / "s", progress.state())))
    assert same(result, expected)
    assert not first.traced & second.traced
    assert first.traced + second.traced == cells.traced

    first, second = Counting(), Counting()
    state = through(tmp_path / "s", run(bake(room(), Settings.for_error(0.008), first)).state())
    result = run(bake(room(), settings, second, state=state))
    assert not first.traced & second.traced
    assert len(result.state().control[0]) > 0
    assert result.estimate.worst()[1] <= 0.02


@pytest.fixture(scope="module")
def finished():
    return run(bake(room(), Settings(), LocalCells())).state()


CHANGES = {
    "geometry": (lambda: room(high=0.5), r"the geometry has changed: block is not what it was"),
    "object": (
        lambda: join_meshes([box("room", n=8, faces="xXyYz")], MATERIALS, (LAMP,)), "the geometry has changed: block is gone",
    ),
    "reflectance": (
        lambda: room((replace(MATERIALS[0], reflectance=(0.7, 0.7, 0.5)), *MATERIALS[1:])),
        "the reflectance has changed: room is not what it was: light has to be gathered anew",
    ),
    "lamp": (lambda: room(lamps=(replace(LAMP, strength=(2, 1, 1)),)), r"the lights have changed: Key is not.*relight"),
    "lamps": (lambda: room(lamps=(LAMP, replace(LAMP, name="Fill"))), "the lights have changed: Fill is new"),
    "emission": (
        lambda: room((*MATERIALS[:2], replace(MATERIALS[2], exitance=(1, 2, 3)))), "the lights have changed: panel is not",
    ),
    "world": (lambda: replace(room(), world=World((0.2, 0.3, 0.6))), "the lights have changed: World is not"),
    "objects": (lambda: replace(room(), written=np.array([True, False, True])), "other objects.*block is gone"),
}  # fmt: skip


@pytest.mark.parametrize("change", CHANGES)
def test_another_scene_is_refused_by_name(finished, change):
    make, words = CHANGES[change]
    with pytest.raises(StateError, match=words):
        run(bake(make(), Settings(), LocalCells(), state=finished))


def test_names_of_lamps_and_materials_do_not_matter(finished):
    scene = room((replace(MATERIALS[0], name="x"), *MATERIALS[1:]))
    assert run(bake(scene, Settings(), LocalCells(), state=finished)).rays == 0


@pytest.mark.parametrize(
    ("more", "words"),
    [(dict(seed=1), "the seed is 0 there, 1 was asked for"), (dict(side="back"), "the side of faces is front there"),
     (dict(rows="analytic"), "the estimator of rows is rays there"), (dict(patch_edge=1 / 30), "another longest edge of patches"),
     (dict(row_rays=64), "another number of rays of a row"), (dict(schedule="paper"), "the schedule is dynamic there"),
     (dict(force=("transparency",)), "transparency was left out")],
)  # fmt: skip
def test_other_samples_are_refused(finished, more, words):
    with pytest.raises(StateError, match=words):
        run(bake(room(), Settings(**more), LocalCells(), state=finished))


def test_other_groups_are_refused(finished):
    with pytest.raises(StateError, match="it has no light groups: ask for none"):
        run(bake(room(), Settings(), LocalCells(), group_of=lambda name: name, state=finished))
    grouped = run(bake(room(), Settings(), LocalCells(), group_of=lambda name: name)).state()
    with pytest.raises(StateError, match="its light groups are Key, panel, World, not all: ask for the same"):
        run(bake(room(), Settings(), LocalCells(), group_of=lambda name: "all", state=grouped))
    with pytest.raises(StateError, match="it has light groups: ask for them"):
        run(bake(room(), Settings(), LocalCells(), state=grouped))


def test_an_effect_that_a_smaller_error_calls_for_is_not_left_out(tmp_path):
    """Walls a little off gray are gray to 10 %, and not to 1 %."""
    tinted = room((Material(reflectance=(0.7, 0.7, 0.699)), Material(), replace(MATERIALS[2], exitance=(30, 30, 30))))
    tinted = replace(tinted, lamps=(), world=World())
    state = through(tmp_path / "s", run(bake(tinted, Settings.for_error(0.1), LocalCells())).state())
    assert not state.survey.needs("color")
    with pytest.raises(StateError, match="a bake to 10 %, as in it, can leave out color, this one cannot"):
        run(bake(tinted, Settings.for_error(0.01), LocalCells(), state=state))


def test_a_state_is_written_whole_or_not_at_all(tmp_path, finished, monkeypatch):
    path = tmp_path / "s"
    save_state(finished, path)
    before = path.read_bytes()

    def fail(file, array, **_):
        file.write(b"half")
        raise OSError("no space left")

    monkeypatch.setattr(np.lib.format, "write_array", fail)
    with pytest.raises(OSError, match="no space"):
        save_state(finished, path)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["s"]


@pytest.mark.parametrize(
    "damage",
    [lambda b: b"", lambda b: b"not a state", lambda b: b[: len(b) // 2], lambda b: b[:2000] + b"x" * 500 + b[2500:]],
)
def test_a_damaged_file_is_named(tmp_path, finished, damage):
    path = tmp_path / "s"
    save_state(finished, path)
    path.write_bytes(damage(path.read_bytes()))
    with pytest.raises(StateError, match="not a state file, or is damaged"):
        load_state(path)


def test_whatever_happened_to_a_file(tmp_path, finished, rng):
    """It is refused in words, or the damage hit nothing of it (dates, say)."""
    path = tmp_path / "s"
    save_state(finished, path)
    whole, refused = path.read_bytes(), 0
    for number in range(120):
        data, at = bytearray(whole), int(rng.integers(len(whole)))
        if number % 3 == 0:
            data[at] ^= 1 << int(rng.integers(8))
        elif number % 3 == 1:  # in the list of what the file holds
            data[-1 - at % 2000] = int(rng.integers(256))
        else:
            del data[at : at + int(rng.integers(1, 3000))]
        path.write_bytes(bytes(data))
        try:
            assert to_file(load_state(path)) == to_file(finished)
        except StateError:
            refused += 1
    assert refused > 60


def test_files_of_other_versions(tmp_path, finished, monkeypatch):
    monkeypatch.setattr("cell_radiosity.core.state.FORMAT", FORMAT + 1)
    save_state(finished, tmp_path / "s")
    monkeypatch.undo()
    with pytest.raises(StateError, match="another version wrote it"):
        load_state(tmp_path / "s")
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    with pytest.raises(StateError, match="not a state file"):
        load_state(tmp_path / "other.npz")


def test_a_state_gives_back_its_bake_without_a_ray(straight):
    expected, _ = straight
    result = run(restored(room(), expected.state()))
    assert same(result, expected)
    assert result.rays == 0
    assert np.array_equal(result.openness, expected.openness)
    early = broken(room(), SETTINGS, LocalCells(), lambda p: p.phase == "transport").state()
    with pytest.raises(StateError, match="not come to the light at points"):
        run(restored(room(), early))
