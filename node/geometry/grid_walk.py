"""Walks a ray from cell to cell: finds the next one, and the times between which hits belong to this one (DESIGN section 4).

Both nodes at a face compute the time of its plane from the same numbers: (plane - origin) * inverse
direction. Subtraction and multiplication round monotonically, so along a ray these times never run
backwards and all nodes agree on the path; a ray makes at most NX + NY + NZ - 2 hops after its start.
"""

from __future__ import annotations

from raygrid.node.geometry.lattice import CELL
from raygrid.node.jit.decorators import part
from raygrid.node.jit.formula import formula
from raygrid.node.jit.lanes import BIT, F64, I64, LATTICE_POINT, VECTOR, Lanes, Staged, Three, least, most

# ports, in the order -x +x -y +y -z +z, then what is not a neighbour
PORTS = 6
HOST = 6  # of a corner node: the way to the host
SELF = 7  # arrival port of what was spawned here; also the output of shadow rays that start here
SELF_RAYS = 8  # output of other rays that start here
OUTPUTS = 9
NO_PORT = -1
OPPOSITE = (1, 0, 3, 2, 5, 4)

HUGE = 1e18  # stands for 1 / 0: finite, so that 0 * HUGE is 0 and never not-a-number


@formula(takes=(F64,), gives=F64)
def inverse(d: Lanes) -> Lanes:
    """1 / d, finite for d = 0 (and never larger than HUGE)."""
    return (abs(d) < 1.0 / HUGE).choose(HUGE, 1.0 / d)


@formula(takes=(CELL, LATTICE_POINT), gives=I64)
def behind(cell: Staged, origin: Three) -> Lanes:
    """Mark the ports behind which a lattice point lies, a bit each; 0 for one in the cell."""
    bits: list[Lanes] = []
    for axis, at in enumerate(origin):
        low, high = cell.low[axis].to(at.kind), cell.high[axis].to(at.kind)
        bits += [(at < low).to(at.kind) << (2 * axis), (at >= high).to(at.kind) << (2 * axis + 1)]
    return (bits[0] | bits[2] | bits[4]) | (bits[1] | bits[3] | bits[5])


@formula(takes=(CELL, LATTICE_POINT), gives=I64)
def towards_start(cell: Staged, origin: Three) -> Lanes:
    """The port on the way to the cell that holds this lattice origin, x before y before z; NO_PORT: it is here."""
    ports: Lanes = behind(cell, origin)
    return ports.equals(0).choose(NO_PORT, ports.lowest_bit())


@formula(takes=(CELL, LATTICE_POINT, I64), gives=BIT)
def is_walking(cell: Staged, origin: Three, port: Lanes) -> Lanes:
    """Tell whether a ray that came in by `port` has left the cell of its origin behind on that axis.

    If its hop brought it nearer to that cell instead, it is still on its way to its start.
    """
    ports: Lanes = behind(cell, origin)
    return ports >> port & 1 >= 1


@formula(takes=(CELL, LATTICE_POINT, I64), gives=BIT)
def is_before_start(cell: Staged, origin: Three, port: Lanes) -> Lanes:
    """Tell whether a ray that came in by `port` has to go to the cell of its origin first."""
    ports: Lanes = behind(cell, origin)
    return (ports >= 1).lacks(is_walking(cell, origin, port))


@formula(takes=(CELL, VECTOR, VECTOR), gives=(F64, F64, I64))
def passage(cell: Staged, at: Three, inv: Three) -> tuple[Lanes, Lanes, Lanes]:
    """(t_in, t_out, exit port) of a walking ray.

    at  its origin, inv  its inverse direction.
    A hit at t belongs to this cell if t_in <= t < t_out; t_in is not above 0 in the cell of the origin.
    The exit port is the axis with the least exit time, ties in the order x, y, z.

    There are no branches: which way a ray goes can hardly be foreseen, and a processor that guessed wrong begins again.
    """
    times = [
        ((cell.low_at[axis] - at[axis]) * inv[axis], (cell.high_at[axis] - at[axis]) * inv[axis]) for axis in range(3)
    ]
    (in_x, in_y, in_z), (out_x, out_y, out_z) = ([of(*pair) for pair in times] for of in (least, most))
    out_yz = least(out_y, out_z)
    x, y, z = ((inv[axis] >= 0.0).to(I64) + 2 * axis for axis in range(3))
    way = (out_x <= out_yz).choose(x, (out_y <= out_z).choose(y, z))
    return most(in_x, most(in_y, in_z)), least(out_x, out_yz), way


@part
def leaves_array(index, shape, port):
    """Tell whether there is no neighbour behind this port."""
    axis = port >> 1
    if port & 1:
        return index[axis] + 1 >= shape[axis]
    return index[axis] == 0


@formula(takes=(LATTICE_POINT, LATTICE_POINT), gives=I64)
def towards_cell(index: Three, target: Three) -> Lanes:
    """The port on the way to another cell, x before y before z; NO_PORT: it is this one. Without a branch."""
    port = index[0].every(NO_PORT)
    for axis in (2, 1, 0):
        port = target[axis].equals(index[axis]).choose(port, (target[axis] >= index[axis]).to(I64) + 2 * axis)
    return port
