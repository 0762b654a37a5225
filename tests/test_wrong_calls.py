"""The public face with arguments that it cannot take: a ValueError of one line that names them.

What `DPBoost` and `segment` are given is in tests/estimator/test_arguments.py and tests/test_public_face.py.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from jaxtyping import TypeCheckError
from reaching import STATE, constant_policy
from refusals import SMALL, A, L, N, X

from dpmacro import Demonstrations, DPBoost, MacroPolicy, Stages, annotate, write_labels
from dpmacro.boosting.learners.stumps import StumpLearner
from dpmacro.data.images import ImageTransform
from dpmacro.evaluation.rollouts import PlannerSource, run_episodes
from dpmacro.features.levels import SortedLevels
from dpmacro.features.quantising import Quantiser
from dpmacro.metrics import boundary_scores
from dpmacro.switching.settings import SwitchSettings

TEACHER, WORLD = PlannerSource("teacher"), {"id": "TwoButtons-v0"}
STAGES = Stages(
    np.array([0, 0, 1, 1]),
    np.ones(4),
    np.zeros(4, bool),
    np.zeros(4, bool),
    ("reach", "lift"),
    np.array([4]),
    (0,),
    np.arange(4.0),
    10.0,
)
SAME = np.array([0, 0, 1, 1])
SEEN = torch.zeros(2, 3)
TWO = torch.tensor([True, False])
NONE = float("nan")


class Given:
    """What the calls below are made with: a dataset, a policy and its state, levels."""

    def __init__(self, root: Path, folder: Path) -> None:
        self.root, self.folder = root, constant_policy(folder / "policy")
        self.demonstrations, self.policy = Demonstrations.load(root), MacroPolicy.load(self.folder)
        self.state = self.policy.initial_state(2)
        values = torch.from_numpy(X.T.copy())
        self.levels = SortedLevels.build(Quantiser.fit(values).levels(values))

    def load(self, **options):
        return Demonstrations.load(self.root, **options)

    def made(self, **parts):
        return replace(self.demonstrations, **parts)

    def act(self, seen, state=None):
        observation = {STATE: seen} if seen is not None else None
        return self.policy.act(observation, self.state if state is None else state)

    def fitted(self, **options):
        made = {k: v(self) if type(v).__name__ == "function" else v for k, v in options.items()}
        return DPBoost(**SMALL).fit_levels(self.levels, A, L, **made)

    @property
    def part(self):
        """Levels of the first trajectory alone."""
        values = torch.from_numpy(X.T.copy())[:, : L[0]]
        return SortedLevels.build(Quantiser.fit(values).levels(values))

    def of_part(self):
        """What was found of it."""
        return DPBoost(**SMALL).discover_levels(self.part, A[: L[0]], L[:1])

    def discovered(self, **options):
        return DPBoost(**SMALL).discover_levels(self.levels, A, L, **options)


@pytest.fixture(scope="module")
def given(recorded, tmp_path_factory):
    return Given(recorded, tmp_path_factory.mktemp("given"))


LOADING = {
    "root": [None, 3, "", b"x"],
    "episodes": [0, [0.5], "01", [True], [[0]], {0}],
    "inputs": [3, {"a"}],
    "camera": [3],
    "action": [3],
    "truth": [3],
    "task": [1.5, [], True],
    "tolerance_s": [-1, NONE, "1"],
    "transform": [None, {}],
}
MADE = {
    "lengths": [[4], np.array([-1, 31]), np.array([30.0]), np.zeros(0, np.int64), None],
    "actions": [[0], torch.zeros(30), np.zeros(29), np.array(["a"] * 30), np.zeros(())],
    "observation.images.avatar": [[0], np.zeros((29, 2, 2, 3), np.uint8)],
    "truth": [np.zeros(29, np.int64)],
}
STAGED = {
    "labels": [[0, 0, 1, 1], np.zeros(4), np.zeros((4, 1), np.int64), np.full(4, 2), np.full(4, -1)],
    "confidence": [[1.0] * 4, np.full(4, NONE), np.full(4, 2.0), np.ones(4, np.int64)],
    "idle": [np.zeros(4, np.int64), None],
    "names": ["ab", None, ("a", "a"), ("", "b"), (1, 2)],
    "lengths": [[4], np.array([4.0]), np.array([3]), np.array([[4]])],
    "episodes": [None, ("a",), (0.5,), (True,), (0, 1), (-1,)],
    "fps": [0, NONE, "10", None, -5, True],
    "timestamps": [np.full(4, np.inf), np.zeros(3)],
}
CALLS = [
    *(
        (name, lambda given, name=name, value=value: Demonstrations.load(value))
        if name == "root"
        else (name, lambda given, name=name, value=value: given.load(**{name: value}))
        for name, values in LOADING.items()
        for value in values
    ),
    *(
        (
            name,
            lambda given, name=name, value=value: given.made(
                **({"observations": {name: value}} if "." in name else {name: value})
            ),
        )
        for name, values in MADE.items()
        for value in values
    ),
    *(
        (name, lambda given, name=name, value=value: replace(STAGES, **{name: value}))
        for name, values in STAGED.items()
        for value in values
    ),
    *(
        ("trajectory_indices", lambda given, value=value: given.demonstrations.select(value))
        for value in (0, "01", None, [0.5], [True], np.ones(3, bool), [[0]])
    ),
    ("others", lambda given: given.demonstrations.joined(None)),
    ("policy", lambda given: annotate(str(given.folder), given.demonstrations)),
    ("demonstrations", lambda given: annotate(given.policy, str(given.root))),
    *(("folder", lambda given, value=value: MacroPolicy.load(value)) for value in (None, 3, "")),
    *(
        ("device", lambda given, v=v: MacroPolicy.load(given.folder, v))
        for v in ("nonsense", "meta", 3, None)
    ),
    *(("device", lambda given, v=v: given.policy.to(v)) for v in ("nonsense", "meta", 3, None, "cuda:99")),
    *(("folder", lambda given, value=value: given.policy.save(value)) for value in (None, 3, "")),
    *(("batch", lambda given, v=v: given.policy.initial_state(v)) for v in (0, -1, 1.5, True, "2", None)),
    *(("seed", lambda given, value=value: given.policy.planner(seed=value)) for value in (-1, 0.5, None)),
    *(
        (STATE, lambda given, value=value: given.act(value))
        for value in (
            *(SEEN.numpy(), SEEN.tolist(), "x", SEEN[0], SEEN[:, :2], SEEN[:1], SEEN * NONE),
            *(SEEN / 0, SEEN + 0j, SEEN.to("meta")),
        )
    ),
    ("observation", lambda given: given.act(None)),
    *(("state", lambda given, value=value: given.act(SEEN, value)) for value in (3, "begin")),
    *(
        ("which", lambda given, value=value: given.policy.restart(given.state, value))
        for value in ([True, False], TWO[:1], TWO.repeat(2), TWO.long(), None)
    ),
    ("state", lambda given: given.policy.restart(None, TWO)),
    *(("root", lambda given, value=value: write_labels(value, "out", STAGES)) for value in (None, 3, "")),
    *(
        ("output", lambda given, value=value: write_labels(given.root, value, STAGES))
        for value in (None, 3, "")
    ),
    *(("stages", lambda given, v=v: write_labels(given.root, "out", v)) for v in (None, STAGES.labels)),
    *(("formats", lambda given, v=v: write_labels(given.root, "out", STAGES, v)) for v in ("sarm", 3)),
    *(
        ("known", lambda given, value=value: given.discovered(known=value))
        for value in ([0] * 3, [2] * N, [-1] * N, [0.5] * N, "x", 3)
    ),
    *(
        ("groups", lambda given, value=value: given.discovered(groups=value))
        for value in ([0], [0, -1], [0.5, 1], "x", [[0, 1]])
    ),
    ("data", lambda given: DPBoost(**SMALL).discover_levels(X, A, L)),
    *(
        (name, lambda given, name=name, value=value: given.fitted(**{name: value}))
        for name, wrong in {
            "learner": (3, "stumps", X, lambda given: StumpLearner(given.part)),
            "switch_learner": (3, StumpLearner, lambda given: StumpLearner(given.part)),
            "shrinkage": (0.0, 2, "1", NONE),
            "switches": (3, {"rounds": 3}, SwitchSettings),
            "discovery": (3, "found", lambda given: given.of_part()),
        }.items()
        for value in wrong
    ),
    *(
        ("tolerance", lambda given, v=v: boundary_scores(SAME, SAME, np.array([4]), v))
        for v in (None, "2", -1, 1.5, NONE, True)
    ),
    *(("size", lambda given, value=value: ImageTransform(size=value)) for value in ("x", 3, (1, 2, 3))),
    *(("a side of size", lambda given, v=v: ImageTransform(size=v)) for v in ((-1, 2), (0, 0), (1.5, 2))),
    ("a side of stored", lambda given: ImageTransform(stored={"front": (4, True)})),
    *(("memory", lambda given, value=value: ImageTransform(memory=value)) for value in (-1.0, NONE, "1")),
    *(("workers", lambda given, v=v: run_episodes(TEACHER, WORLD, [0], v)) for v in (0, "2", True, 1.5)),
    *(("world", lambda given, value=value: run_episodes(TEACHER, value, [0])) for value in ("x", None)),
    *(("world['id']", lambda given, v=v: run_episodes(TEACHER, v, [0])) for v in ({}, {"id": 3})),
    *(("seeds", lambda given, v=v: run_episodes(TEACHER, WORLD, v)) for v in (3, [-1], [0.5], [True], None)),
]


@pytest.mark.parametrize(("name", "call"), CALLS, ids=[f"{k}-{name}" for k, (name, _) in enumerate(CALLS)])
def test_a_wrong_argument_is_named(given, name, call, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises((ValueError, TypeCheckError)) as caught:
        call(given)
    if isinstance(caught.value, TypeCheckError):
        return  # annotations are checked at run time, before the argument is
    line = str(caught.value)
    assert name in line and "\n" not in line and len(line) < 300, line
    assert not list(tmp_path.iterdir())


def test_what_is_as_it_should_be_is_taken(given, tmp_path):
    try:
        _taken(given, tmp_path)
    except TypeCheckError:
        pytest.skip("annotations are checked at run time: a list must not be a tuple")


def _taken(given, tmp_path):
    found = given.discovered()
    again = given.fitted(discovery=found, learner=StumpLearner(given.levels), shrinkage=1)
    assert len(again.labels) == N
    assert len(given.load(episodes=(0, 1)).lengths) == 2
    assert len(given.demonstrations.select(np.array([1])).lengths) == 1
    given.policy.save(str(tmp_path / "policy"))
    policy = MacroPolicy.load(str(tmp_path / "policy"), torch.device("cpu")).to("cpu")
    actions, state = policy.act({STATE: SEEN}, policy.initial_state(2))
    assert actions.shape == (2, 3) and policy.restart(state, TWO).macro.shape == (2,)
    assert given.discovered(known=np.repeat([0, 1], N // 2), groups=(0, 1)) is not None
    assert replace(STAGES, names=["a", "b"], fps=np.float32(5)).names == ["a", "b"]
    assert ImageTransform(size=[4, 2], stored={"front": (8, 4)}, memory=1).of("front").size == (4, 2)
