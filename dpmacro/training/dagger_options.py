"""The options of DAgger, a group of train.py's."""

from dataclasses import dataclass

from dpmacro.utils.checks import as_count

__all__ = ["SEEDS", "DaggerOptions"]

SEEDS = 2**63  # those that generators take
MOST_RUNS = 100_000  # of an iteration; their workers are no more


@dataclass(frozen=True)
class DaggerOptions:
    """DAgger (Ross et al. 2011), which adds the policy's own runs, labelled by the world's teacher."""

    iterations: int = 0
    """Times that the policy runs, the world's teacher labels its frames, and training repeats."""
    episodes: int = 20
    """Runs of the policy that every DAgger iteration adds to the demonstrations."""
    seed: int = 20000
    """World seed of the first added run; the following runs take the following seeds."""
    validation_episodes: int = 50
    """Runs of every iteration's policy whose success rate decides which policy is kept."""
    validation_seed: int = 5000
    """World seed of the first validation run; the following runs take the following seeds."""
    workers: int = 2
    """Processes that share the runs; results do not depend on their number."""

    def __post_init__(self) -> None:
        bounds = {"iterations": (0, 1000), "seed": (0, SEEDS - 1), "validation_seed": (0, SEEDS - 1)}
        for name, value in vars(self).items():
            as_count(f"dagger.{name}", value, *bounds.get(name, (1, MOST_RUNS)))
        gathered = range(self.seed, self.seed + self.iterations * self.episodes)
        validating = range(self.validation_seed, self.validation_seed + self.validation_episodes)
        if max(gathered.start, validating.start) < min(gathered.stop, validating.stop):
            raise ValueError(
                f"dagger.seed is {self.seed} and dagger.validation_seed {self.validation_seed}: some worlds "
                "would serve both, move one of them"
            )
