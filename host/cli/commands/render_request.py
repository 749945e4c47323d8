"""Holds what `raygrid render` was asked for, and launches the array for it, for one frame or several."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from raygrid.emulator.processes import Array
from raygrid.host.cli.progress import ProgressReporter
from raygrid.host.files.input_guard import note
from raygrid.host.image.frames import FrameNames, Turntable, wants_shot
from raygrid.host.render.given_settings import parted

if TYPE_CHECKING:
    from raygrid.host.render.given_settings import GivenSettings
    from raygrid.host.render.job import Settings
    from raygrid.host.scene.view import GivenView
    from raygrid.node.links import FaultPlan


class RenderRequest(NamedTuple):
    """What the command line asks for.

    scene     path of the scene
    shape     processors on each axis
    outputs   paths of pictures and sums
    stats     path of the statistics, or None
    profile   whether to say where the nodes' time went
    settings  of the frame and of the view
    cost      a cost model for machine time, or None: no machine time is kept
    search    list, tree, or None: as the cost model says
    frames    first and last frame of a shot, or None
    turntable make the scene a shot of one turn, or None
    resume    skip frames of a shot whose files are there
    program   path of a program that the nodes are to run, or None
    allow_programs  whether the array takes programs
    layers    that pictures are to have besides
    probe_record, chrome_trace   paths of what probes tell `probe_rate` times a second, or None
    """

    scene: str
    shape: tuple[int, int, int]
    outputs: tuple[str, ...]
    batch: int
    budget: int
    transfer: str
    stats: str | None
    patience: float
    attempts: int
    fault: FaultPlan | None
    quiet: bool
    profile: bool
    settings: GivenSettings
    cost: str | None = None
    search: str | None = None
    frames: tuple[int, int] | None = None
    turntable: Turntable | None = None
    program: str | None = None
    allow_programs: bool = False
    probe_record: str | None = None
    chrome_trace: str | None = None
    probe_rate: float = 10.0
    resume: bool = False
    layers: tuple[str, ...] = ()

    @property
    def of_shot(self) -> bool:
        """Whether frames of a shot are asked for, and not a picture of the scene as it stands. Raises OutputError."""
        return wants_shot(self.frames, self.turntable is not None, self.outputs, self.stats)

    @property
    def names(self) -> FrameNames:
        """The names of all files that frames have. Raises OutputError for those that cannot be."""
        shot = self.of_shot
        return FrameNames.checked(self.outputs, self.stats, self.frames if shot else None, shot, self.layers)

    @property
    def probed(self) -> list[str]:
        """The files of what probes tell."""
        return [path for path in (self.probe_record, self.chrome_trace) if path is not None]

    @property
    def view(self) -> GivenView:
        """From where and in which light the scene is to be seen."""
        return parted(self.settings)[1]

    def launching(self, reporter: ProgressReporter) -> Array:
        """The array that is asked for, not yet begun."""
        first = self.shape, self.batch, self.patience, reporter.warming, self.fault
        return Array(*first, programs=self.allow_programs, profile=self.profile, timed=self.cost is not None)

    def read_settings(self) -> Settings:
        """The settings with the program that is asked for. Raises SceneError."""
        from raygrid.host.render.job import Settings
        from raygrid.host.render.program_file import read_program

        program = None if self.program is None else read_program(self.program)
        return Settings(**parted(self.settings)[0], program=program, layers=self.layers)

    def note_read(self) -> None:
        """Note what is named to be read, before it is: no output may be one of them."""
        note(self.scene, "the same file as the scene")
        if self.program is not None:
            note(self.program, "the same file as the program")
