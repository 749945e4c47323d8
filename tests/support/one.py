"""One packet through one node: what comes out of it, decoded. For answers known by hand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from raygrid.node.geometry.grid_walk import OUTPUTS, SELF
from raygrid.node.geometry.lattice import HALF, nearest
from raygrid.node.geometry.surfaces import Kind, merge
from raygrid.node.protocol import decoding, packets
from raygrid.node.protocol.decoding import Packet
from raygrid.node.protocol.frame_tables import Frame
from raygrid.node.protocol.messages import HEAD
from raygrid.node.protocol.packets import SIZE
from raygrid.node.protocol.packing import octahedral, pack_weight
from raygrid.node.tracing.step import step
from support.driver import Grid
from support.frames import make_frame, orthographic
from support.packets import ray_bytes, return_bytes, shadow_bytes
from support.scenes import EVEN_STEP, space_of
from support.space import Index
from support.surfaces import F64, batch

Vector = Sequence[float] | F64
SIZE_OF_PICTURE = (10, 10)
FRONT = orthographic([0, 0, 2], [0, 0, -1], 0.4, SIZE_OF_PICTURE, up=(0, 1, 0))  # every sample enters by z = 1/2


def lattice(point: Vector) -> Index:
    """The lattice point of a place."""
    k = [int(nearest(float(x), step)) for x, step in zip(point, EVEN_STEP, strict=True)]
    return k[0], k[1], k[2]


def place(origin: Index) -> F64:
    """The place of a lattice point."""
    return (np.array(origin) - HALF) * np.array(EVEN_STEP)


def ray(
    origin: Vector,
    direction: Vector,
    *,
    kind: int = packets.PRIMARY,
    depth: int = 1,
    sample: int = 0,
    weight: Vector = (1.0, 1.0, 1.0),
) -> bytes:
    """A ray packet from a place in a direction."""
    d = [float(x) for x in direction]
    return ray_bytes(kind, depth, sample, lattice(origin), octahedral(*d), pack_weight(*(float(w) for w in weight)))


def shadow(
    origin: Vector, light: int = 0, *, sample: int = 0, weight: tuple[float, float, float] = (0.5, 0.25, 1.0)
) -> bytes:
    """A shadow packet from a place to a light."""
    return shadow_bytes(1, sample, lattice(origin), light, weight)


def returning(home: Index, *, sample: int = 0, intensity: tuple[float, float, float] = (0.5, 0.25, 1.0)) -> bytes:
    """A return packet on its way to a home."""
    return return_bytes(1, sample, intensity, home)


@dataclass
class Served:
    """What a step made of one packet."""

    out: dict[int, list[Packet]]  # by output, those with packets only
    counts: NDArray[np.int64]
    sums: NDArray[np.int64]  # (pixels, 3) of the node's own store

    def only(self, output: int, kind: int) -> Packet:
        """The one packet of this kind on this output."""
        (found,) = (packet for packet in self.out.get(output, []) if packet.kind == kind)
        return found

    def number(self, kind: int) -> int:
        """How many packets of this kind came out, on all outputs."""
        return sum(packet.kind == kind for row in self.out.values() for packet in row)


Rows = Sequence[tuple[Kind, Vector, int]]  # kind, row, material


def serve(
    data: bytes,
    surfaces: Rows = (),
    frame: Frame | None = None,
    *,
    port: int = SELF,
    shape: str = "1x1x1",
    index: Index = (0, 0, 0),
) -> Served:
    """Hand one packet to one node of an array that holds these surfaces."""
    made = [batch(kind, [np.array(row, float)], k, [material]) for k, (kind, row, material) in enumerate(surfaces)]
    grid = Grid(space_of(shape, EVEN_STEP), merge(made), frame or make_frame(FRONT, SIZE_OF_PICTURE))
    node, outputs = grid.nodes[index], grid.outputs
    decoding.check(data, grid.limits)
    rows, ports = np.frombuffer(bytearray(data), np.uint8), np.array([port], np.uint8)
    done = step(grid.tables(node), rows, ports, 0, 1)
    assert done == 1
    out = {}
    for output in range(OUTPUTS):
        held = int(outputs.held[output])
        flat = outputs.data[output, HEAD : HEAD + held * SIZE].tobytes()
        assert packets.first_fault(outputs.data[output], HEAD, held, grid.limits) == (-1, 0)
        if held:
            out[output] = [decoding.decode(flat[k * SIZE : (k + 1) * SIZE]) for k in range(held)]
    return Served(out, node.counts, grid.sums()[:, :3])
