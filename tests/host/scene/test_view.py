"""What may be asked of a view, and one sentence for what may not."""

import numpy as np
import pytest

from raygrid.host.scene.view import FITS, VIEW, View, view_of
from raygrid.host.text.misuse import SceneMisuse

NAN = float("nan")


def test_what_is_given_is_kept_as_plain_numbers():
    given = {"eye": np.array([0, 2, 8]), "at": [0, 1, 0], "fov": np.float32(30), "lights": np.ones((2, 6)), "crease": 0}
    view = view_of(given)
    assert view == View((0.0, 2.0, 8.0), (0.0, 1.0, 0.0), None, 30.0, lights=((1.0,) * 6,) * 2, crease=0.0)
    assert view_of(view.given()) == view
    assert hash(view) == hash(view_of(view.given()))


def test_nothing_given_is_no_view():
    assert view_of({}) == view_of(dict.fromkeys(VIEW)) == View()
    assert not View().moves_camera
    assert View().given() == {}


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"eye": (0, NAN, 0)}, r"eye came as \(0, nan, 0\), wanted three finite numbers"),
        ({"eye": (0, 1e31, 0)}, "eye came as .*, wanted three finite numbers of at most 1e30"),
        ({"at": (0, 0)}, r"at came as \(0, 0\), wanted three"),
        ({"at": "0,0,0"}, "at came as '0,0,0', wanted three"),
        ({"up": (0, 0, 0)}, r"up came as \(0, 0, 0\), wanted a direction"),
        ({"fov": 0}, "fov came as 0, wanted an angle above 0 and at most 179.99"),
        ({"fov": 180}, "fov came as 180, wanted an angle"),
        ({"fov": NAN}, "fov came as nan, wanted an angle"),
        ({"fov": True}, "fov came as True, wanted an angle"),
        ({"fov": np.array([1.0, 2.0])}, r"fov came as array\(\[1., 2.\]\), wanted an angle"),
        ({"fov": 10**5000}, "fov came as a whole number of 16610 bits, wanted an angle"),
        ({"eye": (0, 10**5000, 0)}, "eye came as a tuple, wanted three"),
        ({"eye": [np.zeros(2), 0, 0]}, r"eye came as \[array\(\[0., 0.\]\), 0, 0\], wanted three"),
        ({"eye": np.ones((2, 3))}, r"eye came as array\(\[\[1., 1., 1.\], \[1., 1., 1.\]\]\), wanted three"),
        ({"lights": [[[1, 2], 2, 3]]}, r"a light came as \[\[1, 2\], 2, 3\], wanted a position"),
        ({"camera": ""}, "camera came as '', wanted the name of a camera"),
        ({"camera": 1.5}, "camera came as 1.5, wanted the name of a camera"),
        ({"fit": "behind"}, f"fit came as 'behind', wanted one of: {', '.join(FITS)}"),
        ({"fit": ["iso"]}, "fit came as .*, wanted one of"),
        ({"lights": 5}, "lights came as 5, wanted a list of at most 256"),
        ({"lights": [(1, 2)]}, r"a light came as \(1, 2\), wanted a position x, y, z"),
        ({"lights": [(1, 2, 3, 1, -1, 1)]}, "a light came as .*, no colour below 0"),
        ({"lights": [(0, 0, 0)] * 257}, "lights came as .*, wanted a list of at most 256"),
        ({"background": (0, -1, 0)}, "background came as .*, wanted three finite numbers of 0 or more"),
        ({"crease": -1}, "crease came as -1, wanted an angle from 0 to 180"),
        ({"fit": "iso", "eye": (1, 2, 3)}, "--fit .* and --from .* came, wanted one of them"),
        ({"fit": "iso", "at": (1, 2, 3)}, "--fit .* and --at .* came, wanted one of them"),
        ({"fit": "iso", "camera": 1}, "--camera .* and --fit .* came, wanted one of them"),
        ({"camera": "a", "eye": (1, 2, 3)}, "--camera .* and --from .* came, wanted one of them"),
    ],
)
def test_anything_else_is_one_sentence(given, words):
    with pytest.raises(SceneMisuse, match=words):
        view_of(given)
