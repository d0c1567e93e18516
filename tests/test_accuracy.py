"""The error of a bake: what is said of it, and what it costs."""

from __future__ import annotations

from dataclasses import replace
from math import inf
from types import SimpleNamespace

import numpy as np
import pytest

from cell_radiosity.core import choices, control, course, prices
from cell_radiosity.core.accuracy import (
    AIM,
    AIM_EACH,
    CROWDED,
    FEWEST_TESTED,
    TESTED,
    Estimate,
    estimate_error,
    mean_product,
    noise_after,
    rays_by_object,
    rays_tested,
    rays_wanted,
    share_of_light,
    stalls,
)
from cell_radiosity.core.bake import price, through
from cell_radiosity.core.cells import LocalCells
from cell_radiosity.core.choices import CONTROL_COST, MOST_CONTROL_RAYS, STEP, UNSURE, bounces_deeper, more_control
from cell_radiosity.core.control import FEW, Control, Traced, draw_control
from cell_radiosity.core.course import MOST_REPLICATES, Course
from cell_radiosity.core.effects import Survey
from cell_radiosity.core.prices import (
    AGAIN,
    MORE_OF_FEW,
    PAIRS,
    Pilot,
    control_seconds,
    price_list,
    rays_more,
    replicate_seconds,
    transport_prices,
)
from cell_radiosity.core.replicates import Light
from cell_radiosity.core.surfaces import Readings, reflecting_polygons

from scenes import Lamp, Material, Settings, bake, box, join_meshes, run, sheet

PANEL = Lamp("area", (10.0,) * 3, position=(0.5, 0.5, 0.9), size=(0.2, 0.2), name="panel")


def furnished(n=8):
    """A room of two reflectances with a block in it, lit by a panel."""
    materials = [Material("white", (0.7, 0.7, 0.6)), Material("red", (0.6, 0.2, 0.1)),
                 Material("panel", (0, 0, 0), (30.0, 28.0, 25.0))]  # fmt: skip
    panel = sheet("panel", [(0.35, 0.65, 0.98), (0.65, 0.65, 0.98), (0.65, 0.35, 0.98), (0.35, 0.35, 0.98)], 2, 2, 2)
    block = box("block", (0.2, 0.3, 0.0), (0.5, 0.6, 0.45), n // 2, False, dict.fromkeys("xXyYzZ", 1), "xXyYZ")
    return join_meshes([box("room", n=n), block, panel], materials)


def baked(**settings):
    return run(bake(furnished(), Settings(**settings), LocalCells()))


def off(found, truth):
    """Relative error of a bake against what is true, away from creases, where points are not moved."""
    area = found.points.area * found.points.smooth
    return np.sqrt((area * (found.light.total - truth) ** 2).sum() / (area * truth**2).sum())


@pytest.fixture(scope="module")
def truth():
    """Light of much finer bakes than those that are judged; two seeds."""
    fine = dict(patch_edge=1 / 100, row_rays=64, gather_rays=1500, error=0.001)
    return sum(baked(seed=s, **fine).light.total for s in (101, 102)) / 2


@pytest.mark.parametrize("rays", [16, 32, 96, 256])
def test_estimate_follows_the_error_when_rays_are_fixed(truth, rays):
    """Away from any target: an estimate that repeats what was asked for would fail."""
    found = baked(gather_rays=rays, error=0.02)
    assert 0.6 < found.estimate.interior / off(found, truth) < 1.5


@pytest.mark.parametrize("error", [0.05, 0.02, 0.01])
def test_the_error_asked_for_is_reached_and_not_by_far(truth, error):
    found = baked(error=error)
    assert found.converged
    assert off(found, truth) < 1.1 * error
    assert found.floor or off(found, truth) > 0.3 * error


def test_parts_of_the_error_add_up():
    e = baked(gather_rays=32).estimate
    assert e.sampling**2 + e.patches**2 + e.solve**2 == pytest.approx(e.furthest**2, rel=1e-9)
    name, worst = e.worst()
    assert worst == np.nanmax(e.objects)
    assert 0 <= name < 3


def test_seeds_scatter_as_the_estimate_says():
    """Chi-square of 20 seeds about their own mean, over all points: the variances are right in the mean."""
    runs = [baked(gather_rays=48, seed=seed) for seed in range(20)]
    light = np.stack([r.light.total for r in runs])
    scatter = light.var(axis=0, ddof=1)
    area = runs[0].points.area
    found = (area * scatter).sum() / (area * light.mean(axis=0) ** 2).sum()
    said = np.mean([r.estimate.sampling**2 for r in runs])
    # Chi-square with 19 degrees of freedom a point, and many points; what each says of itself is right to a third.
    assert 0.6 < said / found < 1.7


def test_coarse_patches_show_in_their_part_of_the_error():
    coarse, fine = (baked(patch_edge=edge, gather_rays=128).estimate.patches for edge in (1 / 3, 1 / 40))
    assert coarse > 2 * fine
    assert coarse > 0.003


def test_price_list_is_the_pilots():
    """Less error costs more rays and time; what the pilot reaches costs nothing more."""
    rows = run(price(furnished(), Settings(), LocalCells(), (0.5, 0.02, 0.002)))
    assert rows[0].rays <= rows[1].rays < rows[2].rays
    assert rows[0].seconds <= rows[1].seconds < rows[2].seconds
    assert [r.error for r in rows] == [0.5, 0.02, 0.002]
    assert all(r.memory_mb > 0 for r in rows)


def piloted(error=0.03, patch_edge=None, parts=(), **found):
    """What a pilot may have found out."""
    usual = dict(scene=None, settings=Settings(patch_edge=patch_edge, error=error), survey=Survey(()), points=1000, patches=100,
                 rays=16, replicates=2, control_rays=64, control_points=300, control_rate=1e-5, solve=0.0, pace=(1.0, 1.0), memory_mb=100.0,
                 parts=dict(parts), estimate=Estimate(total=error, noise=error))  # fmt: skip
    return Pilot(**{**usual, **found})


def test_a_price_is_made_of_what_grows_and_what_does_not(monkeypatch):
    """Patches and rows as they are foretold; replicates by what they take at all and by their rays; nothing for those that
    there are not."""
    seconds = {"survey": 4.0, "patches": 0.5, "transport": 1.5, "replicates": 2.0, "rays": 16.0}
    pilot = piloted(seconds=seconds, parts={"gather": 10.0, "sources": 8.0})
    monkeypatch.setattr(prices, "transport_prices", lambda pilot, errors: [(3.0, 40.0)] * len(errors))
    enough, less = price_list(pilot, (0.05, 0.01))
    assert (enough.error, enough.rays) == (0.05, 16)
    assert enough.seconds == pytest.approx(3.0 + 4.0)
    more = less.rays - 16
    fixed, each = replicate_seconds(pilot)
    assert less.seconds == pytest.approx(3.0 + 4.0 + AGAIN * fixed + each * more)
    assert less.memory_mb > enough.memory_mb == 140.0
    doubtful = replace(pilot, estimate=replace(pilot.estimate, doubt=0.03**2))
    assert price_list(doubtful, (0.01,))[0].seconds > less.seconds + 0.001 * 64


def test_a_price_counts_control_rays_where_they_are_traced():
    """Those that doubt calls for at few points, or at all if each object is to reach the error."""
    pilot = piloted(seconds={}, estimate=Estimate(total=0.02, noise=0.02, doubt=4 * UNSURE * (AIM * 0.01) ** 2))
    assert control_seconds(pilot, 0.01) == pytest.approx((MORE_OF_FEW * PAIRS * 4 - 1) * 64 * FEW * 1e-5)
    each = replace(pilot, settings=replace(pilot.settings, per_object=True))
    assert control_seconds(each, 0.01) == pytest.approx(3 * control_seconds(pilot, 0.01))


def test_memory_is_foretold_as_it_is_taken():
    """What the process takes without any patch is no more where there are twenty times as many."""
    (_, fine) = run(price(furnished(), Settings.for_error(0.1), LocalCells(), (0.1, 0.005)))
    taken = run(bake(furnished(), Settings.for_error(0.005), LocalCells()))
    assert fine.memory_mb == pytest.approx(taken.cells["host_mb"], rel=0.3)


def test_patches_and_rows_cost_by_what_the_pilot_has_spent_on_them(monkeypatch):
    """What the pilot took, where nothing changes; else direct light by the places where it is tested, rows by their number
    and length, in wall seconds of two cells that work side by side; nothing else grows."""
    own = Settings.for_error(0.02)
    pilot = piloted(seconds={"patches": 1.0, "transport": 9.0}, parts={"direct": 4.0, "rows": 6.0}, solve=1.0,
                    pace=(1.0, 0.5), settings=own, scene=furnished(), patches=1000)  # fmt: skip
    finer = Settings.for_error(0.005)
    count = {own.patch_edge: 800.0, finer.patch_edge: 4000.0}
    monkeypatch.setattr(prices, "eased", lambda settings, found: settings)
    monkeypatch.setattr(prices, "patch_size", lambda scene, settings: (settings.patch_edge, 0.0))
    monkeypatch.setattr(prices, "count_patches", lambda scene, sizes: [count[edge] for edge, _ in sizes])
    same, more = transport_prices(pilot, (0.02, 0.005))
    assert same == pytest.approx((10.0, 0.0))
    longer = (finer.row_rays / own.row_rays) ** 0.75
    assert more[0] == pytest.approx(10.0 + 2.0 * 3 + 4.0 * (4 * longer - 1))
    back = transport_prices(replace(pilot, settings=finer, patches=4400), (0.02,))[0]
    assert back[0] < same[0]
    assert back[1] < 0 < more[1]


def test_rays_are_foretold_by_their_number():
    """Noise of three times what is wanted calls for nine times the rays; none where there are enough."""
    pilot = piloted(error=3 * AIM * 0.01, seconds={})
    assert 9 * 16 <= 16 + rays_more(pilot, 0.01) <= 9 * 16 + 1
    assert rays_more(pilot, 0.03) == 0


def test_test_rays_are_foretold_once_for_a_replicate_of_many_rays():
    """A replicate of 20 times the rays costs far less than 20 times as much where test rays toward many lamps are most of
    it: what is foretold is the same share of the time that the pilot's replicates took."""
    pilot = piloted(seconds={"replicates": 2.0, "rays": 16.0}, parts={"gather": 10.0, "sources": 8.0})
    fixed, each = replicate_seconds(pilot)
    assert 2 * fixed + 16 * each == pytest.approx(2.0)
    assert 0.6 < fixed < 0.8
    assert replicate_seconds(replace(pilot, parts={"gather": 10.0})) == (0.0, 0.125)


def test_test_rays_are_as_many_as_the_noise_of_direct_light_calls_for():
    """None where it is little of what is allowed, all where it is much, between them as many as bring it there; a price has
    none of those that are not cast."""
    allowed = TESTED * 1e-4
    assert rays_tested(0.9 * allowed, 16, 1e-4, 100) == 0
    assert rays_tested(3 * allowed, 16, 1e-4, 100) == 32
    assert rays_tested(1.3 * allowed, 16, 1e-4, 100) == FEWEST_TESTED
    assert rays_tested(90 * allowed, 16, 1e-4, 100) == 100
    assert rays_tested(0.01, 16, inf, 100) == 0
    seconds = {"survey": 4.0, "patches": 0.5, "transport": 1.5, "replicates": 2.0, "rays": 16.0}
    pilot = piloted(seconds=seconds, parts={"gather": 10.0, "sources": 8.0})
    (tested,), (spared,) = (price_list(replace(pilot, direct=direct), (0.01,)) for direct in (0.01, 0.0))
    assert tested.rays == spared.rays
    assert tested.seconds - spared.seconds == pytest.approx(AGAIN * replicate_seconds(pilot)[0])


def test_direct_light_that_has_no_noise_is_tested_no_more():
    """A room lit by a panel far from anything that could hide it: after the pilot a bake has no test ray more."""
    course = Course(furnished(), Settings.for_error(0.01), LocalCells())
    run(through(course))
    pilots, later = course.gathering.gathered.replicates[:2], course.gathering.gathered.replicates[2:]
    assert later
    assert all(r.test_rays == r.rays for r in pilots)
    assert all(r.test_rays < r.rays / 2 and (r.test_rays > 0) == bool(r.direct.any()) for r in later)


def test_direct_noise_counts_as_the_error_does():
    """Where nearly all light falls into corners, which do not count, the noise of the rest is no small share of all: it was
    taken for one, no test ray was traced against it, and a bake traced rays for ever."""
    course = Course(furnished(4), Settings(error=0.02, pilot_rays=4), LocalCells())
    run(course.transport())
    run(course.pilot())
    points, light = course.points, course._light()
    free, inside = points.position[:, 2] > 0.3, points.position[:, 2] > 0.6
    points = replace(points, smooth=inside)
    power, variance = points.area * (light.total**2).sum(axis=0), np.where(inside, 9.0, 1.0)
    shares = [(points.area * variance)[part].sum() / power[part].sum() for part in (free, free & inside)]
    assert shares[1] > shares[0]
    assert share_of_light(variance, points, light, free) == pytest.approx(shares[1])
    assert share_of_light(10 - variance, points, light, free) == pytest.approx(
        (points.area * (10 - variance))[free].sum() / power[free].sum()
    )
    dark = replace(light, direct=np.where(inside, 0.0, light.direct), indirect=np.where(inside, 0.0, light.indirect))
    assert share_of_light(variance, points, dark, inside) == 0
    noise = course.gathering.direct_noise()
    course.gathering.gathered.closest[:] = np.where(free, 1.0, 0.0) * course.scene.diagonal
    assert 0 < course._direct_noise() == share_of_light(noise, course._counted(), light, free)


def test_a_bake_that_comes_no_nearer_ends(monkeypatch):
    monkeypatch.setattr("cell_radiosity.core.course.rays_wanted", lambda *_: 8)
    course = Course(furnished(2), Settings(error=0.02, pilot_rays=4), LocalCells())
    run(through(course))
    assert len(course.gathering.gathered.replicates) == MOST_REPLICATES


def test_rays_that_are_of_no_use():
    """Noise that is what it was with a third of the rays, and with a ninth, will not fall: 40 replicates were gathered where
    the filter had smeared light from corners, which do not count, over the little that does."""
    rays = np.array([100, 300, 900, 5000, 9000, 13000, 17000])
    plain, flat = lambda count: 1 / np.sqrt(rays[count - 1]), lambda count: 1.0
    assert stalls(rays, flat)
    assert not stalls(rays, plain)
    assert not stalls(rays / 20, flat)  # that is not much to try
    assert not stalls(rays[2:5], flat)
    assert not stalls(rays[:0], flat)
    for end in range(5, 8):  # bright light was met for the first time among the last
        assert not stalls(rays[:end], lambda count: (10 if count > 3 else 1) * plain(count))


def test_a_bake_whose_noise_does_not_fall_ends(monkeypatch):
    monkeypatch.setattr("cell_radiosity.core.course.rays_wanted", lambda *_: 400)
    monkeypatch.setattr(Course, "_noise_of", lambda self, replicates: 1.0)
    course = Course(furnished(2), Settings(error=0.02, pilot_rays=4), LocalCells())
    run(through(course))
    found = [r.rays for r in course.gathering.gathered.replicates]
    assert found[2:] == [400] * 4  # a third of 1608 is 408, and a third of that the pilot's


def test_noise_of_some_replicates_is_that_of_a_bake_of_them():
    course = Course(furnished(4), Settings(error=0.02, pilot_rays=16, gather_rays=200), LocalCells())
    run(through(course))
    whole = course.gathering.gathered.replicates
    assert len(whole) == 3
    assert course._noise_of(whole) == pytest.approx(course.estimate.noise, rel=1e-6)
    assert course._noise_of(whole[:2]) > 1.5 * course._noise_of(whole)


def timed(seconds, monkeypatch):
    """The rays of a point in a bake of so many seconds, by a clock on which a ray of every point takes a hundredth."""
    course = Course(furnished(), Settings(seconds=seconds, error=0.02), LocalCells())

    def rays():
        return course.gathering.mean_rays if course.gathering else 0.0

    monkeypatch.setattr(course.clock, "total", lambda: 0.01 * rays())
    monkeypatch.setattr(course, "_seconds", lambda: {"rays": 100.0, "replicates": 1.0})
    course.price = ("known",)
    run(through(course))
    return rays()


def test_a_time_is_used_and_kept(monkeypatch):
    """A longer time takes more rays; none takes longer than it was given, and little of it is left."""
    for seconds in (1.0, 4.0):
        assert 0.8 * seconds < 0.01 * timed(seconds, monkeypatch) <= seconds


def test_rays_wanted():
    """As many as bring the noise to the goal and no more; none where it is there, or where rays are of no use."""
    rough = Estimate(total=0.05, noise=0.05)
    n = rays_wanted(rough, 16, 0.01)
    assert noise_after(0.05, 16, n) <= (AIM * 0.01) ** 2 < noise_after(0.05, 16, n - 1)
    assert rays_wanted(Estimate(total=0.008, noise=0.008), 16, 0.01) == 0
    assert rays_wanted(Estimate(total=0.05, noise=0.005, shared=0.05), 16, 0.01) == 0


def test_narrow_things_do_not_hide_what_the_rest_is_off_by():
    """Points on edges get nearly all light and are exact, those inside are off by a tenth: what is seen there steers."""
    count = 400
    inside = np.arange(count) % 2 == 0
    light = np.where(inside, 1.0, 100.0)[None]
    truth = light / np.where(inside, 1.1, 1.0)
    points = SimpleNamespace(area=np.ones(count), object=np.zeros(count, int), smooth=inside)
    none = np.zeros(count)
    traced = SimpleNamespace(
        ids=np.arange(count), weight=np.ones(count), truth=np.stack([truth] * 2), patches=np.zeros((2, 1, count)),
        each=np.array([8, 8]),
    )  # fmt: skip
    found = estimate_error(points, Light(light, 0 * light, 0 * light, none, none == 0), traced, none == 0, 0.0)
    assert found.total < 0.002
    assert found.interior == pytest.approx(0.1 / 1.1, rel=0.05)
    assert found.furthest == found.interior
    assert found.sampling**2 + found.patches**2 + found.solve**2 == pytest.approx(found.interior**2)
    assert found.shared == pytest.approx(0.1 / 1.1, rel=0.2)
    assert found.averaged == found.noise == 0.0
    noisy = replace(found, noise=found.interior, shared=0.0)
    assert rays_wanted(noisy, 16, 0.05) == rays_wanted(replace(noisy, total=found.interior), 16, 0.05) > 0


def test_products_of_different_truths_have_no_noise_of_their_own():
    """Many truths of unlike rays, all off by the same: the mean of the products is the square of that, not more, and
    scatters less than the product of two halves of the rays."""
    rays, count = np.array([64, 64, 64, 64, 128, 128]), 40_000
    noise = np.random.default_rng(0).normal(size=(len(rays), 1, count)) * np.sqrt(64 / rays)[:, None, None]
    found = mean_product(0.2 + noise, rays)
    assert found.mean() == pytest.approx(0.04, abs=5 * found.std() / np.sqrt(count))
    halves = ((0.2 + noise) * rays[:, None, None]).reshape(3, 2, count).sum(axis=0) / (rays.sum() / 2)
    assert mean_product(halves[:, None], np.array([256, 256])) == pytest.approx(halves[0] * halves[1])
    assert found.var() < 0.8 * (halves[0] * halves[1]).var()


def test_control_points_lie_where_the_error_is():
    """A wall that sources light without any doubt, and a room that is much darker, noisy in one corner, with a tight and even
    darker one: few control points lie on the wall, many in those corners, where the noise of no single point tells; and by
    weight they stand for all."""
    count, rng = 5000, np.random.default_rng(3)
    wall, corner = np.arange(count) < count // 2, np.arange(count) >= count - 100
    tight = (np.arange(count) >= count - 200) & ~corner
    edges = np.array([(k, k - 1) for k in range(1, count)])
    edges = np.concatenate([edges, edges[:, ::-1]])
    edges = edges[np.lexsort(edges.T[::-1])]
    points = SimpleNamespace(
        area=rng.uniform(0.5, 1.5, count), object=np.where(wall, 0, 1), neighbor=edges[:, 1],
        neighbor_start=np.append(0, np.cumsum(np.bincount(edges[:, 0], minlength=count))),
    )  # fmt: skip
    direct, indirect = np.where(wall, 10.0, 0.0)[None], np.where(wall, 0.0, np.where(tight, 0.02, 0.1))[None]
    variance = np.where(corner & (np.arange(count) % 2 == 0), 1e-3, 0.0)[None]
    ids, weight = draw_control(points, Light(direct, indirect, variance, None, None), tight, 320, False)
    assert wall[ids].mean() < 0.4
    assert (corner & (np.arange(count) % 2 == 1))[ids].sum() > 20
    assert tight[ids].sum() > 25
    for value in (np.ones(count), wall, np.sin(np.arange(count) / 700)):
        spread = 3 * np.sqrt(((weight * value[ids]) ** 2).sum())
        assert (weight * value[ids]).sum() == pytest.approx((points.area * value).sum(), abs=spread)


def test_few_control_points_stand_for_all():
    """What is off at three of them stays; no other stands for many more; sums are right in the mean, whatever was seen
    where."""
    count, rng, sums = 300, np.random.default_rng(5), []
    points, value, weight = (
        SimpleNamespace(object=np.arange(count) % 7),
        rng.uniform(1, 3, count),
        rng.uniform(1, 2, count),
    )
    for _ in range(200):
        shared = rng.normal(size=count) * value
        off = rng.choice(count, 3, replace=False)
        shared[off] = 100.0
        traced = Traced(1, np.full(2, 64), *(np.broadcast_to(value, (2, 1, count)) for _ in range(2)))
        few = Control(points, np.arange(count), weight, None, None, traced=traced)
        few.narrow(shared)
        assert np.isin(off, few.ids).all()
        assert 0.6 * FEW < len(few.ids) <= FEW
        assert (few.weight <= 2.01 * count / FEW * weight[few.ids]).mean() > 0.9
        assert (few.truth == value[few.ids]).all()
        sums.append((few.weight * value[few.ids]).sum() / (weight * value).sum())
    assert np.mean(sums) == pytest.approx(1.0, abs=5 * np.std(sums) / np.sqrt(200))
    assert np.std(sums) < 0.2


def test_further_control_rays_go_from_few_points(monkeypatch):
    """After the first, from many points; not where each object is to reach the error, for a few lie on each, nor where
    replicates share an error for certain."""
    state = baked(error=0.01, gather_rays=96, seed=1).state()
    assert state.traced.rounds > 1
    assert len(state.control[0]) <= FEW

    monkeypatch.setattr(course, "shared_by_replicates", lambda light, control: None)
    nothing = dict(_light=lambda: None, _estimate=lambda: None)
    few = SimpleNamespace(rays=64, ids=np.arange(300), narrow=lambda _: None)
    usual = SimpleNamespace(settings=Settings(), control=few, estimate=Estimate(), **nothing)
    assert Course._narrow(usual)
    for other in (
        dict(settings=Settings(per_object=True)),
        dict(estimate=Estimate(shared=1e-3)),
        dict(control=SimpleNamespace(rays=32, ids=few.ids)),
        dict(control=SimpleNamespace(rays=64, ids=np.arange(FEW))),
    ):
        assert not Course._narrow(SimpleNamespace(**(vars(usual) | other)))


def test_control_rays_are_as_many_as_its_doubt_calls_for():
    """As many as are missing, at most as many again; none where there are enough, where the last did not help, or where
    what more rays at all points take off is cheaper to have."""
    settings, noise = Settings(error=0.01), 0.007
    found = lambda share: Estimate(total=noise, noise=noise, doubt=share * UNSURE * noise**2)
    assert more_control(found(0.9), settings, 64, np.inf, 0) == 0
    assert more_control(found(1.1), settings, 64, np.inf, 0) == STEP * 64
    assert more_control(found(1.75), settings, 64, np.inf, 0) == 48
    assert more_control(found(5.0), settings, 64, np.inf, 0) == 64
    assert more_control(found(1.1), replace(settings, per_object=True), 64, np.inf, 0) == 64
    # Where it alone stands between the bake and what was asked for, or could, less of it is enough.
    for total, share in ((0.011, 0.9), (0.0095, 0.9)):
        assert more_control(replace(found(share), total=total), settings, 64, np.inf, 0) > 0
    assert more_control(replace(found(0.9), total=0.008), settings, 64, np.inf, 0) == 0
    assert more_control(found(5.0), settings, 64, np.inf, 1.0) == 0
    assert more_control(found(5.0), settings, MOST_CONTROL_RAYS, np.inf, 0) == 0
    before = found(2.0).doubt * 64**0.25
    assert more_control(found(1.8), settings, 128, before, 0) == 0
    assert more_control(found(1.3), settings, 128, before, 0) == STEP * 128
    # Above the error by what may be chance, a bake that would end there goes on although they did not help; not if more rays
    # are to come, if it is above for certain, or below.
    high = replace(found(5.0), total=0.012)
    before = found(1.0).doubt
    assert more_control(high, settings, 128, before, 0) == 128
    for other, wanted in ((high, 2 * CONTROL_COST), (replace(high, total=0.04), 0), (replace(high, total=0.0099), 0)):
        assert more_control(other, settings, 128, before, wanted) == 0


def test_what_long_patches_have_of_one_another_is_seen(monkeypatch):
    """Every face of a coarse mesh one patch, by wish: the control is as deep as the error that is in their own light."""
    blocks = (
        box(f"block {k}", (x, y, 0), (x + 1, y + 1, z), 2, False)
        for k, (x, y, z) in enumerate(((1, 1, 1.2), (3, 2.5, 2)))
    )
    lamp = Lamp("area", (60.0,) * 3, (2.5, 2.0, 2.9), size=(0.5, 0.5))
    scene = join_meshes([box("room", (0, 0, 0), (5, 4, 3), 6), *blocks], [Material("white", (0.75,) * 3)], [lamp])
    fine = run(bake(scene, Settings.for_error(0.005, seed=9, gather_rays=256), LocalCells())).light.total

    def ratio():
        found = run(bake(scene, Settings.for_error(0.02, patch_edge=None, gather_rays=128), LocalCells()))
        inside = found.points.smooth & (found.state().gathered.closest > CROWDED)
        off, light = (found.points.area[inside] * x[:, inside] ** 2 for x in (found.light.total - fine, fine))
        return found.estimate.interior / np.sqrt(off.sum() / light.sum())

    assert ratio() > 0.6
    monkeypatch.setattr(choices, "DEEPER", 0)
    assert ratio() < 0.6


def test_the_control_goes_deeper_on_long_patches_that_were_asked_for():
    usual = Settings.for_error(0.02)
    assert [bounces_deeper(replace(usual, patch_edge=x)) for x in (None, 1 / 12, usual.patch_edge, 1 / 100)] == [
        2,
        2,
        0,
        0,
    ]


def behind_a_door():
    """A bright room, and a dark one beyond a gap in the wall between them."""
    materials = [Material("white", (0.7, 0.7, 0.7)), Material("panel", (0, 0, 0), (30.0, 30.0, 30.0))]
    panel = sheet("panel", [(0.35, 0.65, 0.98), (0.65, 0.65, 0.98), (0.65, 0.35, 0.98), (0.35, 0.35, 0.98)], 2, 2, 1)
    bright, dark = box("bright", n=6, faces="xyYzZ"), box("dark", (1, 0, 0), (2, 1, 1), 6, faces="XyYzZ")
    wall = sheet("wall", [(1.0, 0.25, 0.0), (1.0, 1.0, 0.0), (1.0, 1.0, 1.0), (1.0, 0.25, 1.0)], 5, 6)
    return join_meshes([bright, dark, wall, panel], materials)


def test_every_object_reaches_the_error_if_asked_for():
    """The dark room, not 1e-3 of what the whole is judged by, is as right as the bright one; judged by finer bakes."""
    scene, error = behind_a_door(), 0.03
    fine = dict(patch_edge=1 / 100, row_rays=64, gather_rays=1500, error=0.001)
    truth = sum(run(bake(scene, Settings(seed=s, **fine), LocalCells())).light.total for s in (101, 102)) / 2

    def dark(found):
        area = found.points.area * (found.points.smooth & (found.points.object == 1))
        return np.sqrt((area * (found.light.total - truth) ** 2).sum() / (area * truth**2).sum())

    whole, each = (run(bake(scene, Settings.for_error(error, per_object=each), LocalCells())) for each in (False, True))
    assert whole.estimate.total < error
    assert each.estimate.objects[:2].max() < error
    assert dark(whole) > 1.2 * error > dark(each)


def test_rays_by_object_go_where_they_are_needed():
    """Few more where little is missing, many where much is; none where there is enough, or rays are of no use."""
    objects, noise = np.array([0.006, 0.02, 0.08, 0.05, np.nan]), np.array([0.006, 0.02, 0.08, 0.001, 0.0])
    more = rays_by_object(Estimate(objects=objects, object_noise=noise), np.full(5, 32.0), 0.01)
    assert more[0] == more[3] == more[4] == 0
    assert 0 < more[1] < more[2]
    assert noise_after(0.02, 32, more[1]) <= (AIM_EACH * 0.01) ** 2 < noise_after(0.02, 32, more[1] / 2)


def test_nothing_is_traced_anew_where_rays_bring_nothing(monkeypatch):
    """A black room: all its light is straight from the panel, at control points too."""
    room = join_meshes([box("room", n=4)], [Material("black", (0, 0, 0))], [PANEL])
    monkeypatch.setattr(control, "Shooter", None)
    found = run(bake(room, Settings(error=0.02), LocalCells()))
    assert found.converged
    assert found.light.total.sum() > 0


def test_points_on_what_reflects_nothing_do_not_count():
    """Nobody sees what arrives on a lamp that only glows: no control point lies there, and however wrong it is, the error
    is the same. Where nothing reflects, all points count."""
    course = Course(furnished(4), Settings(error=0.02, pilot_rays=4), LocalCells())
    run(course.transport())
    run(course.pilot())
    lamp, before = course.scene.objects.index("panel"), course.estimate
    glowing = course.points.object == lamp
    assert np.array_equal(~glowing, course._seen())
    assert not glowing[course.control.ids].any()
    assert np.flatnonzero(np.isnan(before.objects)).tolist() == [lamp]
    for number, replicate in enumerate(course.gathering.gathered.replicates):
        replicate.reflected[:, glowing] += 1e3 * (1 + number)
    course.gathering._taken = None
    course._estimate()
    assert (course._light().total[:, glowing] > 100).all()
    assert course.estimate.total == before.total
    assert course.estimate.interior == before.interior
    assert np.array_equal(course.result().seen, ~glowing)

    black = replace(course.scene, materials=tuple(replace(m, reflectance=(0.0,) * 3) for m in course.scene.materials))
    found = run(bake(black, Settings(error=0.02, pilot_rays=4), LocalCells()))
    assert found.seen.all()
    assert not np.isnan(found.estimate.objects).all()


def test_which_polygons_reflect():
    """Those whose material reflects, lets through, or has an image; of what was read, those where any place reflects."""
    plain = dict(exitance=(1.0,) * 3)
    materials = [Material("glow", (0, 0, 0), **plain), Material("dim", (0, 0, 0.01)),
                 Material("veil", (0, 0, 0), translucency=(0.1,) * 3), Material("image", (0, 0, 0), texture=0)]  # fmt: skip
    sheets = [sheet(m.name, [(0, 0, k), (1, 0, k), (1, 1, k), (0, 1, k)], material=k) for k, m in enumerate(materials)]
    scene = join_meshes(sheets, materials)
    assert reflecting_polygons(scene).tolist() == [False, True, True, True]
    triangle = np.flatnonzero(np.isin(scene.triangle_polygon, (0, 1)))
    color = np.where(scene.triangle_polygon[triangle, None] == 0, [0.0, 0.2, 0.0], 0.0)
    read = Readings(triangle, np.full((len(triangle), 2), 0.3), color, 0 * color, triangle[:0], color[:0], color[:0])
    assert reflecting_polygons(replace(scene, readings=read)).tolist() == [True, False, True, True]
