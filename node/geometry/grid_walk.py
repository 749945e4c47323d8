"""Walks a ray from cell to cell: finds the next one, and the times between which hits belong to this one (DESIGN section 4).

Both nodes at a face compute the time of its plane from the same numbers: (plane - origin) * inverse
direction. Subtraction and multiplication round monotonically, so along a ray these times never run
backwards and all nodes agree on the path; a ray makes at most NX + NY + NZ - 2 hops after its start.
"""

from __future__ import annotations

from raygrid.node.jit.decorators import part

# ports, in the order -x +x -y +y -z +z, then what is not a neighbour
PORTS = 6
HOST = 6  # of a corner node: the way to the host
SELF = 7  # arrival port of what was spawned here; also the output of shadow rays that start here
SELF_RAYS = 8  # output of other rays that start here
OUTPUTS = 9
NO_PORT = -1
OPPOSITE = (1, 0, 3, 2, 5, 4)

HUGE = 1e18  # stands for 1 / 0: finite, so that 0 * HUGE is 0 and never not-a-number


@part
def inverse(d):
    """1 / d, finite for d = 0 (and never larger than HUGE)."""
    quotient = 1.0 / d
    return HUGE if abs(d) < 1.0 / HUGE else quotient


@part
def towards_start(cell, origin):
    """The port on the way to the cell that holds this lattice origin, x before y before z; NO_PORT: it is here."""
    if origin[0] < cell.low[0]:
        return 0
    if origin[0] >= cell.high[0]:
        return 1
    if origin[1] < cell.low[1]:
        return 2
    if origin[1] >= cell.high[1]:
        return 3
    if origin[2] < cell.low[2]:
        return 4
    if origin[2] >= cell.high[2]:
        return 5
    return NO_PORT


@part
def is_walking(cell, origin, port):
    """Tell whether a ray that came in by `port` has left the cell of its origin behind on that axis.

    If its hop brought it nearer to that cell instead, it is still on its way to its start.
    """
    if port == SELF:
        return False
    if port == 0:  # came from the neighbour at -x, so it moved along +x
        return origin[0] < cell.low[0]
    if port == 1:
        return origin[0] >= cell.high[0]
    if port == 2:
        return origin[1] < cell.low[1]
    if port == 3:
        return origin[1] >= cell.high[1]
    if port == 4:
        return origin[2] < cell.low[2]
    return origin[2] >= cell.high[2]


@part
def _axis_times(at, inv, low_at, high_at):
    """(time of entry, time of exit) of one axis; entry is not above 0 if the origin lies between the planes, or where
    the ray goes away from them."""
    low, high = (low_at - at) * inv, (high_at - at) * inv
    return min(low, high), max(low, high)


@part
def passage(cell, at, inv):
    """(t_in, t_out, exit port) of a walking ray.

    at  its origin, inv  its inverse direction.
    A hit at t belongs to this cell if t_in <= t < t_out; t_in is not above 0 in the cell of the origin.
    The exit port is the axis with the least exit time, ties in the order x, y, z.

    There are no branches: which way a ray goes can hardly be foreseen, and a processor that guessed wrong begins again.
    """
    in_x, out_x = _axis_times(at[0], inv[0], cell.low_at[0], cell.high_at[0])
    in_y, out_y = _axis_times(at[1], inv[1], cell.low_at[1], cell.high_at[1])
    in_z, out_z = _axis_times(at[2], inv[2], cell.low_at[2], cell.high_at[2])
    out_yz = min(out_y, out_z)
    x, y, z = 1 if inv[0] >= 0.0 else 0, 3 if inv[1] >= 0.0 else 2, 5 if inv[2] >= 0.0 else 4
    yz = y if out_y <= out_z else z
    return max(in_x, max(in_y, in_z)), min(out_x, out_yz), x if out_x <= out_yz else yz


@part
def leaves_array(index, shape, port):
    """Tell whether there is no neighbour behind this port."""
    axis = port >> 1
    if port & 1:
        return index[axis] + 1 >= shape[axis]
    return index[axis] == 0


@part
def towards_cell(index, target):
    """The port on the way to another cell, x before y before z; NO_PORT: it is this one. Without a branch."""
    x, y, z = 0 if target[0] < index[0] else 1, 2 if target[1] < index[1] else 3, 4 if target[2] < index[2] else 5
    port = z if target[2] != index[2] else NO_PORT
    port = y if target[1] != index[1] else port
    return x if target[0] != index[0] else port
