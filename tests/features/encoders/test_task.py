"""Task columns are 1 in the frames of their task."""

import pytest
import torch

from dpmacro.features.encoders.task import Task
from dpmacro.features.kinds import encoder_from


def test_one_column_is_1_and_none_for_a_task_without_one():
    numbers = torch.tensor([2, 0, 7, 1])
    encoder = Task.all(3)
    values = encoder.values({0: {"task_index": numbers}})
    assert values.dtype == torch.int32
    assert values.tolist() == [[0, 1, 0, 0], [0, 0, 0, 1], [1, 0, 0, 0]]
    few = encoder.select(torch.tensor([2, 0]))
    few = encoder_from(few.spec(), few.tensors())
    assert torch.equal(few.values({0: {"task_index": numbers}}), values[[2, 0]])
    assert few.names() == ["task 2", "task 0"]
    assert few.keys == ("task_index",) and few.lags == (0,) and few.footprint(torch.ones(1, 2)) == {}


def test_no_task_is_no_encoder():
    with pytest.raises(ValueError, match="number of tasks is 0"):
        Task.all(0)
