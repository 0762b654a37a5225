"""What of a room with flags can be chosen."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, ClassVar

__all__ = ["PIXELS", "WIDEST", "FourFlagsConfig", "SixFlagsConfig", "TwoFlagsConfig"]

PIXELS = (64, 48)
WIDEST = 4096  # of what is rendered, 48 MiB with all that belongs to it


@dataclass(frozen=True)
class TwoFlagsConfig:
    """Options of `TwoFlagsEnv`; a value out of range raises ValueError.

    A world with another number of flags has a subclass that says how many.
    """

    world: ClassVar[str] = "TwoFlags"
    """Name of the world, for messages."""
    count: ClassVar[int] = 2
    """Number of flags, 2 to 6."""

    flags: str = "random"
    """Whether every episode draws its room and flags ("random") or all share one layout ("fixed")."""
    layout_seed: int = 0
    """Seed of all that stays fixed: layout, textures and start; the episode's seed does not change it."""
    textures: str = "random"
    """Whether every episode draws the textures of walls and ground ("random") or all share them ("fixed")."""
    ways: str = "any"
    """Whether flags may hide or bar others ("any"), or straight ways lead from each to the next ("clear")."""
    start: str = "random"
    """Whether every episode draws where the avatar starts ("random") or all share it ("fixed")."""
    start_spread: float = 0.2
    """By how many radians at most the heading of start="fixed" differs, to either side."""
    teacher: str = "paper"
    """Who demonstrates: the paper's teacher ("paper"), or one that also looks behind flags ("searching")."""
    yaw_noise: float = 0.5
    """Standard deviation, in degrees, of the random turn after every forward step."""
    render_size: tuple[int, int] = (128, 96)
    """Width and height, in pixels, of the picture that is area-downscaled to the 64x48 observation."""
    max_steps: int = 3000
    """Steps after which an episode is truncated."""
    renderer: str = "tiny"
    """PyBullet's software renderer ("tiny") or its EGL plugin ("egl"), which needs a graphics driver."""

    def __post_init__(self) -> None:
        width, height = self.render_size if len(self.render_size) == 2 else (0, 0)
        drawn = "choose 'random' or 'fixed'"
        for ok, name, remedy in (
            (self.flags in ("random", "fixed"), "flags", drawn),
            (self.layout_seed >= 0, "layout_seed", "give a seed of 0 or more"),
            (self.textures in ("random", "fixed"), "textures", drawn),
            (self.start in ("random", "fixed"), "start", drawn),
            (self.ways in ("any", "clear"), "ways", "choose 'any' or 'clear'"),
            # A place that is free in one room lies in a flag or outside the walls of another.
            (self.start == "random" or self.flags == "fixed", "start", "give flags='fixed' with it"),
            (0 <= self.start_spread <= math.pi, "start_spread", "give radians, 0 to pi"),
            (self.teacher in ("paper", "searching"), "teacher", "choose 'paper' or 'searching'"),
            (0 <= self.yaw_noise < math.inf, "yaw_noise", "give degrees, 0 or more and finite"),
            (
                PIXELS[0] <= width <= WIDEST and width * PIXELS[1] == height * PIXELS[0],
                "render_size",
                f"give a width and height in the ratio 4:3, from (64, 48) to ({WIDEST}, {WIDEST * 3 // 4})",
            ),
            (self.max_steps >= 1, "max_steps", "give 1 or more"),
            (self.renderer in ("tiny", "egl"), "renderer", "choose 'tiny' or 'egl'"),
        ):
            if not ok:
                raise ValueError(f"{self.world}: {name} is {getattr(self, name)!r}: {remedy}")

    @classmethod
    def of(cls, options: Mapping[str, Any]) -> "TwoFlagsConfig":
        """These options, and defaults for those not given. Lists stand for tuples, as in a JSON file.

        Raises ValueError for an option that is unknown or unfit.
        """
        defaults = asdict(cls())
        unknown = sorted(set(options) - set(defaults))
        if unknown:
            raise ValueError(f"{cls.world} has no option {unknown[0]!r}: choose among {', '.join(defaults)}")
        given: dict[str, Any] = {
            name: tuple(value) if isinstance(value, list) else value for name, value in options.items()
        }
        for name, value in given.items():
            default = defaults[name]
            alike = isinstance(value, tuple) == isinstance(default, tuple)
            kind = {tuple: int, float: int | float}.get(type(default), type(default))
            parts = value if isinstance(value, tuple) else (value,)
            if not alike or not all(isinstance(part, kind) and not isinstance(part, bool) for part in parts):
                raise ValueError(f"{cls.world}: {name} is {value!r}: give a value like {default!r}")
            if isinstance(default, float):
                given[name] = float(value)
        return cls(**given)

    @classmethod
    def complete(cls, options: Mapping[str, Any]) -> dict[str, Any]:
        """All options by name, those not given as they are by default; errors are those of `of`."""
        return asdict(cls.of(options))


@dataclass(frozen=True)
class FourFlagsConfig(TwoFlagsConfig):
    """Options of `FourFlagsEnv`: those of two flags, with clear ways, and as much time for each flag."""

    world: ClassVar[str] = "FourFlags"
    count: ClassVar[int] = 4
    ways: str = "clear"
    max_steps: int = 6000


@dataclass(frozen=True)
class SixFlagsConfig(TwoFlagsConfig):
    """Options of `SixFlagsEnv`: those of two flags, with clear ways, and as much time for each flag."""

    world: ClassVar[str] = "SixFlags"
    count: ClassVar[int] = 6
    ways: str = "clear"
    max_steps: int = 9000
