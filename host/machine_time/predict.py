"""Predicts the machine time of a frame on any array within seconds, from pictures with few pixels.

Three pictures of the same view are made for each array. The largest is counted: each ray is followed through the cells of the
array by the nodes' own ray step, so that what each cell has to do is known, and by groups of pixels how well. Two smaller ones
are simulated with all their queues, and tell by how much a frame takes longer than the busiest processor works
(`host.machine_time.prediction_law`). A frame that is no larger than what would be simulated anyway is simulated itself.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, SupportsIndex

import numpy as np
from numpy.typing import NDArray

from raygrid.emulator.simulator import (
    LEAST_ACROSS,
    CellWork,
    Holding,
    Model,
    check_count_fits,
    count_cell_work,
    few_pixels,
    flood,
    hold,
    ordered,
    price_lists,
    read_out,
    steps_of_a_sample,
    trace,
)
from raygrid.emulator.topology import parse_shape
from raygrid.host.machine_time.cost_models import LEVELS, CostModel, load_cost_model
from raygrid.host.machine_time.prediction_law import (
    FEW_RAYS,
    LIKELY,
    Extrapolated,
    extrapolated,
    jackknifed,
    share_of,
)
from raygrid.host.render.animation_jobs import still_job
from raygrid.host.render.job import Job, Settings
from raygrid.host.scene.load import load_scene
from raygrid.host.scene.scene import Scene
from raygrid.host.text.clean_text import printable
from raygrid.host.text.misuse import ArrayMisuse, CostMisuse
from raygrid.node.geometry import Batch, SurfaceSet
from raygrid.node.protocol import Prices

if TYPE_CHECKING:
    from raygrid.host.scene.load import SceneLike

MIDDLE = LEVELS.index("middle")
STEPS = 3_000_000  # that are counted, for all arrays together
EVENTS = 1_200_000  # that are simulated, for all arrays together
LEAST_STEPS = 60_000  # for each array, however many there are
SMALLER = 4.0  # times fewer samples in the smaller of the simulated pictures
FLOODED = 4096  # surfaces whose flood is simulated; of more, every so manieth
READ_OUT_ERROR = 0.005  # of a read-out that was told from two pictures, beside that of the number of pixels
FLOOD_ERROR = 0.1  # of a set-up that was told from a part of the surfaces
Long = NDArray[np.int64]
Shape = tuple[int, int, int]
Arrays = str | Shape | Iterable[str | Shape]
Tell = Callable[[str], None]
"""Told what is done."""


@dataclass(frozen=True)
class Estimate:
    """A time in machine seconds, and by what part of itself it may be off: 0 if it was simulated as it is."""

    seconds: float
    error: float

    @property
    def low(self) -> float:
        """The least that it may be."""
        return self.seconds * max(1.0 - self.error, 0.0)

    @property
    def high(self) -> float:
        """The most that it may be."""
        return self.seconds * (1.0 + self.error)


@dataclass(frozen=True)
class Prediction:
    """The time of a frame on one array, by one cost model with its middle costs.

    frame, set_up, read_out   times of the phases
    band       seconds of the frame by low and by high costs
    busiest    seconds that the busiest processor works; its share of the frame and the latency, seconds, are what makes
               the frame of it: frame = share x busiest + latency
    balance    work of the busiest processor by that of the mean one
    rays       primary rays that enter the world box; rays_a_processor: by processors
    few_rays   fewer than ten a processor: the time is that of single rays, and less sure
    whole      the frame was simulated as it is
    """

    array: tuple[int, int, int]
    cost: str
    search: str
    size: tuple[int, int]
    samples: int
    frame: Estimate
    set_up: Estimate
    read_out: Estimate
    band: tuple[float, float]
    busiest: Estimate
    share: float
    latency: float
    balance: float
    rays: int
    rays_a_processor: float
    few_rays: bool
    whole: bool

    @property
    def processors(self) -> int:
        """Count the processors of the array."""
        return self.array[0] * self.array[1] * self.array[2]


def predict(
    scene: SceneLike,
    arrays: Arrays,
    cost: str = "8086",
    *,
    search: str | None = None,
    size: tuple[int, int] | None = None,
    samples: int | None = None,
    depth: int | None = None,
    split: str = "balanced",
) -> list[Prediction]:
    """Predict the machine time of a scene's frame on one or more arrays.

    arrays  such as "10x10x10" or (10, 10, 10), or several of these
    cost    name of a cost model or path of one; search: "list", "tree", or None: as the cost model says
    size, samples, depth, split   as for `Machine.render`; size in pixels, None: what the scene's file asks for

    Raises SceneError, CostError, and ArrayError for an array that cannot be or for which this computer has no memory.
    """
    model = load_cost_model(cost)
    if search not in (None, "list", "tree"):
        raise CostMisuse(f"a search came as {search!r}, wanted list or tree")
    shapes = _shapes(arrays)
    asked = Settings(size=size, samples=samples, depth=depth, split=split)
    return predict_arrays(scene if isinstance(scene, Scene) else load_scene(scene), shapes, model, search, asked)


def _shapes(arrays: Arrays) -> list[Shape]:
    """What arrays were asked for, one or several."""
    one = isinstance(arrays, str) or (isinstance(arrays, tuple) and all(isinstance(n, SupportsIndex) for n in arrays))
    asked: Iterable[Any] = [arrays] if one else arrays
    try:
        texts = [array if isinstance(array, str) else "x".join(map(str, array)) for array in asked]
    except TypeError:  # what came, or a part of it, holds no numbers
        came = printable(repr(arrays), 60)
        raise ArrayMisuse(f"arrays came as {came}, wanted one or more such as 10x10x10 or (10, 10, 10)") from None
    try:
        shapes = [parse_shape(text) for text in texts]
    except ValueError as error:
        raise ArrayMisuse(f"{error}") from None
    if not shapes:
        raise ArrayMisuse("no array came, wanted one or more such as 10x10x10")
    return shapes


def predict_arrays(
    scene: Scene,
    shapes: list[Shape],
    cost: CostModel,
    search: str | None,
    settings: Settings,
    frame: int | None = None,
    tell: Tell = lambda _: None,
) -> list[Prediction]:
    """Predict a scene that is read, on arrays whose shapes are checked; frame: of a shot, None for its first."""
    chosen = search or cost.file.search
    for shape in shapes:
        check_count_fits(shape, len(LEVELS))
    found = []
    for shape in shapes:
        tell(f"{scene.name}: {'x'.join(map(str, shape))}")
        found.append(_predicted(still_job(scene, shape, settings, frame), cost, chosen, len(shapes)))
    return found


def _predicted(job: Job, cost: CostModel, search: str, arrays: int) -> Prediction:
    """One array of several."""
    holding = hold(job.space, job.surfaces, search)
    prices = [cost.prices(level, search) for level in LEVELS]
    walks = [cost.list_ticks(level, search, holding.held) for level in LEVELS]
    lists = price_lists(prices, walks)
    steps = steps_of_a_sample(holding, job.frame, lists)
    work = count_cell_work(holding, job.frame, lists, max(STEPS / arrays, LEAST_STEPS) / steps)
    most, standard = jackknifed(work.busy[:, :, MIDDLE].astype(np.float64))
    most, standard = most * work.share, standard * (work.share > 1.0)
    samples = max(EVENTS / arrays, LEAST_STEPS) / (steps + 1.0)
    pictures = _simulated(job, holding, (prices[MIDDLE], walks[MIDDLE]), samples)
    large = pictures[-1]
    law = share_of((pictures[0].busiest, pictures[0].ticks), (large.busiest, large.ticks))
    whole, rays = large.share == 1.0, round(int(work.born.sum()) * work.share)
    few = rays < FEW_RAYS * holding.cells
    told = Extrapolated(large.ticks, 0.0, large.ticks - law.share * large.busiest)
    if not whole:
        longest = float(work.longest[MIDDLE])
        told = extrapolated(law, (large.busiest, large.ticks), longest, (most, standard), few)
    hertz = cost.file.hertz
    return Prediction(
        job.space.shape, cost.name, search, (job.frame.width, job.frame.height), job.frame.samples,
        Estimate(told.time / hertz, told.error),
        _set_up(job, cost, prices[MIDDLE]),
        _read_out(pictures, job, cost),
        _band(work, told.time / hertz),
        Estimate(most / hertz, LIKELY * standard), law.share, told.latency / hertz,
        _balance(work), rays, rays / holding.cells, few, whole,
    )  # fmt: skip


class _Picture(NamedTuple):
    """A simulated picture: samples of the frame for each of its own, ticks, those of the busiest processor; pixels, and
    the ticks that it takes to read them out."""

    share: float
    ticks: float
    busiest: float
    pixels: float
    read_out: float


def _simulated(job: Job, holding: Holding, priced: tuple[Prices, Long], samples: float) -> list[_Picture]:
    """Simulate the smaller and the larger picture; the frame itself, and no other, if it is no larger."""
    frames = [few_pixels(job.frame, samples)]
    if frames[0] is not job.frame:
        frames.insert(0, few_pixels(job.frame, samples / SMALLER, LEAST_ACROSS // 2))
    return [_picture(job, holding.model(frame), priced) for frame in frames]


def _picture(job: Job, model: Model, priced: tuple[Prices, Long]) -> _Picture:
    """Simulate one picture of the frame and its read-out. The clocks of one phase are kept at a time: they are large."""
    phase, pixels = trace(model, *priced)
    ticks, busiest = phase.ticks, float(phase.column("busy").max())
    del phase
    out = read_out(model, priced[0], pixels).host
    few = model.frame.width * model.frame.height
    share = job.pixels * job.frame.samples / (few * model.frame.samples)
    return _Picture(share, ticks, busiest, few, out)


def _read_out(pictures: list[_Picture], job: Job, cost: CostModel) -> Estimate:
    """All pixels leave by the corners, so the time grows with their number."""
    small, large = pictures[0], pictures[-1]
    if large.share == 1.0:
        return Estimate(cost.seconds(int(large.read_out)), 0.0)
    law = share_of((small.pixels, small.read_out), (large.pixels, large.read_out), 0.0)
    ticks = law.share * job.pixels + law.latency
    return Estimate(ticks / cost.file.hertz, READ_OUT_ERROR + 1.0 / math.sqrt(large.pixels))


def _set_up(job: Job, cost: CostModel, prices: Prices) -> Estimate:
    """Flood the surfaces, or every so manieth: nearly all the time is that of the busiest corner, so it grows with them."""
    every = -(-len(job.surfaces) // FLOODED)
    surfaces = job.surfaces if every == 1 else SurfaceSet(tuple(_every(batch, every) for batch in job.surfaces))
    ticks = flood(job.space, ordered(surfaces), prices, cost.file.ticks.description[MIDDLE]).ticks
    scale = len(job.surfaces) / max(len(surfaces), 1)
    return Estimate(ticks * scale / cost.file.hertz, 0.0 if every == 1 else FLOOD_ERROR)


def _every(batch: Batch, many: int) -> Batch:
    return batch.select(np.arange(0, len(batch), many))


def _band(work: CellWork, seconds: float) -> tuple[float, float]:
    """Seconds by low and by high costs, in proportion to the most work of a cell."""
    most = work.busy.sum(axis=1).max(axis=0)
    low, high = (seconds * float(most[k] / max(most[MIDDLE], 1)) for k in (0, -1))
    return low, high


def _balance(work: CellWork) -> float:
    busy = work.busy[:, :, MIDDLE].sum(axis=1)
    return float(busy.max() / max(busy.mean(), 1e-9))
