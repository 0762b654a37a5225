"""A policy in LeRobot's hands: its rows act as planners do one by one, and bad observations are named."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from lerobot.configs.types import FeatureType, PolicyFeature

from dpmacro.policy.config import InputConfig, PolicyConfig
from dpmacro.policy.lerobot.inputs import inputs_of
from dpmacro.policy.recovery import Stretches
from tests.policy.lerobot.conftest import TASKS, as_lerobot
from tests.policy.test_policy import DEVICES, KEY, SHAPE, random_policy
from tests.policy.test_vectors import STATE, TOP, vector_policy

STEPS = 30


def orders(rows, frames):
    """For every row the frames that its environment shows: the first shows one alone, others ever more."""
    generator = torch.Generator().manual_seed(0)
    shown = [max(1, frames // 5 * row) for row in range(rows)]
    return torch.stack([torch.randint(many, (STEPS,), generator=generator) for many in shown])


def with_tasks(policy):
    return replace(policy, config=replace(policy.config, tasks=TASKS))


def planned(policy, shown, order, recovery=None):
    """What a planner does in one environment that shows these frames, and its macro-actions."""
    planner, actions, macros = policy.planner(recovery), [], []
    planner.reset()
    for frame in order.tolist():
        actions.append(
            torch.as_tensor(planner.act({key: values[frame].numpy() for key, values in shown.items()}, {}))
        )
        macros.append(planner.macro)
    return torch.stack(actions), macros


@pytest.mark.parametrize("starts", [(0,), (0, 1, 2)])
@pytest.mark.parametrize("recovery", [False, True])
def test_rows_take_the_classes_that_planners_take(loaded, starts, recovery):
    policy, images = random_policy(switches=((0, 1), (1, 2), (2, 0)), starts=starts)
    actions = torch.randint(3, (60,), generator=torch.Generator().manual_seed(1))
    stretches = Stretches.of(torch.arange(3).repeat_interleave(20), actions, torch.tensor([60]))
    config = replace(policy.config, recovery=recovery, thresholds=(0.0,) * 3, cues=((0, 1), (1, 2), (0, 2)))
    policy = replace(policy, config=config, stretches=stretches)
    found, order, shown = loaded(policy), orders(4, len(images)), {KEY: images}
    for _ in range(2):  # episodes
        found.reset()
        taken, macros = [], []
        for step in range(STEPS):
            action = found.select_action(as_lerobot(shown, order[:, step]))
            assert action.dtype == torch.float32 and action.sum(1).tolist() == [1.0] * 4
            taken.append(action.argmax(1))
            macros.append(found.macro)
        for row in range(4):
            wanted, own = planned(policy, shown, order[row])
            assert torch.stack(taken)[:, row].tolist() == wanted.tolist()
            assert torch.stack(macros)[:, row].tolist() == own
    if recovery:  # an option of LeRobot's, too
        plain = loaded(policy, recovery=False)
        assert [
            int(plain.select_action(as_lerobot(shown, order[:1, step])).argmax()) for step in range(STEPS)
        ] == (planned(policy, shown, order[0], recovery=False)[0].tolist())
        assert (
            planned(policy, shown, order[0])[0].tolist()
            != planned(policy, shown, order[0], False)[0].tolist()
        )


@pytest.mark.parametrize("kind", ["state", "all"])
@pytest.mark.parametrize("relative", [False, True])
def test_rows_act_by_the_vectors_that_planners_act_by(loaded, kind, relative):
    policy, shown = vector_policy(kind, relative)
    policy = with_tasks(policy)
    found, order = loaded(policy), orders(3, len(shown[STATE]))
    taken = torch.stack([found.select_action(as_lerobot(shown, order[:, step])) for step in range(STEPS)])
    for row in range(3):
        torch.testing.assert_close(taken[:, row], planned(policy, shown, order[row])[0])
    found.reset()
    chunk = found.predict_action_chunk(as_lerobot(shown, order[:, 0]))
    torch.testing.assert_close(chunk[:, 0], taken[0])


def test_images_are_shrunk_as_the_demonstrations_were(loaded):
    policy, _ = random_policy()
    large = torch.randint(
        0, 256, (20, 36, 32, 3), dtype=torch.uint8, generator=torch.Generator().manual_seed(0)
    )
    shrunk = [cv2.resize(image, SHAPE[::-1], interpolation=cv2.INTER_AREA) for image in large.numpy()]
    stored = replace(policy, config=replace(policy.config, inputs={KEY: InputConfig((*SHAPE, 3), (36, 32))}))
    found = loaded(stored)
    assert found.config.input_features[KEY].shape == (3, 36, 32)
    taken = [int(found.select_action(as_lerobot({KEY: large}, [n])).argmax()) for n in range(20)]
    assert taken == planned(policy, {KEY: torch.from_numpy(np.stack(shrunk))}, torch.arange(20))[0].tolist()


def test_floats_become_the_nearest_bytes():
    bytes_ = torch.arange(256).to(torch.uint8).repeat(1, 3, 2, 1)
    config = PolicyConfig("dpboost", 1, (0,), {KEY: InputConfig((2, 256, 3))}, {}, ("a",), 1)
    for off in (0.0, -0.3, 0.3):
        found = inputs_of({KEY: (bytes_ + off) / 255}, config, torch.device("cpu"))
        assert torch.equal(found[KEY], bytes_.permute(0, 2, 3, 1))


def test_bytes_do_as_well_as_floats(loaded):
    policy, images = random_policy()
    found = loaded(policy)
    floats = torch.stack([found.select_action(as_lerobot({KEY: images}, [n])) for n in range(20)])
    found.reset()
    bytes_ = torch.stack(
        [found.select_action({KEY: images[n : n + 1].permute(0, 3, 1, 2)}) for n in range(20)]
    )
    assert torch.equal(floats, bytes_)


def test_an_environment_that_takes_a_number_gets_the_class(loaded):
    policy, images = random_policy()
    one_hot = loaded(policy).select_action(as_lerobot({KEY: images}, range(50)))
    feature = PolicyFeature(FeatureType.ACTION, (1,))
    number = loaded(policy, output_features={"action": feature}).select_action(
        as_lerobot({KEY: images}, range(50))
    )
    assert number.shape == (50, 1) and number[:, 0].tolist() == one_hot.argmax(1).tolist()
    assert len(set(number[:, 0].tolist())) > 1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda batch: batch.pop(STATE),
            r"the policy sees observation\.state, which is not among .*rename_map",
        ),
        (lambda batch: batch.update({STATE: batch[STATE].numpy()}), "is a ndarray: give a tensor"),
        (
            lambda batch: batch.update({STATE: batch[STATE][:, :2]}),
            r"shape \(2, 2\): the policy was trained on \[rows, 3\]",
        ),
        (lambda batch: batch.update({STATE: batch[STATE][0]}), r"shape \(3,\)"),
        (lambda batch: batch.update({STATE: batch[STATE] > 0}), r"is of torch\.bool: give float32"),
        (lambda batch: batch[STATE][1].fill_(torch.nan), "is nan in row 1 at 0: give finite numbers"),
        (lambda batch: batch[STATE][0, 2].fill_(-torch.inf), "is -inf in row 0 at 2"),
        (lambda batch: batch.update({STATE: batch[STATE][:1]}), "different numbers of rows"),
        (lambda batch: batch.update({TOP: batch[TOP].permute(0, 2, 3, 1)}), "channels first"),
        (
            lambda batch: batch.update({TOP: batch[TOP][0]}),
            r"shape \(3, 8, 10\): give \[rows, 3, height, width\]",
        ),
        (
            lambda batch: batch.update({TOP: batch[TOP][..., :9]}),
            "top: images are 9x8, the policy was trained on 10x8",
        ),
        (lambda batch: batch[TOP].mul_(255), "has values from .* to 255: give floats from 0 to 1"),
        (lambda batch: batch[TOP][0, 0, 0].fill_(torch.nan), "has values from nan to nan"),
        (lambda batch: batch.update({TOP: batch[TOP].to(torch.int64)}), r"is of torch\.int64"),
        (lambda batch: batch.pop("task"), "task is None: give the task of every row in words"),
        (
            lambda batch: batch.update(task=["stack", "stack"]),
            "the task is 'stack': the policy knows 'stack the blocks', ",
        ),
    ],
)
def test_observations_that_do_not_fit_are_named(loaded, change, message):
    policy, shown = vector_policy("all")
    found = loaded(with_tasks(policy))
    batch = as_lerobot(shown, [0, 1])
    change(batch)
    with pytest.raises(ValueError, match=message) as error:
        found.select_action(batch)
    assert "\n" not in str(error.value)
    assert found.macro is None, "what failed left no trace"


def test_rows_may_not_come_and_go_within_an_episode(loaded):
    policy, shown = vector_policy()
    found = loaded(policy)
    found.select_action(as_lerobot(shown, [0, 1]))
    with pytest.raises(ValueError, match="the batch has 3 rows and had 2 before: reset the policy"):
        found.select_action(as_lerobot(shown, [0, 1, 2]))
    found.reset()
    assert len(found.select_action(as_lerobot(shown, [0, 1, 2]))) == 3


def test_types_of_tensors_stay(loaded):
    found = loaded(vector_policy()[0])
    before = found.macro_policy
    assert found.half().double().to("cpu").macro_policy is before


@pytest.mark.parametrize("device", DEVICES)
def test_tensors_follow_to_a_device(loaded, device):
    policy, shown = vector_policy()
    here, there = loaded(policy), loaded(policy).to(device)
    assert there.macro_policy.device.type == device
    batch = as_lerobot(shown, range(9))
    torch.testing.assert_close(there.select_action(batch).cpu(), here.select_action(batch))
