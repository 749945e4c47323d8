"""What users may ask for is what the machine can do, though the numbers stand apart."""

from raygrid.host.render import machine_job as job
from raygrid.host.scene import pose
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
