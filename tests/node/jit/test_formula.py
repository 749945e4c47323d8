"""Every formula gives the same bits in three ways: compiled for one number, compiled for eight at once, and interpreted."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import config, errors, njit
from support.ray_setup import CELLS, STEPS

from raygrid.node.geometry import bvh_boxes, grid_walk, lattice
from raygrid.node.geometry.lattice import CELL, LATTICE
from raygrid.node.jit.formula import eight, formula
from raygrid.node.jit.lanes import ARRAY, BIT, EIGHT, F32, F64, I64, LATTICE_POINT, VECTOR, Columns, mapped
from raygrid.node.protocol import packing
from raygrid.node.protocol.packing import HALF_DIRECTION, LARGEST_BINARY32, WORDS
from raygrid.node.tracing import camera, ray_setup, shading, spawn

SPECIAL = [0.0, -0.0, 1.0, -1.0, 0.25, 1e-9, -1e-9, 1e-160]
numbers = st.one_of(st.sampled_from(SPECIAL), st.floats(-2.0, 2.0))
vectors = st.tuples(numbers, numbers, numbers)
inside = st.tuples(*(st.floats(-step * LATTICE / 2, step * LATTICE / 2) for step in STEPS))
directions = vectors.filter(lambda v: sum(x * x for x in v) > 1e-6).map(
    lambda v: tuple(float(x) for x in np.array(v) / np.linalg.norm(v))
)
inverses = directions.map(lambda d: tuple(float(grid_walk.inverse(x)) for x in d))
places = st.one_of(st.sampled_from([0, 776, 777, LATTICE // 3, LATTICE - 1]), st.integers(0, LATTICE - 1))
points = st.tuples(places, places, places)
codes = st.integers(0, 2 * HALF_DIRECTION)
weights = st.one_of(st.sampled_from([0.0, 1.0, 2.0**63, 2.0**64, 1e-30, LARGEST_BINARY32]), st.floats(0.0))
heads, samples = st.integers(0, 2**40 - 1), st.integers(0, 2**32 - 1)
cells, steps, ports = st.sampled_from(CELLS), st.just(STEPS), st.integers(0, 7)


@formula(takes=(VECTOR, VECTOR, VECTOR), gives=LATTICE_POINT)
def beside_with_many_tries(step: Any, p: Any, d: Any) -> Any:
    """`lattice.beside_ray`, which is only a part of formulas."""
    return lattice.beside_ray(step, p, d, camera.TRIES)


# formula, what it takes and gives, and where its arguments come from
FORMULAS: dict[str, tuple[Callable[..., Any], Any, Any, Any]] = {
    "coordinate": (lattice.coordinate, (I64, F64), F64, (places, st.sampled_from(STEPS))),
    "nearest": (lattice.nearest, (F64, F64), I64, (st.floats(-1.0, 1.0), st.sampled_from(STEPS))),
    "beside_ray": (beside_with_many_tries, (VECTOR, VECTOR, VECTOR), LATTICE_POINT, (steps, inside, directions)),
    "inverse": (grid_walk.inverse, (F64,), F64, (numbers,)),
    "behind": (grid_walk.behind, (CELL, LATTICE_POINT), I64, (cells, points)),
    "towards_start": (grid_walk.towards_start, (CELL, LATTICE_POINT), I64, (cells, points)),
    "is_walking": (grid_walk.is_walking, (CELL, LATTICE_POINT, I64), BIT, (cells, points, ports)),
    "is_before_start": (grid_walk.is_before_start, (CELL, LATTICE_POINT, I64), BIT, (cells, points, ports)),
    "passage": (grid_walk.passage, (CELL, VECTOR, VECTOR), (F64, F64, I64), (cells, inside, inverses)),
    "towards_cell": (grid_walk.towards_cell, (LATTICE_POINT, LATTICE_POINT), I64, (points, points)),
    "for_boxes": (
        bvh_boxes.for_boxes,
        (VECTOR, VECTOR),
        ((F32,) * 6, (I64, I64, I64)),
        (inside, inverses),
    ),
    "octahedral": (packing.octahedral, (F64, F64, F64), (I64, I64), (numbers, numbers, numbers)),
    "unit_vector": (packing.unit_vector, (I64, I64), VECTOR, (codes, codes)),
    "pack_weight": (packing.pack_weight, (F64, F64, F64), I64, (weights, weights, weights)),
    "pack_shadow_weight": (packing.pack_shadow_weight, (F64,), I64, (weights,)),
    "ray_words": (packing.ray_words, (I64, LATTICE_POINT, VECTOR, I64), WORDS, (heads, points, directions, heads)),
    "shadow_words": (
        packing.shadow_words,
        (I64, LATTICE_POINT, I64, VECTOR),
        WORDS,
        (heads, points, st.integers(0, 65535), st.tuples(weights, weights, weights)),
    ),
    "pixel_and_point": (
        camera.pixel_and_point,
        (I64, F64, F64),
        ((I64, I64), (F64, F64)),
        (samples, st.sampled_from([1.0, 37.0, 65536.0]), st.sampled_from([1.0, 3.0, 1000.0])),
    ),
    "reach": (camera.reach, (VECTOR, VECTOR, VECTOR), (F64, F64), (steps, vectors, directions)),
    "entry": (camera.entry, (VECTOR, VECTOR, VECTOR), (BIT, LATTICE_POINT, F64), (steps, vectors, directions)),
    "primary_origin": (
        camera.primary_origin,
        (VECTOR, VECTOR, VECTOR, F64),
        LATTICE_POINT,
        (steps, vectors, directions, st.floats(0.0, 1.0)),
    ),
    "origin_beside": (
        spawn.origin_beside,
        (VECTOR, VECTOR, VECTOR, VECTOR),
        LATTICE_POINT,
        (steps, inside, directions, directions),
    ),
    "way_through": (
        ray_setup.way_through,
        (CELL, LATTICE_POINT, VECTOR, VECTOR, I64),
        (I64, VECTOR, F64, F64),
        (cells, points, inside, directions, ports),
    ),
    "towards_light": (
        shading.towards_light,
        (VECTOR, F64, VECTOR),
        (VECTOR, F64),
        (vectors, st.sampled_from([0.0, 1.0]), vectors),
    ),
}
ROOM = 2 * EIGHT


def flat(declared: Any, tree: Any) -> list[tuple[str, Any]]:
    """The kinds and numbers of a tree, in order."""
    found: list[tuple[str, Any]] = []
    mapped(lambda kind, value: found.append((kind, value)), declared, tree)
    return found


def wide(function: Callable[..., Any], takes: Any, gives: Any) -> Callable[..., Any]:
    """A formula over columns of two tables, of binary64 and of int64, a row a number; results are written into two others."""

    def read(declared: Any, tables: dict[str, tuple[Columns, list[int]]]) -> Any:
        def one(kind: str) -> Any:
            columns, rows = tables["whole" if kind == I64 else "float"]
            rows[0] += 1
            return columns.read(rows[0] - 1).to(kind)

        return mapped(one, declared)

    def staged(floats: Any, wholes: Any, made_floats: Any, made_wholes: Any, at: Any) -> None:
        tables = {"float": (Columns(floats, at, ROOM), [0]), "whole": (Columns(wholes, at, ROOM), [0])}
        made = {"float": (Columns(made_floats, at, ROOM), [0]), "whole": (Columns(made_wholes, at, ROOM), [0])}
        result = function(*(read(part, tables) for part in takes))
        for kind, value in flat(gives, result):
            columns, rows = made["whole" if kind in (I64, BIT) else "float"]
            rows[0] += 1
            columns.write(rows[0] - 1, value.to(I64 if kind in (I64, BIT) else F64))

    return eight(takes=(ARRAY, ARRAY, ARRAY, ARRAY, I64))(staged)


def tables(takes: Any, cases: list[Any], gives: Any) -> tuple[Any, Any, Any, Any]:
    """The tables of `wide` for at most ROOM cases."""
    columns = [[pair for part in zip(takes, case, strict=True) for pair in flat(*part)] for case in cases]
    floats, wholes = (
        np.array([[v for k, v in column if (k == I64) == whole] for column in columns], dtype).T
        for whole, dtype in ((False, np.float64), (True, np.int64))
    )
    made = [kind for kind, _ in flat(gives, gives)]
    tall = (
        np.zeros((len(floats), ROOM)),
        np.zeros((len(wholes), ROOM), np.int64),
        np.zeros((sum(k not in (I64, BIT) for k in made), ROOM)),
        np.zeros((sum(k in (I64, BIT) for k in made), ROOM), np.int64),
    )
    tall[0][:, : len(cases)], tall[1][:, : len(cases)] = floats, wholes
    return tall


def bits(gives: Any, result: Any) -> list[int]:
    """A tree of results as whole numbers; every number that is none is the same one."""
    out = []
    for kind, value in flat(gives, result):
        number = np.float64(value) if kind in (F64, F32) else np.int64(value)
        out.append(-1 if number != number else int(number.view(np.int64)))
    return out


@pytest.mark.parametrize("name", FORMULAS)
def test_three_ways(name: str) -> None:
    """One number, eight at once and interpreted, alone and eight at once."""
    function, takes, gives, strategies = FORMULAS[name]
    over_columns = wide(function, takes, gives)

    @njit(error_model="numpy")
    def one(arguments: Any) -> Any:
        return function(*arguments)

    @njit(error_model="numpy")
    def at_once(floats: Any, wholes: Any, made_floats: Any, made_wholes: Any) -> None:
        for at in range(0, ROOM, EIGHT):
            over_columns(floats, wholes, made_floats, made_wholes, at)

    @given(st.lists(st.tuples(*strategies), min_size=1, max_size=ROOM))
    @settings(deadline=None, max_examples=60)
    def holds(cases: list[Any]) -> None:
        compiled = [bits(gives, one(case)) for case in cases]
        assert compiled == [bits(gives, function(*case)) for case in cases]
        for run in (at_once, lambda *given: [over_columns(*given, at) for at in range(0, ROOM, EIGHT)]):
            tall = tables(takes, cases, gives)
            run(*tall)
            for k, wanted in enumerate(compiled):
                made = [iter(tall[2][:, k]), iter(tall[3][:, k])]
                got = mapped(lambda kind, made=made: next(made[kind in (I64, BIT)]), gives)
                assert bits(gives, got) == wanted

    holds()


def test_arrays_of_numbers_are_interpreted_at_once() -> None:
    """A formula of arrays gives arrays."""
    x, _, _ = packing.unit_vector(np.array([HALF_DIRECTION, 0]), np.array([HALF_DIRECTION, HALF_DIRECTION]))
    assert x.tolist() == [0.0, -1.0]


def test_another_kind_is_not_written_to_an_array() -> None:
    """Interpreted and compiled: LLVM, whose pointers have no types, would write over what lies beside."""

    @eight(takes=(ARRAY, I64))
    def narrowed(table: Any, at: Any) -> None:
        table.write(at, table.read(at).to(F32))

    @njit
    def compiled(table: Any) -> None:
        narrowed(table, 0)

    for run in (compiled, lambda table: narrowed(table, 0)):
        with pytest.raises((TypeError, errors.NumbaError), match="float32 is written to an array of float64"):
            run(np.zeros(EIGHT))


COMPILED_SAYS = r"came 0\.5, wanted int64" if config.DISABLE_JIT else "float64 came, wanted int64"


def test_wrong_arguments() -> None:
    """Are refused, interpreted and compiled."""
    with pytest.raises(TypeError, match=r"came 0\.5, wanted int64"):
        packing.unit_vector(0.5, 1)
    with pytest.raises((TypeError, errors.NumbaError), match=COMPILED_SAYS):
        njit(lambda: packing.unit_vector(0.5, 1))()
    with pytest.raises(IndexError, match=r"places 3\.\.10 of an array of 8"):
        bvh_boxes.copy_keys(np.zeros(8, np.int64), 3, np.zeros(8, np.int64), 0)
