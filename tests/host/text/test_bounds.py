"""What users may ask for is what the machine can do, though the numbers stand apart."""

from raygrid.host.cli.types import COST_MODELS
from raygrid.host.machine_time import cost_models
from raygrid.host.render import machine_job as job
from raygrid.host.scene import builder, cameras, pose, view
from raygrid.host.scene.formats import nff
from raygrid.host.text import bounds
from raygrid.node.protocol import commands, packets
from raygrid.node.runtime import probe


def test_the_bounds_are_those_of_whoever_keeps_them():
    assert bounds.MAX_FRAMES == pose.MAX_FRAMES
    assert bounds.MAX_SIDE == commands.MAX_SIDE
    assert bounds.MAX_PIXELS == job.MAX_PIXELS
    assert bounds.MAX_DEPTH == packets.MAX_DEPTH
    assert bounds.MAX_SAMPLES == packets.MAX_SAMPLES
    assert bounds.MAX_RATE == probe.FASTEST


def test_what_a_view_may_say_is_what_cameras_and_scenes_take():
    assert view.WIDEST == cameras.WIDEST
    assert tuple(cameras.STANDS) == view.FITS
    assert view.MAX_NUMBER == builder.MAX_COORDINATE == nff.MAX_VALUE


def test_the_shell_completes_the_cost_models_that_there_are():
    assert sorted(COST_MODELS) == sorted(cost_models.built_in())
