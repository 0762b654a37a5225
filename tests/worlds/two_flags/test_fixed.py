"""What stays fixed stays, what is drawn differs, and neither changes the noise of an episode's seed."""

import math

import gymnasium as gym
import numpy as np
import pytest

import dpmacro.worlds  # noqa: F401
from dpmacro.worlds.two_flags.env import FORWARD

SEEDS = (0, 1, 2, 3, None)


def seen(seeds=SEEDS, **options):
    """Of every seed: start, layout, and the picture from one and the same place."""
    env = gym.make("TwoFlags-v0", render_size=(64, 48), **options)
    starts, layouts, pictures = [], [], []
    for seed in seeds:
        _, info = env.reset(seed=seed)
        starts.append((*info["position"].tolist(), info["heading"]))
        layouts.append(env.unwrapped.layout)
        env.unwrapped.scene.put_avatar(np.zeros(2), 0.5)
        pictures.append(env.unwrapped.view(64, 48).tobytes())
    env.close()
    return starts, layouts, pictures


def test_textures_are_those_of_the_layouts_seed():
    starts, layouts, pictures = seen(flags="fixed", textures="fixed")
    assert len(set(pictures)) == len(set(layouts)) == 1 and len(set(starts)) == len(SEEDS)
    again, other = (seen((7,), flags="fixed", textures="fixed", layout_seed=k)[2] for k in (0, 1))
    assert again == pictures[:1] and other != pictures[:1]


def test_textures_may_stay_where_flags_do_not():
    env = gym.make("TwoFlags-v0", textures="fixed", render_size=(64, 48))
    surfaces = [env.unwrapped._surfaces() for seed in (1, 2) if env.reset(seed=seed)]
    assert surfaces[0] == surfaces[1] and len(set(seen(textures="fixed")[1])) == len(SEEDS)
    env.close()


@pytest.mark.parametrize("spread", [0.0, 0.2, math.pi])
def test_the_start_is_one_place_and_its_heading_spreads(spread):
    seeds = (*range(30), None)
    starts, _, pictures = seen(seeds, flags="fixed", start="fixed", start_spread=spread)
    ((x, y, _),) = seen((8,), flags="fixed", start="fixed", start_spread=0)[0]
    assert {start[:2] for start in starts} == {(x, y)} and len(set(pictures)) > 1
    middle = seen((0,), flags="fixed", start="fixed", start_spread=0)[0][0][-1]
    off = np.array([(heading - middle + math.pi) % (2 * math.pi) - math.pi for *_, heading in starts])
    assert np.abs(off).max() <= spread + 1e-12
    assert (np.ptp(off) > spread) == (spread > 0) and (len(set(off.round(12))) == 1) == (spread == 0)
    assert seen((8,), flags="fixed", start="fixed", layout_seed=1)[0][0][:2] != (x, y)


def test_a_seed_has_the_same_noise_whatever_is_fixed():
    def turns(**options):
        env = gym.make("TwoFlags-v0", render_size=(64, 48), flags="fixed", **options)
        _, info = env.reset(seed=5)
        headings = [info["heading"], *(env.step(FORWARD)[-1]["heading"] for _ in range(5))]
        env.close()
        return np.diff(np.unwrap(headings))

    for fixed in ({"textures": "fixed"}, {"start": "fixed"}, {"textures": "fixed", "start": "fixed"}):
        np.testing.assert_allclose(turns(**fixed), turns(), atol=1e-12)


def test_episodes_repeat_where_all_is_fixed_but_the_heading():
    options = {"flags": "fixed", "textures": "fixed", "start": "fixed"}
    one, other = (seen((3, 4), **options) for _ in range(2))
    assert one == other and one[0][0] != one[0][1]
