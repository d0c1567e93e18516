"""The host's rounds: power in balance after each, and the bound never below what is really missing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cell_radiosity.core import transport
from cell_radiosity.core.cells import LocalCells
from cell_radiosity.core.course import Course
from cell_radiosity.core.host import LEAST_ROW, ROWS_SHARE, rays_that_fit, solve
from cell_radiosity.core.kept import ENDLESS, RayRows
from cell_radiosity.core.kernel import scene_arrays
from cell_radiosity.core.lights import make_sources
from cell_radiosity.core.patches import make_patches
from cell_radiosity.core.surfaces import Surfaces, make_surfaces
from cell_radiosity.core.transport import Transport, fixed_point

from scenes import Lamp, Material, Settings, World, box, icosphere, join_meshes, run, sheet

RAYS = 32


def room(world=0.0, thin=0.0):
    materials = [
        Material("colored", (0.8, 0.5, 0.2), translucency=(0.0, thin, thin)),
        Material("bright", (0.3, 0.4, 0.9), (2.0, 1.0, 0.5)),
    ]
    return join_meshes(
        [
            box(n=4, materials={"Z": 1}, faces=("x", "y", "Y", "z", "Z") if world else ("x", "X", "y", "Y", "z", "Z")),
            box("block", (0.3, 0.3, 0.2), (0.6, 0.7, 0.5), 2, False),
        ],
        materials,
        [Lamp("point", (3.0, 2.0, 1.0), (0.5, 0.2, 0.8))],
        World((world,) * 3),
    )


SCENES = {"closed": room(), "open under a sky": room(0.5), "translucent": room(0.0, 0.15)}


@pytest.fixture(params=SCENES)
def start(request):
    """A scene's Transport before the first round, and all its rows (2 N, RAYS)."""
    scene = SCENES[request.param]
    patches = make_patches(scene, 0.3)
    sources, sampled = make_sources(scene)
    surfaces = make_surfaces(scene, patches, sampled)
    cells = LocalCells()
    cells.start(scene_arrays(scene, patches, sources))
    sides = np.arange(2 * len(patches))
    direct, rows = cells.take(
        [cells.submit("direct", sides=sides, samples=4, seed=0), cells.submit("rows", sides=sides, rays=RAYS, seed=0)]
    )
    sky = np.pi * np.asarray(scene.world.radiance)
    store = RayRows(len(sides), RAYS, 1e9)
    return Transport(patches.area, surfaces, direct["direct"], sky, store), rows["hits"]


def everything(state, hits):
    """Power (C, 2 N) that leaves the sides when all has been shot: the dense solve of the same rows."""
    count = hits.shape[0]
    share = np.zeros((count, count))
    for k in range(RAYS):
        met = hits[:, k] >= 0
        np.add.at(share, (hits[met, k], np.flatnonzero(met)), 1 / RAYS)
    sky = state.area * (hits < 0).mean(axis=1) * state.sky
    leaving = []
    for c in range(3):
        rho, tau = state.surfaces.reflectance[c], state.surfaces.translucency[c]
        send = np.diag(rho)
        other = np.arange(count) ^ 1
        send[other, np.arange(count)] += tau
        first = state.own[c] + send @ (state.area * state.direct[c] + sky[c])
        leaving.append(np.linalg.solve(np.eye(count) - send @ share, first))
    return np.stack(leaving)


def test_balance_and_bound_after_every_round(start):
    """emitted = absorbed + escaped + unshot to rounding; B is a lower bound; the bound covers what it lacks."""
    state, hits = start
    exact = everything(state, hits)
    shot = np.zeros_like(exact)
    taken = np.zeros(len(hits), bool)
    rounds = 0
    while len(batch := state.pick(taken)[:20]):
        taken[batch] = True
        before = state.unshot[:, batch].copy()
        seen = state.surfaces.send(np.where(taken & ~state.rows.kept, state.area * (hits < 0).mean(1) * state.sky, 0.0))
        shot[:, batch] += before + seen[:, batch]
        state.add(batch, [{"hits": hits[batch]}])
        rounds += 1
        balance = state.absorbed + state.escaped + state.unshot.sum(axis=1)
        np.testing.assert_allclose(balance, state.emitted, rtol=1e-12)
        leaving = shot + state.unshot
        assert (leaving <= exact * (1 + 1e-9) + 1e-12).all()
        inside, outside = state.missing()
        missing = (exact - leaving).sum() / state.emitted.sum()
        # Without rows, all of the sky is counted as ahead: the shares are of more power than has been emitted.
        scale = (state.emitted.sum() + state.ahead.sum()) / state.emitted.sum()
        assert missing <= (inside + outside) * scale * (1 + 1e-9)
    assert rounds > 3


def test_settled_is_the_dense_solve_of_the_rows(start):
    """After `settle`, every side with a row gathers over it what the others send: H = direct + F (own + send H)."""
    state, hits = start
    everyone = np.arange(len(hits))
    state.add(everyone, [{"hits": hits}])
    irradiance, sweeps, bound = state.settle(1e-9)
    light = np.column_stack([state.surfaces.found + state.surfaces.send(irradiance), state.sky[:, 0]])
    gathered = state.direct + light[:, hits].mean(axis=2)
    np.testing.assert_allclose(irradiance, gathered, rtol=1e-7)
    assert bound <= 1e-9
    assert sweeps < 60
    balance = state.absorbed + state.escaped + state.unshot.sum(axis=1)
    np.testing.assert_allclose(balance, state.emitted, rtol=1e-9)


def bright_room(reflectance, seed, faces="xXyYzZ"):
    """The Transport of a room of one reflectance, with a block in it, after all its rows have come."""
    scene = join_meshes(
        [box(n=4, faces=faces), box("block", (0.3, 0.3, 0.2), (0.6, 0.7, 0.5), 2, False)],
        [Material("plaster", (reflectance,) * 3)],
        [Lamp("point", (3.0, 2.0, 1.0), (0.5, 0.2, 0.8))],
    )
    return after_rows(scene, 0.3, seed)


def after_rows(scene, edge, seed):
    """The Transport of a scene, on patches of this length, after all its rows have come."""
    patches, (sources, sampled) = make_patches(scene, edge), make_sources(scene)
    cells = LocalCells()
    cells.start(scene_arrays(scene, patches, sources))
    sides = np.arange(2 * len(patches))
    direct, rows = cells.take(
        [
            cells.submit("direct", sides=sides, samples=4, seed=0),
            cells.submit("rows", sides=sides, rays=RAYS, seed=seed),
        ]
    )
    surfaces, store = make_surfaces(scene, patches, sampled), RayRows(len(sides), RAYS, 1e9)
    state = Transport(patches.area, surfaces, direct["direct"], np.zeros((3, 1)), store)
    state.add(sides, [rows])
    return state


def light_of(state, irradiance):
    """Power that arrives on all sides, by an irradiance."""
    return (state.area * irradiance).sum(axis=1)


def test_a_solve_begins_where_the_last_one_ended(start):
    """And not at what has been shot, which has the noise of other rows: where nothing has come since, nothing is left to do."""
    state, hits = start
    state.add(np.arange(len(hits)), [{"hits": hits}])
    found, steps, _ = state.settle(1e-9)
    again, more, _ = state.settle(1e-9)
    assert more == 1 < steps
    np.testing.assert_allclose(again, found, rtol=1e-8)


def test_in_a_bright_room_that_is_closed_all_light_is_absorbed():
    """The sum of all light is exact, P / (1 - rho), whatever the rows; without the balance it is off by some percent."""
    off = []
    for seed in range(4):
        state = bright_room(0.9, seed)
        settled, _, _ = state.settle(1e-10)
        exact = light_of(state, state.direct) / (1 - 0.9)
        off.append(light_of(state, settled) / exact - 1)
        np.testing.assert_allclose(light_of(state, state.balanced(settled)), exact, rtol=1e-7)
        np.testing.assert_allclose(state.unshot.sum(axis=1), 0.0, atol=1e-7 * exact.min())
    assert np.abs(off).max() > 0.01


def test_many_groups_of_light_are_balanced_as_their_sum_is():
    """Of a hundred lights, each by itself, some are off by more than their noise explains; together they are not."""
    for seed in range(4):
        state = bright_room(0.9, seed)
        lit = np.flatnonzero(state.direct[0])
        surfaces = (getattr(state.surfaces, name)[:1] for name in ("reflectance", "translucency", "sampled", "found"))
        surfaces = Surfaces(*(np.repeat(values, len(lit), axis=0) for values in surfaces))
        direct = np.zeros((len(lit), state.direct.shape[1]))
        direct[np.arange(len(lit)), lit] = state.direct[0, lit]  # a group for what lights each side
        groups = Transport(state.area[::2], surfaces, direct, np.zeros((len(lit), 1)), state.rows)
        settled, _, _ = groups.settle(1e-6)
        exact = light_of(groups, direct) / (1 - 0.9)
        np.testing.assert_allclose(light_of(groups, groups.balanced(settled)), exact, rtol=1e-4)


def test_a_balance_takes_noise_off_a_bright_room_with_a_wall_missing():
    """Seeds scatter about the same mean, and less; what rows miss of what escapes is left."""
    sums = []
    for seed in range(40):
        state = bright_room(0.9, seed, "xyYzZ")
        settled, _, _ = state.settle(1e-10)
        sums.append((light_of(state, settled)[0], light_of(state, state.balanced(settled))[0]))
    before, after = np.transpose(sums)
    assert after.std() < 0.85 * before.std()
    assert abs(after.mean() - before.mean()) < 3 * before.std() / np.sqrt(40)


def test_a_balance_adds_no_noise_where_nearly_all_light_escapes():
    """Below the sky, what little of a sunlit floor's light a screen above it catches is noisier than what the screen finds."""
    floor = sheet("floor", [(-1.5, -1.5, 0), (1.5, -1.5, 0), (1.5, 1.5, 0), (-1.5, 1.5, 0)], 6, 6)
    screen = sheet("screen", [(-0.4, -0.3, 0.6), (-0.4, 0.9, 0.6), (0.8, 0.9, 0.6), (0.8, -0.3, 0.6)])
    scene = join_meshes([floor, screen], [Material("white", (0.8,) * 3)], [Lamp("sun", (3.0,) * 3)])
    sums = []
    for seed in range(60):
        state = after_rows(scene, 0.35, seed)
        settled, _, _ = state.settle(1e-9)
        sums.append((light_of(state, settled)[0], light_of(state, state.balanced(settled))[0]))
    before, after = np.transpose(sums)
    assert after.std() < 1.1 * before.std()
    assert abs(after.mean() - before.mean()) < before.std() / 5


@pytest.mark.parametrize("reflectance", [0.2, 0.45, 0.55])
def test_a_dim_room_is_balanced_as_a_bright_one(reflectance):
    """The noise of rows is less there, and taken off all the same: no reflectance at which light jumps."""
    for seed in range(4):
        state = bright_room(reflectance, seed)
        settled, _, _ = state.settle(1e-10)
        exact = light_of(state, state.direct) / (1 - reflectance)
        np.testing.assert_allclose(light_of(state, state.balanced(settled)), exact, rtol=1e-7)


def test_nothing_is_balanced_where_it_cannot_be():
    """Where rays never meet sides that gather, as of surfaces that lie on others."""
    state = bright_room(0.9, 0)
    wall = np.flatnonzero(state.direct[0] > 3 * state.direct[0].mean())  # where the lamp is close
    hits = state.rows.hits
    hits[np.isin(hits, wall)] = np.argmin(np.where(state.direct[0] > 0, state.direct[0], np.inf))
    settled, _, _ = state.settle(1e-10)
    np.testing.assert_array_equal(state.balanced(settled), settled)


def test_rows_are_as_long_as_memory_holds():
    """With enough of it as long as asked for; with less no more bytes than their share; and never too short to be of use."""
    rays = [rays_that_fit(10_000, Settings(row_rays=32, memory=memory)) for memory in (1e9, 4e6, 1e3)]
    assert rays[0] == 32
    assert LEAST_ROW < rays[1] < 32
    rows = RayRows(10_000, rays[1], ENDLESS)
    rows.add(np.arange(10_000), [{"hits": np.zeros((10_000, rays[1]), np.int32)}])
    assert 0.9 * ROWS_SHARE * 4e6 < rows.sides.nbytes + rows.hits.nbytes <= ROWS_SHARE * 4e6
    assert rays[2] == LEAST_ROW


@pytest.mark.parametrize("largest", [0.3, 0.9, 0.999])
def test_fixed_point_keeps_its_bound(rng, largest):
    """Random rows with sums of `largest`: the bound is never below the true error, and few updates are needed."""
    size = 200
    matrix = rng.random((size, size)) ** 8
    matrix *= largest / matrix.sum(axis=1, keepdims=True)
    right = rng.random((1, size))
    exact = np.linalg.solve(np.eye(size) - matrix, right[0])
    weight = rng.random(size)
    for target in (1e-1, 1e-3, 1e-6):
        found, count, bound = fixed_point(
            lambda x: right + x @ matrix.T, np.zeros((1, size)), np.full((1, size), largest), weight, target
        )
        error = np.abs(found[0] - exact).max() / ((weight * found[0]).sum() / weight.sum())
        assert error <= bound * (1 + 1e-6) + 1e-12
        assert bound <= target
        assert count < 60


def test_next_to_no_light_is_not_less_than_none():
    """Into balls that pass through one another next to nothing leaks, and the solve ends before it knows how much: a bake that
    was broken off then showed it as light below 0."""
    balls = [icosphere(f"ball {k}", 0.25, 1, False) for k in range(20)]
    balls = [replace(ball, vertices=ball.vertices + (0.4 * k, 0, 0)) for k, ball in enumerate(balls)]
    floor = sheet("floor", [(-1, -1, -0.5), (9, -1, -0.5), (9, 1, -0.5), (-1, 1, -0.5)], 8, 8)
    scene = join_meshes([floor, *balls], [Material("gray", (0.7,) * 3)], [Lamp("point", (5.0,) * 3, (0, 0, 1.5))])
    course = Course(scene, Settings.for_error(0.05), LocalCells())
    found = [progress.take and course._round.solution() for progress in course.transport()]
    assert len(found) > 3
    assert all((solution.irradiance >= 0).all() for solution in (course.solution, *filter(None, found)))


def test_nothing_gives_light():
    """No light at all: zeros, not NaN, and no ray for rows."""
    scene = join_meshes([box(n=2)])
    patches = make_patches(scene)
    surfaces = make_surfaces(scene, patches, np.zeros(24, bool))
    cells = LocalCells()
    cells.start(scene_arrays(scene, patches, make_sources(scene)[0]))
    rounds = []
    solution = run(solve(patches, surfaces, np.zeros(3), cells, Settings()), rounds.append)
    assert all(r.shots == 0 for r in rounds)
    assert not solution.irradiance.any()
    assert solution.converged
    assert solution.energy["emitted_w"] == 0.0


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("error", [0.5, 0.2])
def test_a_solve_that_ends_by_itself_has_converged(error, seed, monkeypatch):
    """Also where sides that next to no light reaches are left without rows: the bound on what they may still send and that
    on the rest are below the target together."""
    monkeypatch.setattr(transport, "BATCH", 8)
    monkeypatch.setattr(transport, "BATCH_SHARE", 0.05)
    scene = SCENES["translucent"]
    patches = make_patches(scene, 0.15)
    sources, sampled = make_sources(scene)
    cells = LocalCells()
    cells.start(scene_arrays(scene, patches, sources))
    surfaces, settings = make_surfaces(scene, patches, sampled), Settings(error=error, seed=seed, row_rays=RAYS)
    solution = run(solve(patches, surfaces, np.zeros((3, 1)), cells, settings))
    assert solution.rounds[-1].shots < 2 * len(patches)
    assert solution.bound <= error / 10
    assert solution.converged
