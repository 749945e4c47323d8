"""Values between keys."""

import numpy as np
import pytest

from raygrid.host.scene.animation.keyframes import make_keyframes
from raygrid.node.errors import SceneError


def test_linear_goes_straight_and_stays_beyond_the_keys():
    track = make_keyframes([1, 5, 6], [[0, 10], [4, 10], [0, 0]])
    assert [track.at(f).tolist() for f in (-3, 1, 2, 5, 5.5, 6, 99)] == [
        [0, 10],
        [0, 10],
        [1, 10],
        [4, 10],
        [2, 5],
        [0, 0],
        [0, 0],
    ]


def test_step_keeps_the_last_key():
    track = make_keyframes([1, 5], [1, 2], "step")
    assert [float(track.at(f)[0]) for f in (1, 4.999, 5)] == [1, 1, 2]


def test_smooth_meets_its_keys_never_goes_beyond_them_and_has_no_corners():
    rng = np.random.default_rng(3)
    frames, values = np.cumsum(rng.uniform(0.5, 9, 12)), rng.normal(size=(12, 3))
    track = make_keyframes(frames, values, "smooth")
    for frame, value in zip(frames, values, strict=True):
        assert np.allclose(track.at(frame), value, atol=1e-12)
    for k in range(11):
        between = np.array([track.at(f) for f in np.linspace(frames[k], frames[k + 1], 50)])
        low, high = np.minimum(values[k], values[k + 1]), np.maximum(values[k], values[k + 1])
        assert (between >= low - 1e-12).all()
        assert (between <= high + 1e-12).all()
    eps = 1e-6
    for frame in frames:
        before, after = track.at(frame) - track.at(frame - eps), track.at(frame + eps) - track.at(frame)
        assert np.allclose(before, after, atol=1e-9)
    assert np.allclose((track.at(frames[0] + eps) - values[0]) / eps, 0.0, atol=1e-4)  # gently off, gently in


def test_smooth_goes_evenly_where_keys_are_even():
    track = make_keyframes([0, 10, 20, 30], [0.0, 1.0, 2.0, 3.0], "smooth")
    assert float(track.at(15)[0]) == pytest.approx(1.5, abs=1e-12)
    assert float(track.at(12)[0]) == pytest.approx(1.2, abs=1e-12)


@pytest.mark.parametrize(
    ("frames", "values", "way", "said"),
    [
        ([1, 3, 3], [0, 1, 2], "linear", "key 2 is at 3, after one at 3: wanted keys in ascending order"),
        ([1, 3, 2], [0, 1, 2], "linear", "key 2 is at 2, after one at 3"),
        ([1, 2], [0, np.nan], "linear", "not finite"),
        ([1, np.inf], [0, 1], "linear", "not finite"),
        ([], [], "linear", "0 keys"),
        ([1], [1], "wild", "'wild'"),
    ],
)
def test_wrong_keys(frames, values, way, said):
    with pytest.raises(SceneError, match=said):
        make_keyframes(frames, np.array(values, float), way)
