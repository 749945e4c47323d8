"""A large mesh to load: a rippled ring of as many triangles as wanted, as a binary PLY file.

python benchmarks/big_mesh.py 1000000 ring.ply
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np

FACE = np.dtype([("count", "u1"), ("corners", "<i4", 3)])


def write_ring(path: Path, triangles: int) -> int:
    """Write the ring; returns how many triangles it has, at most as many as wanted."""
    across = max(3, math.isqrt(triangles // 4))
    along = max(3, triangles // 2 // across)
    u, v = (np.linspace(0.0, 2.0 * np.pi, n, endpoint=False) for n in (along, across))
    u, v = u[:, None], v[None, :]
    thick = 0.4 + 0.05 * np.sin(9.0 * u + 4.0 * v) + 0.02 * np.sin(31.0 * u) * np.cos(23.0 * v)
    wide = 1.0 + thick * np.cos(v)
    points = np.stack((wide * np.cos(u), thick * np.sin(v) + 0.0 * u, wide * np.sin(u)), axis=-1).reshape(-1, 3)
    corner = np.arange(along)[:, None] * across + np.arange(across)
    right, above = np.roll(corner, -1, axis=0), np.roll(corner, -1, axis=1)
    beyond = np.roll(right, -1, axis=1)
    faces = np.zeros(2 * corner.size, FACE)
    faces["count"] = 3
    faces["corners"][::2] = np.stack((corner, above, right), axis=-1).reshape(-1, 3)
    faces["corners"][1::2] = np.stack((right, above, beyond), axis=-1).reshape(-1, 3)
    head = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {len(points)}\nproperty float x\nproperty float y\nproperty float z\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    path.write_bytes(head.encode() + points.astype("<f4").tobytes() + faces.tobytes())
    return len(faces)


if __name__ == "__main__":
    if len(sys.argv) != 3 or not sys.argv[1].isdigit():
        sys.exit("usage: python benchmarks/big_mesh.py TRIANGLES FILE.ply")
    print(f"{write_ring(Path(sys.argv[2]), int(sys.argv[1]))} triangles")
