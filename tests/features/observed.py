"""Random observations of every kind, and their specs."""

import torch

from dpmacro.features.kinds import CameraSpec, StateSpec, TaskSpec

FRONT, TOP = "observation.images.front", "observation.images.top"
STATE, OTHER, TASK = "observation.state", "observation.environment_state", "task_index"
SPECS = {
    STATE: StateSpec(("x", "y", "z"), (0, 2)),
    FRONT: CameraSpec(6, 8),
    TASK: TaskSpec(3),
    TOP: CameraSpec(5, 4),
    OTHER: StateSpec(("x", "w")),
}


def observe(n_frames, seed, keys=tuple(SPECS)):
    """By key, what `n_frames` frames show; every key's numbers are the same whatever the others."""
    observations = {}
    for key in keys:
        generator = torch.Generator().manual_seed(1000 * seed + list(SPECS).index(key))
        spec = SPECS[key]
        if isinstance(spec, CameraSpec):
            size = n_frames, spec.height, spec.width, 3
            observations[key] = torch.randint(0, 256, size, dtype=torch.uint8, generator=generator)
        elif isinstance(spec, StateSpec):
            observations[key] = torch.randn(n_frames, len(spec.dimensions), generator=generator)
        else:
            observations[key] = torch.randint(0, spec.count, (n_frames,), generator=generator)
    return observations
