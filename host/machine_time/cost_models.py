"""Reads cost models, which price each piece of a node's work in ticks: files of TOML, some built in (`emulator/costs`).

docs/costs.md says what the keys mean and where the numbers come from. Each cost is a list of three whole numbers, low,
middle and high, or one number that stands for all three.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, Strict, ValidationError
from pydantic_core import ErrorDetails

from raygrid.host.files.input_guard import note
from raygrid.host.files.regular_file import read_regular
from raygrid.host.files.toml_reader import read_toml
from raygrid.host.scene.builder import shown
from raygrid.host.scene.formats.toml_errors import Key, located, shown_key
from raygrid.host.text.misuse import CostMisuse
from raygrid.node import protocol
from raygrid.node.errors import CostError
from raygrid.node.geometry import HOST, Kind

LEVELS = ("low", "middle", "high")
MOST_TICKS = 10**12  # so that no sum of ticks leaves 64 bits
LARGEST_FILE = 1 << 20  # bytes


def _whole(value: object) -> object:
    """5e6 is a whole number, however TOML sees it."""
    return int(value) if isinstance(value, float) and value.is_integer() else value


def _tripled(value: object) -> object:
    """One number stands for low, middle and high."""
    return [value] * 3 if isinstance(_whole(value), int) and not isinstance(value, bool) else value


def _ascending(value: tuple[int, int, int]) -> tuple[int, int, int]:
    if not value[0] <= value[1] <= value[2]:
        raise ValueError("Input should be low, middle and high in this order")
    return value


Whole = Annotated[int, Strict(), BeforeValidator(_whole)]
Ticks = Annotated[Whole, Field(ge=0, le=MOST_TICKS)]
SomeTicks = Annotated[Whole, Field(ge=1, le=MOST_TICKS)]
Cost = Annotated[tuple[Ticks, Ticks, Ticks], BeforeValidator(_tripled), AfterValidator(_ascending)]
SomeCost = Annotated[tuple[SomeTicks, SomeTicks, SomeTicks], BeforeValidator(_tripled), AfterValidator(_ascending)]


class CostTable(BaseModel):
    """A table of a cost model: no keys but its own."""

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)


class LinkTable(CostTable):
    """[link]"""

    bytes_per_second: Annotated[Whole, Field(ge=1, le=10**15)]
    latency: SomeCost
    moves: Literal["processor", "link"]


class TestTable(CostTable):
    """[ticks.test]"""

    triangle: Cost
    smooth: Cost
    polygon: Cost
    sphere: Cost
    cylinder: Cost
    cone: Cost


class TicksTable(CostTable):
    """[ticks]"""

    packet: SomeCost
    walk: Cost
    box: Cost
    hit: Cost
    shadow: Cost
    ray: Cost
    return_: Cost = Field(alias="return")
    home: Cost
    primary: Cost
    keep: Cost
    pixel: Cost
    hand_on: Cost
    description: Cost
    test: TestTable


class CostFile(CostTable):
    """The whole file."""

    about: Annotated[str, Strict(), Field(min_length=1)]
    hertz: Annotated[Whole, Field(ge=1, le=10**15)]
    search: Literal["list", "tree"]
    link: LinkTable
    ticks: TicksTable


_TABLES: dict[Key, type[CostTable]] = {
    (): CostFile,
    ("link",): LinkTable,
    ("ticks",): TicksTable,
    ("ticks", "test"): TestTable,
}


@dataclass(frozen=True)
class CostModel:
    """A checked cost model. `name`: as it was asked for."""

    name: str
    file: CostFile

    def tests(self, level: str) -> NDArray[np.int64]:
        """Ticks of a test of each kind of surface, int64 (6,)."""
        k = LEVELS.index(level)
        return np.array([getattr(self.file.ticks.test, kind.name.lower())[k] for kind in Kind], np.int64)

    def prices(self, level: str, search: str) -> protocol.Prices:
        """What `node.timed.service_clock` reads. A list's tests are not in it: they depend on what a node holds."""
        k, ticks, link = LEVELS.index(level), self.file.ticks, self.file.link
        counts = np.zeros(protocol.COUNTS, np.int64)
        for count, cost in (
            (protocol.WALKS, ticks.walk),
            (protocol.HITS, ticks.hit),
            (protocol.HOMES, ticks.home),
            (protocol.BORN + protocol.SHADOW, ticks.shadow),
            (protocol.BORN + protocol.REFLECTED, ticks.ray),
            (protocol.BORN + protocol.REFRACTED, ticks.ray),
            (protocol.BORN + protocol.RETURN, ticks.return_),
            (protocol.BORN + protocol.PRIMARY, ticks.primary),
            (protocol.BORN + protocol.PIXEL, ticks.pixel),
            (protocol.DIED + protocol.RETURN, ticks.keep),
        ):
            counts[count] = cost[k]
        counts[protocol.SENT : protocol.SENT + HOST + 1] = ticks.hand_on[k]
        if search == "tree":
            counts[protocol.BOXES] = ticks.box[k]
            counts[protocol.TESTS : protocol.TESTS + len(Kind)] = self.tests(level)
        transmit = -(-protocol.SIZE * self.file.hertz // link.bytes_per_second)
        return protocol.Prices(counts, ticks.packet[k], transmit, link.latency[k], int(link.moves == "processor"))

    def list_ticks(self, level: str, search: str, held: NDArray[np.int64]) -> NDArray[np.int64]:
        """Ticks of testing all that each node holds, int64 (n,); held int64 (n, 6). 0 for a tree."""
        return np.asarray(held @ (self.tests(level) * (search == "list")), np.int64)

    def seconds(self, ticks: int) -> float:
        """Machine seconds that so many ticks are."""
        return ticks / self.file.hertz


def built_in() -> list[str]:
    """Names of the built-in models."""
    folder = resources.files("raygrid.emulator") / "costs"
    return sorted(entry.name.removesuffix(".toml") for entry in folder.iterdir() if entry.name.endswith(".toml"))


def load_cost_model(name: str) -> CostModel:
    """A built-in model by its name, or one from a file whose name ends in .toml. Raises CostError."""
    if not name.endswith(".toml"):
        if name not in built_in():
            raise CostMisuse(
                f"a cost model came as {shown(name)}, wanted one of {', '.join(built_in())} or a .toml file"
            )
        data = (resources.files("raygrid.emulator") / "costs" / f"{name}.toml").read_bytes()
        return CostModel(name, _checked(Path(f"{name}.toml"), data))
    path = Path(name)
    note(path, "the same file as the cost model")
    try:
        data = read_regular(path, LARGEST_FILE)
    except OSError as error:
        raise CostError(f"{path}: the cost model cannot be read ({error.strerror or error})") from None
    return CostModel(name, _checked(path, data))


def _checked(path: Path, data: bytes) -> CostFile:
    try:
        text, tables = read_toml(data)
    except ValueError as error:
        raise CostError(f"{path}: the TOML cannot be read ({error})") from None
    try:
        return CostFile.model_validate(tables)
    except ValidationError as error:
        faults = error.errors(include_url=False)
    unknown = [fault for fault in faults if fault["type"] == "extra_forbidden"]
    raise CostError(_sentence(path, text, (unknown or faults)[0]))


def _sentence(path: Path, text: str, fault: ErrorDetails) -> str:
    """A fault that pydantic found, as one sentence."""
    key: Key = tuple(fault["loc"])
    kind = fault["type"]
    if kind == "missing" and isinstance(key[-1], int):
        key, kind = key[:-1], "too_short"
    where, name = located(path, text, key), shown_key(key)
    if kind == "missing":
        return f"{where}: {name} is missing"
    if kind == "extra_forbidden":
        names = _keys(_TABLES.get(key[:-1], CostFile))
        return f"{where}: the key {name} is unknown, wanted one of: {', '.join(names)}"
    if kind in ("tuple_type", "too_short", "too_long"):
        return f"{where}: {name} is {shown(fault['input'])}, wanted a whole number or three: low, middle, high"
    wanted = fault["msg"].removeprefix("Value error, ").removeprefix("Input should ").removeprefix("be ")
    return f"{where}: {name} is {shown(fault['input'])}, wanted {wanted}"


def _keys(model: type[CostTable]) -> Sequence[str]:
    return [str(field.alias or name) for name, field in model.model_fields.items()]
