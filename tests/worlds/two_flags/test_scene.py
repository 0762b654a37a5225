"""Collision, visibility and pictures of the scene."""

import math

import cv2
import numpy as np
import pytest

from dpmacro.worlds.two_flags.scene import AVATAR_RADIUS, FLAG_RADIUS, Layout, Scene

REACH = AVATAR_RADIUS + FLAG_RADIUS
AHEAD = Layout(side=12.0, blue=(2.0, 0.0), red=(-4.0, 4.0))


OWN_CHANNELS = ([2], [0], [1], [0, 1], [0, 2], [1, 2])  # of blue, red, green, yellow, magenta, cyan


@pytest.fixture(scope="module")
def scene():
    scene = Scene()
    yield scene
    scene.close()


@pytest.fixture(scope="module")
def six():
    scene = Scene(count=6)
    yield scene
    scene.close()


def stand(scene, layout, x, y, heading, surfaces=(0, 1, 2, 3, 4)):
    scene.arrange(layout, surfaces)
    scene.put_avatar(np.array([x, y]), heading)


def coloured(picture, channel):
    """How many pixels are clearly of one channel's hue."""
    others = np.delete(picture.astype(float), channel, axis=-1).max(axis=-1)
    return int((picture[..., channel] > np.maximum(1.9 * others, 60)).sum())


@pytest.mark.parametrize("flag, channel", [("blue", 2), ("red", 0)])
def test_a_flag_is_recognisable_from_every_side_at_15_metres(scene, flag, channel):
    for texture in range(scene.texture_count):
        for direction in range(8):
            angle = direction * math.pi / 4
            x, y = 7.5 * math.cos(angle), 7.5 * math.sin(angle)
            away = (-8.5 * math.sin(angle + 0.3), 8.5 * math.cos(angle + 0.3))
            flags = {"blue": away, "red": away, flag: (x, y)}
            stand(scene, Layout(20.0, **flags), -x, -y, angle, [texture] * 5)
            small = cv2.resize(scene.view(128, 96), (64, 48), interpolation=cv2.INTER_AREA)
            assert coloured(small, channel) >= 3, (texture, direction)
            assert coloured(small, 2 - channel) == 0, (texture, direction)


@pytest.mark.parametrize("place", range(6))
def test_each_of_six_flags_is_told_from_the_others_at_15_metres(six, place):
    behind = tuple((-8.0, 1.5 * (other - 2.5)) for other in range(5))
    flags = (*behind[:place], (7.5, 0.0), *behind[place:])
    layout = Layout(20.0, flags[0], flags[1], flags[2:])
    for texture in range(six.texture_count):
        stand(six, layout, -7.0, 0.0, 0.0, [texture] * 5)
        small = cv2.resize(six.view(128, 96), (64, 48), interpolation=cv2.INTER_AREA).astype(float)
        for other, channels in enumerate(OWN_CHANNELS):
            least = small[..., channels].min(-1)
            most = small[..., [c for c in range(3) if c not in channels]].max(-1)
            assert (((least > 2.1 * most) & (least > 60)).sum() >= 3) == (other == place), (texture, other)


def test_nothing_in_view_is_black(scene):
    # These poses put corners of meshes exactly beside the eye, where TinyRenderer alone fails.
    for heading in np.arange(8) * math.pi / 4:
        stand(scene, AHEAD, 0.0, 0.0, float(heading), [6, 11, 16, 21, 26])
        assert scene.view(128, 96).max(axis=-1).min() > 20


def test_a_surface_looks_as_large_in_every_room(scene):
    # From 2 m, the wall ahead fills the same part of the picture whatever the room's size.
    pictures = []
    for side in (6.0, 19.0):
        stand(scene, Layout(side, (-side / 3, 1.0), (-side / 3, -1.0)), side / 2 - 2, 0.0, 0.0)
        pictures.append(scene.view(64, 48)[16:32, 24:40])
    assert np.array_equal(*pictures)


def test_walls_stop_the_avatar_dead(scene):
    stand(scene, AHEAD, 0.0, -4.0, -math.pi / 2 + 0.5)
    for _ in range(100):
        assert scene.forward(0.03) == ""
    stopped = scene.position
    assert -6 + AVATAR_RADIUS <= stopped[1] <= -6 + AVATAR_RADIUS + 0.03
    scene.forward(0.03)
    assert np.array_equal(scene.position, stopped)


def test_a_flag_met_head_on_stops_the_avatar(scene):
    stand(scene, AHEAD, 0.0, 0.0, 0.0)
    touches = [scene.forward(0.03) for _ in range(60)]
    assert touches[42] == "" and set(touches[43:]) == {"blue"}  # 43 steps of 3 cm leave a gap of 1 cm
    assert 2.0 - REACH - 0.03 <= scene.position[0] <= 2.0 - REACH


def test_an_avatar_glances_off_a_flag_met_aslant(scene):
    stand(scene, AHEAD, 0.0, 0.3, 0.0)
    for _ in range(150):
        scene.forward(0.03)
        assert math.dist(scene.position, AHEAD.blue) >= REACH - 1e-3
    assert scene.position[0] > 2.5


@pytest.mark.parametrize(
    "red, start, heading, sees_blue, sees_red",
    [
        ((4.0, 0.0), (0.0, 0.0), 0.0, True, False),  # blue hides red
        ((1.0, 0.0), (0.0, 0.0), 0.0, False, True),  # red hides blue
        ((4.0, 0.5), (0.0, 0.0), 0.0, True, True),  # side by side
        ((4.0, 0.5), (0.0, 0.0), math.radians(31), False, True),  # blue just left the field of view
        ((4.0, 0.5), (0.0, 0.0), math.pi, False, False),  # both behind
        ((4.0, 0.5), (2.0, 2.0), -math.pi / 2, True, False),  # red beside the field of view
    ],
)
def test_a_flag_is_visible_where_it_is_in_view_and_not_hidden(
    scene, red, start, heading, sees_blue, sees_red
):
    stand(scene, Layout(12.0, (2.0, 0.0), red), *start, heading)
    assert (scene.visible("blue"), scene.visible("red")) == (sees_blue, sees_red)


def test_bearing_is_left_positive(scene):
    stand(scene, AHEAD, 2.0, -2.0, 0.0)
    assert scene.bearing("blue") == pytest.approx(math.pi / 2)
    stand(scene, AHEAD, 2.0, -2.0, 3.0)
    assert scene.bearing("blue") == pytest.approx(math.pi / 2 - 3.0)


def test_distances_to_flags_and_walls(scene):
    stand(scene, AHEAD, 2.0, -3.0, math.pi / 2)
    assert scene.distance("blue") == pytest.approx(3.0)
    assert scene.distance("red") == pytest.approx(math.hypot(6, 7))
    for angle in (0.0, math.pi / 2, math.pi, -math.pi / 2, 0.4, 2.5):
        stand(scene, AHEAD, 2.0, -3.0, math.pi / 2)
        room = scene.to_wall(angle)
        scene.turn(angle)
        start = scene.position
        ahead = np.array([math.cos(scene.heading), math.sin(scene.heading)])
        scene.put_avatar(start + (room - 0.01) * ahead, scene.heading)
        assert np.abs(scene.position).max() == pytest.approx(6 - AVATAR_RADIUS, abs=0.011)
        scene.put_avatar(start + (room + 0.02) * ahead, scene.heading)
        assert not scene.free()


def test_two_scenes_do_not_interfere(scene):
    stand(scene, AHEAD, 0.0, 0.0, 0.0)
    before = scene.view(64, 48)
    other = Scene()
    stand(other, Layout(6.0, (1.5, 1.5), (-1.5, -1.5)), 0.0, 0.0, 1.0, (5, 6, 7, 8, 9))
    assert not np.array_equal(other.view(64, 48), before)
    assert np.array_equal(scene.view(64, 48), before)
    other.close()
    other.close()
    assert np.array_equal(scene.view(64, 48), before)


def test_a_layout_beyond_the_largest_room_is_refused():
    with pytest.raises(ValueError, match=r"side is 21.0: give up to 20 m"):
        Layout(21.0, (0.0, 0.0), (3.0, 0.0))
