"""A hierarchy made to fit again: the same tree over moved surfaces, and a new one when it has become too costly."""

from __future__ import annotations

import numpy as np
import pytest
from support.array import launched
from support.motions import moves_of, random_motions, troupe
from support.scenes import space_of
from support.space import EVEN_STEP, even_space
from support.surfaces import batch, random_rows, shuffled_ids

from raygrid.node.geometry.bvh import INFLATE, build
from raygrid.node.geometry.bvh_boxes import WIDE
from raygrid.node.geometry.bvh_refit import WORSE, expected_cost, refitted
from raygrid.node.geometry.lattice import make_cell
from raygrid.node.geometry.rigid_motion import at_rest, make_groups, placed
from raygrid.node.geometry.surfaces import Kind
from raygrid.node.tracing.local_geometry import build_surfaces, refit_surfaces

CELL = make_cell(even_space((1, 1, 1)), (0, 0, 0))


def every_kind(rng, n=40):
    return shuffled_ids([batch(kind, random_rows(kind, rng, n, size=(1e-3, 0.05))) for kind in Kind], rng)


def test_what_has_not_moved_fits_with_the_same_bits():
    surfaces = every_kind(np.random.default_rng(1))
    built = build_surfaces(surfaces, CELL)
    again = refit_surfaces(surfaces, CELL, built)
    for table, other in zip(built, again, strict=True):
        assert np.array_equal(table, other)
    assert again.floats.ctypes.data % 64 == 0


def test_the_boxes_of_a_leaf_and_of_all_above_it_hold_its_items():
    rng = np.random.default_rng(2)
    low = rng.uniform(-0.4, 0.4, (500, 3))
    boxes = np.stack((low, low + 0.01), axis=1)
    order, floats = build(boxes)
    moved = boxes + rng.normal(size=(500, 1, 3)) * 0.2
    fitted = refitted(floats, moved[order])
    assert np.array_equal(fitted.view(np.uint32)[:, 6 * WIDE :], floats.view(np.uint32)[:, 6 * WIDE :])  # the same tree
    words = fitted.view(np.uint32)

    def check(node, low, high):
        """Every box lies in its parent's; a leaf's holds its items."""
        seen = 0
        for lane in range(WIDE):
            if fitted[node, lane] > 1e29:
                continue
            mine = fitted[node, lane : 6 * WIDE : WIDE].astype(np.float64)
            assert (mine[:3] >= low).all()
            assert (mine[3:] <= high).all()
            child = int(words[node, 6 * WIDE + lane])
            if child >> 31:
                first, many = child & (1 << 28) - 1, (child >> 28 & 7) + 1
                items = moved[order[first : first + many]]
                assert np.array_equal(mine[:3], (items[:, 0].min(0) - INFLATE).astype(np.float32))
                assert np.array_equal(mine[3:], (items[:, 1].max(0) + INFLATE).astype(np.float32))
                seen += many
            else:
                seen += check(child, mine[:3], mine[3:])
        return seen

    assert check(0, np.full(3, -np.inf), np.full(3, np.inf)) == 500


def test_other_surfaces_do_not_fit():
    surfaces = every_kind(np.random.default_rng(1))
    built = build_surfaces(surfaces, CELL)
    fewer = type(surfaces)(tuple(b.select(np.arange(len(b) - 1)) for b in surfaces))
    assert refit_surfaces(fewer, CELL, built) is None
    assert refit_surfaces(type(surfaces)(()), CELL, built) is None


def test_surfaces_that_change_places_cost_more_and_a_turn_of_all_costs_the_same():
    rng = np.random.default_rng(3)
    low = rng.uniform(-0.4, 0.4, (2000, 3))
    boxes = np.stack((low, low + 0.002), axis=1)
    order, floats = build(boxes)
    mixed = refitted(floats, boxes[order][rng.permutation(2000)])
    assert expected_cost(mixed) > 3 * expected_cost(floats)
    shifted = refitted(floats, boxes[order] + 0.05)
    assert expected_cost(shifted) == pytest.approx(expected_cost(floats), rel=1e-3)


@pytest.mark.parametrize(("reach", "rebuilt"), [(1e-4, False), (0.4, True)])
def test_a_node_fits_its_tree_or_builds_a_new_one(monkeypatch, reach, rebuilt):
    """Sixty small groups that move a little keep their tree; that change places get another."""
    rng = np.random.default_rng(4)
    cast, space = troupe(rng, 60, 1, fixed=0), space_of("1x1x1", EVEN_STEP)
    motions = random_motions(rng, cast, space)
    motions[:, 4] = 0.02 / cast.reaches
    motions[:, 5:] = rng.uniform(-0.4, 0.4, (60, 3))
    array = launched("1x1x1")
    array.driver.load(space, cast.surfaces, moves_of(cast, motions))
    builds = []
    monkeypatch.setattr(
        "raygrid.node.runtime.node_state.build_surfaces", lambda *a: builds.append(1) or build_surfaces(*a)
    )
    before = expected_cost(array.processors[0].node_state.surfaces.floats)
    motions = motions.copy()
    motions[:, 5:] = np.clip(motions[:, 5:] + rng.normal(size=(60, 3)) * reach, -0.45, 0.45)
    array.driver.move(moves_of(cast, motions))
    assert bool(builds) == rebuilt
    assert expected_cost(array.processors[0].node_state.surfaces.floats) < WORSE * before * (1.5 if rebuilt else 1.0)


def test_groups_at_rest_are_where_they_are_without_groups():
    surfaces = every_kind(np.random.default_rng(6), 5)
    moves = moves_of(type("Cast", (), {"groups": make_groups(np.arange(30), np.zeros(30), 1)}), at_rest(1))
    for rows in surfaces:
        assert np.array_equal(placed(rows, moves).data, rows.data)
