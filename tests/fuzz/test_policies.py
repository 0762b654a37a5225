"""A policy's files with any damage are refused in one line, or load and act soundly."""

import copy
import json
from dataclasses import replace
from functools import cache

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from safetensors.torch import load_file, save_file

from dpmacro.boosting.learners.convnet import ConvNetClassifier, ConvNets
from dpmacro.policy.config import InputConfig
from dpmacro.policy.policy import MacroPolicy
from dpmacro.policy.recovery import Stretches
from tests.fuzz.damage import bytes_damage, dumped, edited, edits, header_of, tensor_edits, with_header
from tests.fuzz.limits import Findings, cases
from tests.policy.test_policy import KEY, SHAPE, random_policy
from tests.policy.test_vectors import vector_policy

CONFIG, WEIGHTS = "config.json", "model.safetensors"
FEW = 30


def rectangles():
    policy, _ = random_policy(starts=(0, 2))
    stretches = Stretches.of(torch.tensor([0, 0, 1, 2]), torch.tensor([0, 1, 2, 1]), torch.tensor([4]))
    config = replace(
        policy.config,
        cues=((0, 1), (2,)),
        thresholds=(2.0, None),
        recovery=True,
        inputs={KEY: InputConfig((*SHAPE, 3), (24, 32))},
        max_transitions=2,
        switch_weight=1.0,
        change_log_odds=((0.0, 1.0, 0.5),) * 3,
    )
    return replace(policy, config=config, stretches=stretches)


def vectors():
    return vector_policy("all", relative=True)[0]


def networks():
    policy, _ = random_policy("pixels", switches=((0, 1),))
    generator = torch.Generator().manual_seed(0)
    size = (SHAPE[0] // 2, SHAPE[1] // 2)
    nets = [[ConvNets.random((2, 3), 3, size, generator) for _ in range(3)] for _ in range(2)]
    stacked = ConvNets.stack([ConvNets.stack(row) for row in nets])
    return replace(policy, actor=ConvNetClassifier(**vars(stacked), steps=torch.ones(2, 3)))


POLICIES = {one.__name__: one for one in (rectangles, vectors, networks)}


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """Every policy as it was saved."""
    made = {name: tmp_path_factory.mktemp(name) for name in POLICIES}
    for name, folder in made.items():
        POLICIES[name]().save(folder)
    return made


@cache
def observations(shapes):
    """Two rows of noise for every input."""
    generator, found = torch.Generator().manual_seed(0), {}
    for key, shape in shapes:
        size = (2, *shape)
        if len(shape) == 3:
            found[key] = torch.randint(0, 256, size, generator=generator).to(torch.uint8)
        else:
            found[key] = torch.randn(size, generator=generator) if shape else torch.zeros(2).long()
    return found


def loads_and_acts(folder):
    """Raises AssertionError where a policy does what its config does not allow."""
    policy = MacroPolicy.load(folder)
    config = policy.config
    assert len(str(config.type)) < 100 and config.type in ("dpboost", "baseline")
    shown = observations(tuple((key, one.shape) for key, one in config.inputs.items()))
    state = policy.initial_state(2)
    for _ in range(3):
        scores, _ = policy.decide(shown, state)
        assert scores.shape == (2, config.outputs) and scores.isfinite().all()
        actions, state = policy.act(shown, state)
        assert ((state.macro >= 0) & (state.macro < config.macros)).all()
        if config.vector:
            assert actions.shape == (2, len(config.action_names)) and actions.isfinite().all()
        else:
            assert ((actions >= 0) & (actions < len(config.action_names))).all()
    if config.recovery:
        assert max(policy.replayed().actions.tolist(), default=0) < len(config.action_names)
        for macro in range(config.macros):
            policy.replayed().of_macro(macro)


def damaged(folder, tmp, name, content):
    """A copy of a policy in which one file has another content."""
    for one in (CONFIG, WEIGHTS):
        (tmp / one).write_bytes(content if one == name else (folder / one).read_bytes())
    return tmp


@pytest.mark.parametrize("kind", POLICIES)
def test_damaged_configs(folders, tmp_path, kind):
    values, found = json.loads((folders[kind] / CONFIG).read_text()), Findings()
    planner = edits(values["planner"]).map(lambda own: ("planner", own))

    @cases(FEW)
    @given(st.one_of(planner, planner, edits(values).map(lambda own: ("", own))))
    def run(drawn):
        where, changes = drawn
        new = {**values, "planner": edited(values["planner"], changes)} if where else edited(values, changes)
        damaged(folders[kind], tmp_path, CONFIG, dumped(new).encode())
        found.run([*map(str, changes)], lambda: loads_and_acts(tmp_path), str(tmp_path))

    run()
    found.check(f"configs of {kind}")


@pytest.mark.parametrize("kind", POLICIES)
def test_damaged_tensors(folders, tmp_path, kind):
    tensors, found = load_file(folders[kind] / WEIGHTS), Findings()

    @cases(FEW)
    @given(tensor_edits(sorted(tensors)))
    def run(changes):
        new = copy.copy(tensors)
        for change in changes:
            change.apply(new)
        damaged(folders[kind], tmp_path, WEIGHTS, b"")
        save_file(new, tmp_path / WEIGHTS)
        found.run([*map(str, changes)], lambda: loads_and_acts(tmp_path), str(tmp_path))

    run()
    found.check(f"tensors of {kind}")


@pytest.mark.parametrize("kind", ["rectangles"])
def test_damaged_headers_and_bytes(folders, tmp_path, kind):
    contents = {name: (folders[kind] / name).read_bytes() for name in (CONFIG, WEIGHTS)}
    found = Findings()
    header = edits(header_of(contents[WEIGHTS])).map(lambda own: (WEIGHTS, own))
    raw = st.tuples(st.sampled_from((CONFIG, WEIGHTS)), bytes_damage())

    @cases(FEW)
    @given(header | raw)
    def run(drawn):
        name, change = drawn
        old = contents[name]
        new = with_header(old, change) if isinstance(change, list) else change.apply(old)
        damaged(folders[kind], tmp_path, name, new)
        found.run(f"{name} {change}", lambda: loads_and_acts(tmp_path), str(tmp_path))

    run()
    found.check(f"headers and bytes of {kind}")
