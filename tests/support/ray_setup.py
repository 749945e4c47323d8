"""Cells, places of packets and frames with which the set-up of rays and their classes are tested."""

import numpy as np
from hypothesis import strategies as st

from raygrid.emulator.processes.warm import tiny_frame as one_frame
from raygrid.node.geometry.lattice import LATTICE, make_cell, make_space
from raygrid.node.protocol.frame_tables import LIGHT_COLUMNS, LIGHT_KIND, LIGHT_PLACE
from raygrid.node.protocol.packing import HALF_DIRECTION

STEPS = (2.0**-24, 1.5 * 2.0**-25, 2.0**-26)
PLANES = [[0, LATTICE // 3, LATTICE], [0, 777, 5_000_000, LATTICE], [0, LATTICE]]
SPACE = make_space(STEPS, PLANES)
CELLS = [make_cell(SPACE, (x, y, 0)) for x in range(2) for y in range(3)]

# what rounding and signs make special: planes themselves, their neighbours, the middle, the ends
coordinates = st.one_of(
    st.sampled_from([0, 1, LATTICE // 3 - 1, LATTICE // 3, LATTICE // 2, 776, 777, 5_000_000, LATTICE - 1]),
    st.integers(0, LATTICE - 1),
)
codes = st.one_of(
    st.sampled_from([0, 1, HALF_DIRECTION - 1, HALF_DIRECTION, HALF_DIRECTION + 1, 2 * HALF_DIRECTION]),
    st.integers(0, 2 * HALF_DIRECTION),
)
places = st.one_of(st.sampled_from([-0.5, 0.0, 0.25]), st.floats(-0.625, 0.625, width=32))
ports = st.integers(0, 7)


def frame_with(lights):
    """A frame with these lights, (kind, x, y, z)."""
    table = np.zeros((len(lights), LIGHT_COLUMNS))
    for row, (kind, *place) in zip(table, lights, strict=True):
        row[LIGHT_KIND], row[LIGHT_PLACE : LIGHT_PLACE + 3] = kind, place
    return one_frame()._replace(lights=table, n_lights=len(lights))
