"""What worlds show, found by LeRobot's keys; what is missing, of another shape or not finite."""

import numpy as np
import pytest
from gymnasium.spaces import Box, Dict, Discrete, Text

from dpmacro.worlds.base import WorldError
from dpmacro.worlds.observations import ObservationMap

STATE, IMAGE = "observation.state", "observation.image"
ARM = Box(-np.inf, np.inf, (3,), np.float64)
PICTURE = Box(0, 255, (4, 6, 3), np.uint8)
LEROBOT = Dict({"pixels": PICTURE, "agent_pos": ARM, "environment_state": Box(0, 1, (2,), np.float32)})


def fit(space, wanted=None, names=None):
    return ObservationMap.fit("Room-v0", space, wanted, names)


@pytest.mark.parametrize(
    ("space", "places"),
    [
        (ARM, {STATE: ()}),
        (PICTURE, {IMAGE: ()}),
        (
            LEROBOT,
            {
                IMAGE: ("pixels",),
                STATE: ("agent_pos",),
                "observation.environment_state": ("environment_state",),
            },
        ),
        (
            Dict({"pixels": Dict({"top": PICTURE, "wrist": PICTURE}), "mission": Text(9)}),
            {"observation.images.top": ("pixels", "top"), "observation.images.wrist": ("pixels", "wrist")},
        ),
        (Dict({STATE: ARM, "force": ARM}), {STATE: (STATE,), "observation.force": ("force",)}),
    ],
)
def test_everything_is_found_by_lerobots_keys(space, places):
    found = fit(space)
    assert found.places == places
    assert fit(space, found.shapes).places == places
    raw = space.sample()
    shown = found.of(raw, "at step 1")
    for key, place in places.items():
        value = raw
        for part in place:
            value = value[part]
        assert np.array_equal(shown[key], value.astype(shown[key].dtype))
        assert shown[key].dtype == (np.uint8 if value.ndim == 3 else np.float32)


@pytest.mark.parametrize(
    ("space", "wanted", "place"),
    [
        (
            LEROBOT,
            {"observation.images.avatar": (4, 6, 3)},
            ("pixels",),
        ),  # the only picture, whatever its name
        (Dict({"arm": ARM, "image": PICTURE}), {STATE: (3,)}, ("arm",)),
        (Dict({"pose": Box(0, 1, (3, 4), np.float32)}), {STATE: (12,)}, ("pose",)),
        (Box(0, 1, (), np.float32), {STATE: (1,)}, ()),
    ],
)
def test_a_single_picture_or_vector_is_what_is_wanted(space, wanted, place):
    found = fit(space, wanted)
    assert list(found.places.values()) == [place]
    [(key, shape)] = wanted.items()
    assert found.of(space.sample(), "")[key].shape == shape


def test_names_come_first():
    space = Dict({"robot": Dict({"arm": ARM, "hand": ARM}), "agent_pos": ARM})
    assert fit(space, {STATE: (3,)}).places == {STATE: ("agent_pos",)}
    named = fit(space, {STATE: (3,)}, {STATE: "robot.hand"})
    assert named.places == {STATE: ("robot", "hand")}
    assert named.told() == ["observation.state from robot.hand"]
    assert fit(space, None, {"observation.hand": "robot.hand"}).shapes == {"observation.hand": (3,)}


@pytest.mark.parametrize(
    ("space", "wanted", "names", "message"),
    [
        (Discrete(16), {STATE: (3,)}, None, "the world Room-v0 shows a Discrete, and a policy sees a Box"),
        (
            PICTURE,
            {STATE: (3,)},
            None,
            "shows no observation.state, which the policy sees: it shows an array",
        ),
        (
            Dict({"arm": ARM, "leg": ARM}),
            {STATE: (3,)},
            None,
            r"it shows arm, leg; say which .* --world.observations='\[observation.state=<name>\]'",
        ),
        (Dict({"mission": Text(9)}), {STATE: (3,)}, None, "it shows nothing that is a Box"),
        (
            ARM,
            {STATE: (39,)},
            None,
            r"shows an array of shape \(3,\), and the policy was .* of shape \(39,\)",
        ),
        (
            LEROBOT,
            {IMAGE: (48, 64, 3)},
            None,
            r"pixels of shape \(4, 6, 3\), and the policy was trained with",
        ),
        (
            Dict({"pixels": Box(0, 1, (4, 6, 3))}),
            {IMAGE: (4, 6, 3)},
            None,
            "pictures of type float32 as pixels",
        ),
        (
            LEROBOT,
            {STATE: (3,)},
            {STATE: "leg"},
            "has observation.state=leg, and the world Room-v0 shows agent_pos, env",
        ),
        (LEROBOT, {STATE: (3,)}, {IMAGE: "pixels"}, "names observation.image, which the policy does not see"),
        (LEROBOT, {STATE: (3,), "task_index": ()}, None, "shows no task_index"),
    ],
)
def test_what_does_not_fit_is_refused_in_one_line(space, wanted, names, message):
    with pytest.raises(WorldError, match=message) as refused:
        fit(space, wanted, names)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"agent_pos": np.array([0, np.nan, 0])}, "shows agent_pos with nan as number 1 at step 7"),
        ({"agent_pos": np.array([0, 0, np.inf])}, "agent_pos with inf as number 2"),
        ({"agent_pos": np.zeros(4)}, r"agent_pos of shape \(4,\) and type float64 at step 7, not \(3,\)"),
        ({"agent_pos": np.array(["a", "b", "c"])}, "and type <U1 at step 7"),
        ({"pixels": np.zeros((4, 6, 3))}, r"pixels of shape \(4, 6, 3\) and type float64"),
        ({"pixels": np.zeros((6, 4, 3), np.uint8)}, r"not \(4, 6, 3\) as its observation_space says"),
        ({"agent_pos": None}, "agent_pos of shape"),
    ],
)
def test_what_a_world_shows_is_checked_in_every_step(change, message):
    found, raw = fit(LEROBOT), {**LEROBOT.sample(), **change}
    with pytest.raises(WorldError, match=message):
        found.of(raw, "at step 7")


@pytest.mark.parametrize("raw", [{}, None, {"pixels": np.zeros((4, 6, 3), np.uint8)}, np.zeros(3)])
def test_what_a_world_says_it_shows_has_to_be_there(raw):
    with pytest.raises(WorldError, match=r"the world Room-v0 shows no agent_pos at step 7: its"):
        fit(LEROBOT).of(raw, "at step 7")
