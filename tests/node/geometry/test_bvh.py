"""The hierarchy only saves work: the same hits as over all surfaces one by one, bit for bit."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from support.kernels import built, closest_each
from support.surfaces import (
    F64,
    Generator,
    batch,
    frame_of,
    points_on,
    random_rows,
    rows_on_planes,
    shuffled_ids,
    unit_vectors,
)

from raygrid.node.geometry.bvh import (
    COUNT_MASK,
    COUNT_SHIFT,
    DEPTH,
    EMPTY_BOUND,
    FIRST_MASK,
    INFLATE,
    LEAF,
    LEAF_BIT,
    build,
)
from raygrid.node.geometry.bvh_boxes import CHILD_COLUMN, WIDE
from raygrid.node.geometry.lattice import T_MIN
from raygrid.node.geometry.surfaces import Batch, Kind, SurfaceSet, merge

PLANES = [np.array([-0.375, -0.25, 0.0, 0.125, 0.25])] * 3


# --- the tree -------------------------------------------------------------------------------------------------


def deepest_stack(boxes: F64, kinds: NDArray[np.int8], order: NDArray[np.intp], nodes: NDArray[np.float32]) -> int:
    """Raise AssertionError unless the tree holds each item once, in leaves of one kind and boxes that contain it.

    Returns how many places a walk needs on its stack, whatever the ray.
    """
    words = nodes.view(np.uint32)
    found: list[int] = []
    waiting = [(0, np.full(3, -np.inf), np.full(3, np.inf), 0)]  # node, the box above, keys on the stack
    used, deepest = set(), 0
    while waiting:
        node, low, high, keys = waiting.pop()
        assert node not in used
        used.add(node)
        deepest = max(deepest, keys + WIDE)
        planes = nodes[node, :CHILD_COLUMN].reshape(2, 3, WIDE).astype(np.float64)
        lanes = np.flatnonzero((planes != EMPTY_BOUND).any((0, 1)))
        assert len(lanes) > 0
        assert (words[node, CHILD_COLUMN + len(lanes) :] == 0).all()
        for lane in lanes:
            own_low, own_high = planes[:, :, lane]
            assert (own_low >= low).all()
            assert (own_high <= high).all()
            child = int(words[node, CHILD_COLUMN + lane])
            if not child & LEAF_BIT:
                waiting.append((child, own_low, own_high, keys + len(lanes) - 1))
                continue
            first, count = child & FIRST_MASK, (child >> COUNT_SHIFT & COUNT_MASK) + 1
            assert count <= LEAF
            items = order[first : first + count]
            found += items.tolist()
            assert len(set(kinds[items])) == 1
            # boxes are rounded to binary32, by much less than they are inflated
            assert (boxes[items, 0] >= own_low + 0.9 * INFLATE).all()
            assert (boxes[items, 1] <= own_high - 0.9 * INFLATE).all()
    assert sorted(found) == list(range(len(boxes)))
    assert used == set(range(len(nodes)))
    return deepest


def random_boxes(rng: Generator, n: int) -> F64:
    """Boxes of all sizes, some flat, some points."""
    middles = rng.uniform(-0.5, 0.5, (n, 3))
    half = 10.0 ** rng.uniform(-6, -0.5, (n, 1)) * rng.choice([0.0, 1.0, 0.3], (n, 3))
    return np.stack((middles - half, middles + half), axis=1)


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5, 6, 8, 9, 17, 100, 3000])
def test_every_item_is_in_the_tree_once(n):
    rng = np.random.default_rng(n)
    for boxes in (
        random_boxes(rng, n),
        np.tile(random_boxes(rng, 1), (n, 1, 1)),  # all the same
        random_boxes(rng, n) * np.array([1.0, 0.0, 0.0]),  # on a line
        np.stack([np.tile([-s, s], (3, 1)).T for s in rng.uniform(0, 0.5, n)]),  # one middle, many sizes
        np.round(random_boxes(rng, n), 1),  # many equal middles
        np.zeros((n, 2, 3)),
    ):
        for most in (1, 2, 6):
            kinds = rng.integers(0, most, n).astype(np.int8)
            assert deepest_stack(boxes, kinds, *build(boxes, kinds)) <= DEPTH
        assert build(boxes)[1].ctypes.data % 64 == 0


def test_a_broken_tree_is_seen():
    boxes, kinds = random_boxes(np.random.default_rng(1), 100), np.zeros(100, np.int8)
    order, nodes = build(boxes)
    for row, column, value in ((0, 3, 0.1234), (5, 24, -0.4), (3, 40, 0.1234)):
        broken = nodes.copy()
        assert broken[row, column] != EMPTY_BOUND
        broken[row, column] = value
        with pytest.raises(AssertionError):
            deepest_stack(boxes, kinds, order, broken)
    twice = order.copy()
    twice[7] = twice[8]
    with pytest.raises(AssertionError):
        deepest_stack(boxes, kinds, twice, nodes)
    with pytest.raises(AssertionError):
        deepest_stack(boxes, np.arange(100).astype(np.int8), order, nodes)


@pytest.mark.parametrize("base", [1.07, 2.0, 4.0, 16.0, 256.0])
def test_the_stack_of_a_walk_is_large_enough(base):
    """Middles that crowd towards a point make the deepest trees."""
    crowd = base ** -np.arange(5000.0)
    crowd = crowd[crowd > 1e-290]
    for axes in (np.ones(3), np.array([1.0, 0.0, 0.0])):
        middles = np.repeat(crowd[:, None] * axes, 5, axis=0)
        boxes, kinds = np.stack((middles, middles), axis=1), np.zeros(len(middles), np.int8)
        assert deepest_stack(boxes, kinds, *build(boxes, kinds)) <= DEPTH


@pytest.mark.parametrize("size", [5e-324, 1e-310, 1e-307, 1e-200, 1e-31])
def test_middles_nearly_in_one_place_are_divided(size):
    middles = np.linspace(0.0, size, 100)[:, None] * np.ones(3)
    boxes, kinds = np.stack((middles, middles), axis=1), np.zeros(100, np.int8)
    assert deepest_stack(boxes, kinds, *build(boxes, kinds)) <= DEPTH


def test_more_items_than_leaves_can_name_are_refused():
    with pytest.raises(ValueError, match="a hierarchy over 268435457 items, wanted at most 268435456"):
        build(np.broadcast_to(np.zeros((1, 2, 3)), (2**28 + 1, 2, 3)))


# --- walking it -----------------------------------------------------------------------------------------------


def rays_at(surfaces: SurfaceSet, rng: Generator, n: int) -> tuple[F64, F64]:
    """Rays at the surfaces: any, along axes, grazing, and in the planes of the faces of their boxes."""
    boxes = np.concatenate([b.bounds() for b in surfaces])
    targets = np.concatenate([points_on(b, rng) for b in surfaces])
    chosen = rng.integers(0, len(targets), n)
    d = unit_vectors(rng, n)
    how = rng.random(n)
    along = how < 0.3
    d[along] = np.eye(3)[rng.integers(0, 3, along.sum())] * rng.choice([-1.0, 1.0], (along.sum(), 1))
    tilted = (how > 0.3) & (how < 0.45)
    for k in np.flatnonzero(tilted):  # almost along an axis
        d[k] = np.eye(3)[rng.integers(3)] + 10.0 ** rng.uniform(-9, -3) * unit_vectors(rng, 1)[0]
    beside = (how > 0.45) & (how < 0.6)
    d[beside, rng.integers(0, 3, beside.sum())] = 0.0
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    away = rng.choice([1.0, 1.0, 0.1, 1e-3, 0.0], (n, 1)) * rng.uniform(0, 1, (n, 1))
    origins = targets[chosen] - away * d
    in_face = (d == 0.0) & (rng.random((n, 3)) < 0.5)
    faces = boxes[chosen, rng.integers(0, 2, n)]
    origins[in_face] = faces[in_face]
    return origins, d


def check_same(surfaces: SurfaceSet, rng: Generator, n: int) -> int:
    """Walk the hierarchy and try all surfaces; returns how many rays hit something."""
    origins, d = rays_at(surfaces, rng, n)
    lowers = np.where(rng.random(n) < 0.7, T_MIN, rng.uniform(T_MIN, 0.5, n))
    uppers = np.where(rng.random(n) < 0.7, 2e18, lowers + rng.uniform(0, 1, n))
    walked, brute = closest_each(built(surfaces), origins, d, lowers, uppers)
    np.testing.assert_array_equal(walked, brute)
    # once more between the hits: from just at a hit, and up to just at it, where intervals of cells begin and end
    hit = np.flatnonzero(brute[:, 1] >= 0)
    for low, high in ((brute[hit, 0], uppers[hit]), (lowers[hit], brute[hit, 0])):
        walked, again = closest_each(built(surfaces), origins[hit], d[hit], low.copy(), high.copy())
        np.testing.assert_array_equal(walked, again)
    return len(hit)


def mixed(rng: Generator, n: int, size: tuple[float, float] = (1e-3, 0.3)) -> SurfaceSet:
    """n of each kind, a third of them on planes."""
    batches = []
    for kind in Kind:
        on_planes = rows_on_planes(kind, rng, n // 3, PLANES)
        batches.append(batch(kind, [*random_rows(kind, rng, n - n // 3, size=size), *on_planes]))
    return shuffled_ids(batches, rng)


@pytest.mark.parametrize("n", [1, 2, 5, 30, 150])
def test_closest_and_blocked_as_over_all_surfaces(n):
    rng = np.random.default_rng(200 + n)
    hit = check_same(mixed(rng, n), rng, 20000 // max(n // 10, 1))
    assert hit > 500


@pytest.mark.parametrize("kind", list(Kind), ids=lambda kind: kind.name.lower())
@pytest.mark.parametrize("n", [1, 2, 5, 200])
def test_one_kind_alone(kind, n):
    rng = np.random.default_rng(10 * n + kind)
    rows = [*random_rows(kind, rng, n - n // 2), *rows_on_planes(kind, rng, n // 2, PLANES)]
    assert check_same(SurfaceSet((batch(kind, rows),)), rng, 2000) > 100


def test_small_surfaces_far_away():
    """Where binary32 boxes are coarse against the surfaces."""
    rng = np.random.default_rng(77)
    assert check_same(mixed(rng, 60, size=(1e-6, 1e-4)), rng, 20000) > 1000


def test_surfaces_with_one_middle():
    rng = np.random.default_rng(78)
    shells = batch(Kind.SPHERE, [np.array([0.125, 0.0, 0.0, r]) for r in rng.permutation(np.linspace(0.01, 0.3, 40))])
    assert check_same(SurfaceSet((shells,)), rng, 2000) > 1000


def renumbered(rows: Batch, first: int) -> Batch:
    """The same surfaces under ids from `first` on."""
    return Batch(
        rows.kind, np.arange(first, first + len(rows), dtype=np.uint32), rows.materials, rows.data, rows.starts
    )


def test_of_coincident_surfaces_the_smallest_id_is_hit():
    rng = np.random.default_rng(79)
    one = [batch(kind, random_rows(kind, rng, 12, size=(0.05, 0.3))) for kind in Kind if kind != Kind.SMOOTH]
    starts = np.cumsum([0] + [len(b) for b in one])
    total = int(starts[-1])
    # three copies of everything, the smallest ids in the middle one
    batches = [
        renumbered(b, int(s) + shift) for shift in (total, 0, 2 * total) for b, s in zip(one, starts, strict=False)
    ]
    surfaces = merge(batches)
    assert check_same(surfaces, rng, 4000) > 1000
    origins, d = rays_at(surfaces, rng, 4000)
    walked, _ = closest_each(built(surfaces), origins, d, np.full(4000, T_MIN), np.full(4000, 10.0))
    assert walked[:, 1].max() < total


def test_grazing_rays_at_slivers():
    """Where the computed point lies farthest from the surface, so that boxes might leave it out."""
    rng = np.random.default_rng(80)
    rows = batch(Kind.TRIANGLE, random_rows(Kind.TRIANGLE, rng, 600, size=(1e-4, 0.4)))
    corners = rows.data.reshape(-1, 3, 3).astype(np.float64)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    chosen = rng.integers(0, 600, 6000)
    sideways = np.array([frame_of(normal)[0] for normal in normals])[chosen]
    d = sideways + 10.0 ** rng.uniform(-9, -6, (6000, 1)) * normals[chosen]
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    origins = points_on(rows, rng)[chosen] - rng.uniform(0.5, 2, (6000, 1)) * d
    walked, brute = closest_each(built(SurfaceSet((rows,))), origins, d, np.full(6000, T_MIN), np.full(6000, 10.0))
    np.testing.assert_array_equal(walked, brute)
    assert (brute[:, 1] >= 0).sum() > 2000
