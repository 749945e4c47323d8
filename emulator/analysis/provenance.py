"""Follows the tree of rays that one sample makes, with every cell that each of them crosses: its provenance.

A sample's primary ray is emitted at its home and handed through the nodes' own step, one packet at a time, so whose child
each packet is, is known and not guessed. The step is an observed one, which also says which surface was met, and where; where
that does not agree with what it makes of the packet, ArrayError is raised.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import NamedTuple

from raygrid.emulator.analysis.sample_facts import begin, sees_outside
from raygrid.emulator.analysis.single_step import Served, SingleStep, Units, Vector
from raygrid.emulator.topology.coordinates import Index, beyond
from raygrid.node import protocol
from raygrid.node.errors import ArrayError, SceneError
from raygrid.node.geometry import HALF, OPPOSITE, PORTS, SELF, Space, SurfaceSet
from raygrid.node.tracing import MAX_INTENSITY, UNIT

MOST_RAYS = 1_000_000  # of one tree


class Meeting(NamedTuple):
    """A ray and the surface that it met: id in the scene, row of the material table, machine coordinates, cell.

    distance  from where the ray starts
    """

    surface: int
    material: int
    point: Vector
    distance: float
    cell: Index


class CameBack(NamedTuple):
    """A return packet. intensity: as it travels (binary32); units: of 2^-24, what its home added to the pixel.

    cells   where it was born, and all to which it was handed; the last is the sample's home
    """

    intensity: Vector
    units: Units
    cells: list[Index]


@dataclass
class Ray:
    """One ray of a tree, machine coordinates.

    light      number of the light to which a shadow ray goes, else None
    origin     where it starts, a lattice point; direction: unit vector (a shadow ray's: towards its light)
    weight     of a ray: what it adds of what it sees; of a shadow ray: the intensity that it adds
    cells      where it was born, and all to which it was handed, in order
    start      place in `cells` of the cell that holds its origin: rounding may put that beside the cell where it was made
    met        the surface at which it ended, or None
    left       whether it left the world (a shadow ray: reached its light, which may be out there)
    inside     whether it is in the place of a refracted ray, all of which is reflected (total internal reflection)
    came_back  what it brought home, or None
    """

    kind: protocol.PacketKind
    depth: int
    origin: Vector
    direction: Vector
    weight: Vector
    light: int | None = None
    cells: list[Index] = field(default_factory=list)
    start: int = 0
    met: Meeting | None = None
    left: bool = False
    inside: bool = False
    came_back: CameBack | None = None
    children: list[Ray] = field(default_factory=list)


@dataclass(frozen=True)
class SampleTree:
    """A sample and its tree; `ray` is None if the eye's ray misses the world box and sees what is behind it.

    number  of the sample in its pixel
    units   what it adds to the pixel, in units of 2^-24
    """

    number: int
    units: Units
    ray: Ray | None


@dataclass
class _InTransit:
    """A packet on its way, and the record of its ray."""

    packet: bytes
    index: Index
    port: int
    ray: Ray


class Provenance:
    """Traces single samples through a loaded array in memory. space, surfaces, frame: machine coordinates.

    Raises ArrayError if the array cannot be loaded.
    """

    def __init__(self, space: Space, surfaces: SurfaceSet, frame: protocol.Frame, most_rays: int = MOST_RAYS) -> None:
        self._steps = SingleStep(space, surfaces, frame)
        self.space, self.frame, self._most_rays = space, frame, most_rays

    def pixel(self, x: int, y: int, only: int | None = None) -> list[SampleTree]:
        """The samples of a pixel, row 0 on top; `only`: that one. Raises SceneError for a pixel or sample that is not."""
        frame = self.frame
        if not (0 <= x < frame.width and 0 <= y < frame.height):
            raise SceneError(f"a pixel came as {x},{y}, wanted 0,0 to {frame.width - 1},{frame.height - 1}")
        if only is not None and not 0 <= only < frame.samples:
            raise SceneError(f"a sample came as {only}, wanted 0 to {frame.samples - 1}")
        numbers = range(frame.samples) if only is None else [only]
        return [self.sample(y * frame.width + x, number) for number in numbers]

    def sample(self, pixel: int, number: int) -> SampleTree:
        """One sample of a pixel (row times width plus column). Raises ArrayError if the step contradicts itself."""
        sample = pixel * self.frame.samples + number
        enters, home, direction = begin(self.space, self.frame, sample)
        if not enters:
            red, green, blue = sees_outside(self.frame, direction)
            return SampleTree(number, (int(red), int(green), int(blue)), None)
        index = (int(home[0]), int(home[1]), int(home[2]))
        before = self._steps.stored(index, pixel)
        packet = self._steps.emit(index, sample)
        if packet is None:
            raise ArrayError(f"sample {number} of pixel {pixel} has its home at {index}, which does not emit it")
        root = self._record(packet, index)
        waiting, rays = [_InTransit(packet, index, SELF, root)], 1
        while waiting:
            transit = waiting.pop()
            children = self._follow(transit)
            rays += len(children)
            if rays > self._most_rays:
                raise SceneError(
                    f"sample {number} of pixel {pixel} makes more than {self._most_rays:,} rays, wanted fewer: "
                    "a smaller depth or a larger least weight prunes its tree"
                )
            transit.ray.children = [child.ray for child in children]
            waiting += children
        after = self._steps.stored(index, pixel)
        self._check_conserved()
        return SampleTree(number, (after[0] - before[0], after[1] - before[1], after[2] - before[2]), root)

    def _follow(self, transit: _InTransit) -> list[_InTransit]:
        """Hand one packet from node to node until it dies; what it made."""
        ray, walked = transit.ray, False
        while True:
            if ray.cells[-1] != transit.index:
                ray.cells.append(transit.index)
            served = self._steps.serve(transit.index, transit.packet, transit.port)
            if served.counts[protocol.WALKS] and not walked:
                walked, ray.start = True, len(ray.cells) - 1
            if served.counts[protocol.DIED + ray.kind]:
                return self._ended(transit, served)
            ((output, transit.packet),) = served.out
            transit.index, transit.port = _over(transit.index, output)

    def _ended(self, transit: _InTransit, served: Served) -> list[_InTransit]:
        """Write down how a ray ended."""
        ray, index = transit.ray, transit.index
        met, surfaces = served.met, self._steps.nodes[index].surfaces
        ray.direction = met.direction
        hit, returned = bool(served.counts[protocol.HITS]), bool(served.counts[protocol.BORN + protocol.RETURN])
        if ray.kind == protocol.SHADOW:
            hit = not returned and max(ray.weight) > 0.0
        if (met.item >= 0) != hit and not (ray.kind == protocol.SHADOW and max(ray.weight) == 0.0):
            raise ArrayError(f"node {index}: a ray of depth {ray.depth} ended otherwise than its surfaces say")
        if met.item >= 0:
            surface, material = int(surfaces.ids[met.item]), int(surfaces.materials[met.item])
            ray.met = Meeting(surface, material, met.point, met.time, index)
        else:
            ray.left = True
        if returned:
            ray.came_back = self._returned(transit, served)
            return []
        children = [self._child(index, output, packet) for output, packet in served.out]
        children.sort(key=lambda child: (child.ray.kind != protocol.SHADOW, child.ray.light or 0, child.ray.kind))
        turned = [child for child in children if child.ray.kind == protocol.REFLECTED]
        if met.inside and turned:  # behind the one that the mirror makes, if it does; it has the whole weight
            turned[-1].ray.inside = turned[-1].ray.weight == ray.weight
        return children

    def _returned(self, transit: _InTransit, served: Served) -> CameBack:
        """Hand a return packet to its home. Raises ArrayError if that adds something else than it carries."""
        index, pixel = transit.index, protocol.decode(transit.packet).number // self.frame.samples
        cells = [index]
        if not served.out:  # it was at home where it was born, and is in the store already
            intensity = self._steps.brought_home()
            return CameBack(intensity, _fixed(intensity), cells)
        ((output, packet),) = served.out
        intensity = _vector(protocol.decode(packet).values)
        while True:
            index, port = _over(index, output)
            cells.append(index)
            before = self._steps.stored(index, pixel)
            served = self._steps.serve(index, packet, port)
            if served.counts[protocol.DIED + protocol.RETURN]:
                break
            ((output, packet),) = served.out
        after = self._steps.stored(index, pixel)
        units = after[0] - before[0], after[1] - before[1], after[2] - before[2]
        if units != _fixed(intensity):
            raise ArrayError(f"home {index} added {units} for a return of {intensity}")
        return CameBack(intensity, units, cells)

    def _child(self, index: Index, output: int, packet: bytes) -> _InTransit:
        ray = self._record(packet, index)
        return _InTransit(packet, *_over(index, output), ray)

    def _record(self, packet: bytes, index: Index) -> Ray:
        read = protocol.decode(packet)
        assert read.origin is not None
        x, y, z = ((k - HALF) * step for k, step in zip(read.origin, self.space.step, strict=True))
        direction = read.direction or (0.0, 0.0, 0.0)
        ray = Ray(read.kind, read.depth, (x, y, z), direction, _vector(read.values), read.light)
        ray.cells.append(index)
        return ray

    def _check_conserved(self) -> None:
        counts = self._steps.counts()
        for kind in (*range(protocol.PRIMARY, protocol.SHADOW), protocol.SHADOW, protocol.RETURN):
            if counts[protocol.BORN + kind] != counts[protocol.DIED + kind]:
                born, died = counts[protocol.BORN + kind], counts[protocol.DIED + kind]
                raise ArrayError(f"{born} packets of kind {protocol.PacketKind(kind).name} were born and {died} died")


def _over(index: Index, output: int) -> tuple[Index, int]:
    """Where a packet on this output arrives, and by which port."""
    if output >= PORTS:
        return index, SELF
    return beyond(index, output), OPPOSITE[output]


def _vector(values: Iterable[float]) -> Vector:
    red, green, blue = values
    return float(red), float(green), float(blue)


def _fixed(intensity: Vector) -> Units:
    red, green, blue = (int(min(value, MAX_INTENSITY) * UNIT + 0.5) for value in intensity)
    return red, green, blue
