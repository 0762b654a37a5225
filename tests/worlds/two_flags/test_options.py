"""Options of rooms with flags: what is left out, what is refused, and that the message names the world."""

import math
from dataclasses import asdict

import pytest

from dpmacro.worlds import OPTIONS, entry_of
from dpmacro.worlds.making import complete
from dpmacro.worlds.two_flags.options import FourFlagsConfig, SixFlagsConfig, TwoFlagsConfig

CONFIGS = {"TwoFlags-v0": TwoFlagsConfig, "FourFlags-v0": FourFlagsConfig, "SixFlags-v0": SixFlagsConfig}


@pytest.mark.parametrize("world", CONFIGS)
def test_an_id_has_options_of_its_own(world):
    config = CONFIGS[world]
    given = complete({"id": world, "teacher": "searching", "render_size": [64, 48], "success": 1.0})
    assert given.pop("id") == world and given.pop("success") == 1.0
    assert given == {**asdict(config()), "teacher": "searching", "render_size": (64, 48)}
    assert entry_of(OPTIONS, world)({}) == asdict(config())
    assert world == f"{config.world}-v0"
    assert config.max_steps == 1500 * config.count, "every flag has as much time"


def test_by_default_everything_is_drawn_and_the_papers_teacher_demonstrates():
    config = TwoFlagsConfig()
    assert (config.flags, config.textures, config.start, config.teacher) == (*["random"] * 3, "paper")
    assert config.ways == "any", "of two flags one may hide the other, as in the paper"
    assert FourFlagsConfig().ways == SixFlagsConfig().ways == "clear"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"textures": "some"}, "textures is 'some': choose 'random' or 'fixed'"),
        ({"flags": "fixed", "start": 0.0}, "start is 0.0: give a value like 'random'"),
        ({"flags": "fixed", "start": "here"}, "start is 'here': choose 'random' or 'fixed'"),
        ({"start": "fixed"}, "start is 'fixed': give flags='fixed' with it"),
        ({"start_spread": -0.1}, "start_spread is -0.1: give radians, 0 to pi"),
        ({"start_spread": 3.2}, "start_spread is 3.2: give radians, 0 to pi"),
        ({"start_spread": math.nan}, "start_spread is nan: give radians, 0 to pi"),
        ({"teacher": "best"}, "teacher is 'best': choose 'paper' or 'searching'"),
        ({"ways": "free"}, "ways is 'free': choose 'any' or 'clear'"),
        ({"layout_seed": True}, "layout_seed is True: give a value like 0"),
    ],
)
@pytest.mark.parametrize("world", CONFIGS)
def test_unfit_options_are_refused_in_one_line_that_names_the_world(world, options, message):
    with pytest.raises(ValueError, match=f"^{CONFIGS[world].world}: {message}$"):
        complete({"id": world, **options})


def test_the_number_of_flags_is_no_option():
    with pytest.raises(ValueError, match="FourFlags has no option 'count': choose among flags, layout_seed"):
        complete({"id": "FourFlags-v0", "count": 3})


def test_a_spread_may_be_a_whole_number():
    spread = complete({"id": "TwoFlags-v0", "start_spread": 1})["start_spread"]
    assert spread == 1.0 and isinstance(spread, float)
