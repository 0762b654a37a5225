"""Policies that see states, several cameras or a task, and act by vectors."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from dpmacro.boosting.learners.stumps import StumpClassifier
from dpmacro.data.vectors import ActionTransform
from dpmacro.features.history import Recording
from dpmacro.features.kinds import CameraSpec, StateSpec, TaskSpec, make_encoder
from dpmacro.features.quantising import Quantiser
from dpmacro.policy.config import InputConfig, PolicyConfig
from dpmacro.policy.observation import observed
from dpmacro.policy.policy import MacroPolicy
from tests.policy.test_policy import change_config

STATE, TOP, WRIST, TASK = (
    "observation.state",
    "observation.images.top",
    "observation.images.wrist",
    "task_index",
)
FRAMES, DIMS = 40, 3
SPECS = {
    "state": {STATE: StateSpec(("x", "y", "grip"))},
    "all": {
        TOP: CameraSpec(8, 10),
        WRIST: CameraSpec(6, 6),
        STATE: StateSpec(("x", "y", "grip")),
        TASK: TaskSpec(2),
    },
}


def shown(spec, seed=0):
    rng = np.random.default_rng(seed)
    made = {}
    for key, one in spec.items():
        if isinstance(one, CameraSpec):
            made[key] = rng.integers(0, 256, (FRAMES, one.height, one.width, 3)).astype(np.uint8)
        elif isinstance(one, StateSpec):
            made[key] = rng.standard_normal((FRAMES, DIMS)).cumsum(0).astype(np.float32)
        else:
            made[key] = rng.integers(0, one.count, FRAMES)
    return {key: torch.from_numpy(values) for key, values in made.items()}


def vector_policy(kind="state", relative=False, seed=0):
    """Random stumps over what is shown, between two macro-actions."""
    generator = torch.Generator().manual_seed(seed)
    spec = SPECS[kind]
    seen = shown(spec)
    encoder = make_encoder(spec, "rectangles", 40, 4, 3, generator)
    recording = Recording(seen, torch.tensor([FRAMES]))
    quantiser = Quantiser.fit(recording_values(recording, encoder), encoder.dtype)

    def stumps(problems, outputs):
        return StumpClassifier(
            torch.randint(encoder.count, (30, problems), generator=generator),
            torch.randint(256, (30, problems), generator=generator).to(torch.uint8),
            torch.randn(30, problems, 2, outputs, generator=generator),
        )

    transform = ActionTransform((1.0, 2.0, 5.0), (0.5, 2.0, 1.0), (0, 1), relative, (2,), ("a", "b", "c"))
    inputs = {key: InputConfig(tuple(values.shape[1:])) for key, values in seen.items()}
    config = PolicyConfig(
        type="dpboost",
        macros=2,
        starts=(0,),
        inputs=inputs,
        encoder=encoder.spec(),
        action_names=("a", "b", "c"),
        outputs=2,
        loss="huber",
        action_transform=transform.to_dict(),
        action_state=STATE if relative else "",
        switches=((0, 1), (1, 0)),
        thresholds=(1.0, 1.0),
    )
    policy = MacroPolicy.compact(config, encoder, quantiser, stumps(2, 2), stumps(2, 1))
    return policy, seen


def recording_values(recording, encoder):
    return encoder.values(recording.seen(encoder))


@pytest.mark.parametrize("kind", SPECS)
@pytest.mark.parametrize("relative", [False, True])
def test_a_run_sees_what_the_recording_shows_and_acts_in_the_units_of_the_dataset(kind, relative, tmp_path):
    policy, seen = vector_policy(kind, relative)
    policy.save(tmp_path)
    frames = policy.frames(Recording(seen, torch.tensor([FRAMES])).seen(policy.features))
    scores = policy.actor.scores(frames)
    switch = policy.switcher.scores(frames)[:, :, 0]
    macro, wanted = 0, []
    for n in range(FRAMES):
        if switch[n, macro] > 1.0:
            macro = 1 - macro
        own = scores[n, macro]
        action = torch.tensor([1 + 0.5 * own[0], 2 + 2 * own[1], 5.0])
        if relative:
            action[:2] += seen[STATE][n, :2]
        wanted.append(action)
    for one in (policy, MacroPolicy.load(tmp_path)):
        planner = one.planner()
        planner.reset()
        acted = [
            planner.act({key: values[n].numpy() for key, values in seen.items()}, {}) for n in range(FRAMES)
        ]
        torch.testing.assert_close(
            torch.from_numpy(np.stack(acted)), torch.stack(wanted), rtol=1e-4, atol=1e-4
        )
        assert planner.memory is None, "a state is looked at further back than a frame"


def test_rows_of_a_batch_begin_anew_on_their_own():
    policy, seen = vector_policy("all")
    order = torch.arange(FRAMES)
    state, second = policy.initial_state(2), []
    for n in range(20):
        if n == 8:
            state = policy.restart(state, torch.tensor([False, True]))
        rows = torch.stack([order[n], order[n - 8 if n >= 8 else n]])
        actions, state = policy.act({key: values[rows] for key, values in seen.items()}, state)
        second.append((actions[1], [values[1:] for one in state.seen.values() for values in one.values()]))
    alone = policy.initial_state(1)
    for n in range(12):
        single, alone = policy.act({key: values[n : n + 1] for key, values in seen.items()}, alone)
        acted, looked_at = second[8 + n]
        torch.testing.assert_close(acted, single[0])
        own = [values for one in alone.seen.values() for values in one.values()]
        assert all(torch.equal(ours, theirs) for ours, theirs in zip(looked_at, own, strict=True))


def test_a_world_may_use_gymnasiums_keys_as_lerobot_does():
    policy, seen = vector_policy("all")
    now = {key: values[3].numpy() for key, values in seen.items()}
    as_gymnasium = {
        "pixels": {"top": now[TOP], "wrist": now[WRIST]},
        "agent_pos": now[STATE],
        TASK: now[TASK],
    }
    found = observed(as_gymnasium, policy.config)
    for key, value in now.items():
        np.testing.assert_array_equal(found[key], value)
    one = replace(policy.config, inputs={TOP: policy.config.inputs[TOP]})
    np.testing.assert_array_equal(observed({"pixels": now[TOP]}, one)[TOP], now[TOP])
    with pytest.raises(ValueError, match=r"the observation has no observation\.state: it has pixels"):
        observed({"pixels": as_gymnasium["pixels"]}, policy.config)


def test_what_is_shown_must_have_the_size_of_the_training():
    policy, seen = vector_policy()
    with pytest.raises(ValueError, match=r"observation\.state is 2: the policy was trained on 3"):
        policy.act({STATE: seen[STATE][:1, :2]}, policy.initial_state(1))
    with pytest.raises(ValueError, match=r"the observation has no observation\.state: it has other"):
        policy.act({"other": seen[STATE][:1]}, policy.initial_state(1))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"outputs": 3}, "outputs"),
        ({"loss": "exponential"}, "loss"),
        ({"recovery": True}, "recovery"),
        ({"action_state": "observation.pose"}, "action_state"),
        ({"action_transform": {}}, "no transform of actions"),
    ],
)
def test_a_config_of_vectors_that_cannot_be_is_named(tmp_path, changes, message):
    vector_policy(relative=True)[0].save(tmp_path)
    change_config(tmp_path, changes)
    with pytest.raises(ValueError, match=rf"(?s)config\.json is no policy of dpmacro.*\(.*{message}"):
        MacroPolicy.load(tmp_path)


def test_recovery_replays_classes_only():
    policy, _ = vector_policy()
    with pytest.raises(ValueError, match="the policy holds no actions of demonstrators"):
        policy.planner(recovery=True)
