"""How many rays of each kind are born for the SPD scenes, against the counts of other renderers.

The table is that of the shared scenes' README: 512x512, one ray through each pixel's middle, depth 5; counted by
POV-Ray 3.7 and confirmed by SPD's own figures. A ray that is totally reflected counts as reflected there and here.
"""

import pytest
from support.render import EIGHT, ONE, rendered, shared

from raygrid.host.scene.load import load_scene

TOLERANCE = 0.005

COUNTS = {  # scene: reflected, refracted, shadow
    "balls_2": (112_997, 0, 870_887),
    "balls_3": (147_781, 0, 914_085),
    "gears_1": (231_542, 304_687, 2_113_585),
    "gears_2": (120_528, 156_229, 1_754_447),
    "mount_4": (354_766, 354_766, 409_926),
    "mount_5": (354_766, 354_766, 410_162),
    "mount_6": (354_766, 354_766, 412_834),
    "rings_2": (116_863, 0, 877_583),
    "rings_3": (178_727, 0, 939_831),
    "rings_4": (229_341, 0, 992_845),
    "teapot_3": (230_270, 0, 416_656),
    "teapot_6": (225_829, 0, 408_733),
    "teapot_12": (225_322, 0, 407_631),
    "tetra_4": (0, 0, 54_623),
    "tetra_5": (0, 0, 49_988),
    "tetra_6": (0, 0, 46_106),
}
QUICK = ("balls_2", "gears_1", "mount_4", "rings_2", "teapot_3", "tetra_4")
KINDS = ("reflected", "refracted", "shadow")


def born(name, shape):
    """Packets born by kind."""
    picture = rendered(load_scene(shared("spd", f"{name}.nff")), shape, size=(512, 512))
    total = picture.stats["total"]
    assert total["born"] == total["died"]
    return total["born"]


@pytest.mark.parametrize(
    "name", [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in COUNTS]
)
def test_as_many_rays_are_born_as_other_renderers_count(name):
    counted = born(name, ONE)
    for kind, expected in zip(KINDS, COUNTS[name], strict=True):
        assert counted[kind] == pytest.approx(expected, rel=TOLERANCE), kind


@pytest.mark.parametrize(
    "name", [name if name == "gears_1" else pytest.param(name, marks=pytest.mark.slow) for name in QUICK]
)
def test_eight_processors_bear_the_same_rays_as_one(name):
    assert born(name, EIGHT) == born(name, ONE)
