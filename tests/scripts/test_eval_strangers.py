"""eval.py in worlds that strangers wrote: whatever goes wrong is one line, and runs before it stay."""

import functools
import inspect
import sys

import gymnasium as gym
import pytest
from reaching import constant_policy

from dpmacro import worlds
from tests.scripts.test_eval import call, script, seeds_in  # noqa: F401  a fixture

PACKAGE = '''
import sys

import gymnasium as gym
import numpy as np

from dpmacro import worlds
from dpmacro.worlds.base import GaveUp

print("welcome")


class Quiet(BaseException):
    """Neither an exception that scripts expect, nor one that can be read."""

    def __str__(self):
        raise RuntimeError("unreadable")


class Strange(gym.Env):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 20}
    observation_space = gym.spaces.Dict({"agent_pos": gym.spaces.Box(-9, 9, (3,), np.float64)})
    action_space = gym.spaces.Box(-1, 1, (3,), np.float32)

    def __init__(self, render_mode=None, wrong="nothing", bad_seed=2):
        self.render_mode, self.wrong, self.bad_seed = render_mode, wrong, bad_seed
        if wrong == "makes":
            sys.exit("no license")
        if wrong == "space":
            self.action_space = None

    def goes_wrong(self, what):
        return self.bad and self.wrong == what

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.bad, self.steps = seed >= self.bad_seed, 0
        if self.goes_wrong("reset"):
            raise KeyError("arm")
        if self.goes_wrong("reset_exit"):
            sys.exit(0)
        seen = {"agent_pos": np.zeros(3)}
        if self.goes_wrong("reset_alone"):
            return seen
        if self.goes_wrong("reset_info"):
            return seen, None
        return seen, {}

    def step(self, action):
        self.steps += 1
        seen, reward, over, cut, info = {"agent_pos": np.full(3, self.steps)}, 0.0, self.steps == 3, False, {}
        info["success"] = over
        if self.goes_wrong("quiet"):
            raise Quiet
        if self.goes_wrong("exit"):
            sys.exit()
        if self.goes_wrong("four"):
            return seen, reward, over, info
        if self.goes_wrong("list"):
            return [seen, reward, over, cut, info]
        changes = {
            "info": dict(info=None),
            "reward": dict(reward=None),
            "reward_nan": dict(reward=float("nan")),
            "reward_pair": dict(reward=np.zeros(2)),
            "over": dict(over=None),
            "over_pair": dict(over=np.zeros(2, bool)),
            "cut": dict(cut="no"),
            "success": dict(info={"success": "yes"}),
            "success_nan": dict(info={"success": float("nan")}),
            "success_ragged": dict(info={"success": [[1], [1, 2]]}),
            "nothing_seen": dict(seen=None),
            "shape": dict(seen={"agent_pos": np.zeros(4)}),
            "ragged": dict(seen={"agent_pos": [[1], [1, 2]]}),
            "words": dict(seen={"agent_pos": ["a", "b", "c"]}),
            "huge": dict(seen={"agent_pos": np.full(3, 1e300)}),
        }
        given = dict(seen=seen, reward=reward, over=over, cut=cut, info=info)
        if self.bad:
            given |= changes.get(self.wrong, {})
        return tuple(given.values())

    def render(self):
        if self.wrong == "no_picture":
            return None
        return np.zeros((24, 32, 3), float if self.wrong == "float_picture" else np.uint8)

    def close(self):
        if self.wrong == "close":
            raise OSError("the port is gone")


class Expert:
    """Gives up, raises, or does what the world does not take, by the world's option."""

    def reset(self, env):
        self.env, self.frame = env.unwrapped, 0

    def act(self, observation, info):
        self.frame += 1
        if self.frame == 2 and self.env.goes_wrong("gives_up"):
            raise GaveUp("nothing to do")
        if self.frame == 2 and self.env.goes_wrong("act"):
            raise ZeroDivisionError("by nothing")
        wrong = {"act_words": ["a"] * 3, "act_ragged": [[1], [1, 2]], "act_few": [0.0], "act_none": None}
        return wrong.get(self.env.wrong, np.zeros(3)) if self.env.bad else np.zeros(3)


gym.register("Strange-v0", Strange, disable_env_checker=True, order_enforce=False)
worlds.EXPERTS["Strange-v0"] = "strange:Expert"
worlds.RECORDINGS["Strange-v0"] = "strange:not_there"
'''
IMPORTS = {
    "raises": "raise RuntimeError('no\\ndisplay')",
    "exits": "import sys\nsys.exit(0)",
    "exits_loudly": "raise SystemExit('no license')",
    "is_spoiled": "def (",
    "registers_nothing": "",
}


@pytest.fixture(scope="module", autouse=True)
def sources_are_read_once():
    """The parser of options reads the source of their classes for every option, in every call of a script."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(inspect, "getsource", functools.cache(inspect.getsource))
        yield


@pytest.fixture
def strange(tmp_path, monkeypatch):
    """The folder of the packages, which processes find, too."""
    packages = tmp_path / "packages"
    packages.mkdir()
    (packages / "strange.py").write_text(PACKAGE)
    for name, text in IMPORTS.items():
        (packages / f"{name}.py").write_text(text)
    monkeypatch.syspath_prepend(packages)
    yield packages
    for name in ("strange", *IMPORTS):
        sys.modules.pop(name, None)
    gym.registry.pop("Strange-v0", None)
    for table in (worlds.EXPERTS, worlds.RECORDINGS):
        table.pop("Strange-v0", None)


@pytest.fixture
def policy(tmp_path):
    return constant_policy(tmp_path / "policy", world={"id": "Strange-v0", "import": "strange"})


@pytest.fixture
def evaluate(script, strange, tmp_path, monkeypatch):  # noqa: F811
    """Calls the script, which writes to the folder `out`."""
    return lambda *options: call(script, monkeypatch, *options, f"--output_dir={tmp_path / 'out'}")


@pytest.fixture
def refused(evaluate, capsys):
    """The same where it ends with exit status 2: the one line on stderr, beside progress bars."""

    def refused(*options):
        with pytest.raises(SystemExit) as exit_:
            evaluate(*options)
        told = capsys.readouterr().err.replace("\r", "\n")
        lines = [line for line in told.splitlines() if line.strip() and not line.startswith("Evaluating")]
        assert exit_.value.code == 2 and len(lines) == 1 and lines[0].startswith("error: "), told
        return lines[0]

    return refused


@pytest.mark.parametrize(
    ("package", "message"),
    [
        ("raises", "--world.import=raises cannot be imported (RuntimeError: no display): install it"),
        ("exits", "--world.import=exits cannot be imported (SystemExit: 0)"),
        ("exits_loudly", "--world.import=exits_loudly cannot be imported (SystemExit: no license)"),
        ("is_spoiled", "--world.import=is_spoiled cannot be imported (SyntaxError: "),
        ("registers_nothing", "correct --world.id, since --world.import=registers_nothing registers none of"),
        ("gym-strange", "--world.import=gym-strange is no package's name"),
        ("../strange", "--world.import=../strange is no package's name"),
        (".strange", "--world.import=.strange is no package's name"),
        ("7", "--world.import=7 is no package's name"),
    ],
)
def test_packages_that_cannot_be_imported(refused, tmp_path, package, message):
    policy = constant_policy(tmp_path / "policy", world={"id": "Nowhere-v0"})
    options = [f"--policy.path={policy}", f"--world.import={package}"]
    assert message in refused(*options)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ("makes", "cannot be made with {'wrong': 'makes'} (SystemExit: no license): correct its options"),
        ("space", "the world Strange-v0 has a NoneType as action_space, and no space of gymnasium"),
    ],
)
def test_worlds_that_cannot_be_made(refused, policy, tmp_path, wrong, message):
    options = [f"--policy.path={policy}", f"--world.wrong={wrong}"]
    assert message in refused(*options)
    assert not (tmp_path / "out").exists()


RAISED = "the world Strange-v0 raised"
GIVES = "the world Strange-v0 gives"
INFO = "the info of the world Strange-v0 has"
STEP = "at step 0 of the run of seed 2"
WRONG = [
    ("reset", f"{RAISED} KeyError: 'arm', at the start of the run of seed 2"),
    ("reset_exit", f"{RAISED} SystemExit: 0, at the start of the run of seed 2"),
    (
        "reset_alone",
        f"{GIVES} a dict by reset(), at the start of the run of seed 2: gymnasium's give a",
    ),
    ("reset_info", f"{GIVES} a NoneType as the info of reset(), at the start"),
    ("quiet", f"{RAISED} Quiet, {STEP}"),
    ("exit", f"{RAISED} SystemExit, {STEP}"),
    ("four", f"{GIVES} a tuple of 4 by step(), {STEP}: gymnasium's give a tuple of 5"),
    ("list", f"{GIVES} a list by step(), {STEP}"),
    ("info", f"{GIVES} a NoneType as the info of step(), {STEP}"),
    ("reward", f"{GIVES} None as reward, {STEP}: it must be a finite number"),
    ("reward_nan", f"{GIVES} nan as reward, {STEP}"),
    ("reward_pair", f"{GIVES} array([0., 0.]) as reward, {STEP}"),
    ("over", f"{GIVES} None as terminated, {STEP}: it must be true or false"),
    ("over_pair", f"{GIVES} array([False, False]) as terminated"),
    ("cut", f"{GIVES} 'no' as truncated"),
    ("success", f"{INFO} 'yes' as 'success'"),
    ("success_nan", f"{INFO} nan as 'success'"),
    ("success_ragged", f"{INFO} [[1], [1, 2]] as 'success'"),
    ("nothing_seen", f"the world Strange-v0 shows no agent_pos {STEP}"),
    ("shape", f"the world Strange-v0 shows agent_pos of shape (4,) and type float64 {STEP}"),
    ("ragged", f"the world Strange-v0 shows agent_pos that is no array {STEP} (setting an array element"),
    ("words", "shows agent_pos of shape (3,) and type <U1"),
    ("huge", f"shows agent_pos with inf as number 0 {STEP}"),
]


@pytest.mark.parametrize(("wrong", "message"), WRONG, ids=[wrong for wrong, _ in WRONG])
def test_worlds_that_go_wrong_in_mid_run(refused, policy, tmp_path, wrong, message):
    out = tmp_path / "out"
    options = [f"--policy.path={policy}", "--seed=0", "--episodes=5"]
    line = refused(*options, f"--world.wrong={wrong}")
    assert message in line and line.endswith(f"the 2 runs before it are kept in {out / 'runs.jsonl'}")
    assert seeds_in(out) == [0, 1]


def test_a_world_that_ends_its_process_among_workers(refused, policy, strange, tmp_path, monkeypatch):
    out = tmp_path / "out"
    options = [f"--policy.path={policy}", "--seed=0", "--episodes=4", "--workers=2"]
    monkeypatch.setenv("PYTHONPATH", str(strange), prepend=":")
    line = refused(*options, "--world.wrong=exit")
    assert f"{RAISED} SystemExit, {STEP}" in line and seeds_in(out) == [0, 1]


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ("no_picture", "the world Strange-v0 renders an array of shape () and type object, at step 0 of"),
        ("float_picture", "the world Strange-v0 renders an array of shape (24, 32, 3) and type float64"),
    ],
)
def test_pictures_that_are_none_leave_the_results(evaluate, policy, tmp_path, capsys, wrong, message):
    out = tmp_path / "out"
    options = [f"--policy.path={policy}", "--episodes=1", "--videos=1"]
    with pytest.raises(SystemExit) as exit_:
        evaluate(*options, f"--world.wrong={wrong}")
    told = capsys.readouterr()
    assert exit_.value.code == 2 and message in told.err and "successes   1 of 1 runs" in told.out
    assert (out / "eval_info.json").exists() and not list(out.rglob("*.mp4"))


def test_a_world_that_cannot_be_closed_is_a_warning(evaluate, policy, capsys):
    options = [f"--policy.path={policy}", "--episodes=1"]
    evaluate(*options, "--world.wrong=close")
    told = capsys.readouterr()
    assert "successes   1 of 1 runs" in told.out
    assert f"warning: {RAISED} OSError: the port is gone, as it was closed: " in told.err


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ("act", "the expert of the world Strange-v0 raised ZeroDivisionError: by nothing, at step 1 of the"),
        ("act_words", f"the action ['a', 'a', 'a'] {STEP} is none that the world Strange-v0 takes"),
        ("act_ragged", f"the action [[1], [1, 2]] {STEP} is none that the world Strange-v0 takes"),
        ("act_few", f"the action [0.0] {STEP} is none that the world Strange-v0 takes: it takes 3 finite"),
        ("act_none", "the expert of the world Strange-v0 knows no action at the start of the run of seed 2"),
    ],
)
def test_experts_that_go_wrong(refused, tmp_path, wrong, message):
    out = tmp_path / "out"
    options = ["--policy.type=teacher", "--world.id=Strange-v0", "--world.import=strange", "--seed=0"]
    options += ["--episodes=4", f"--world.wrong={wrong}"]
    line = refused(*options)
    assert message in line and seeds_in(out) == [0, 1]


def test_an_expert_that_gives_up_has_failed(evaluate, capsys):
    options = ["--policy.type=teacher", "--world.id=Strange-v0", "--world.import=strange", "--seed=0"]
    options += ["--episodes=4", "--world.wrong=gives_up"]
    evaluate(*options)
    assert "successes   2 of 4 runs" in capsys.readouterr().out
