"""Procedural textures for walls and ground: the same set for everybody, made from one constant seed."""

import colorsys
from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float, UInt8

SIZE = 128
VARIANTS = 4
_SEED = 20120701

Map = Float[np.ndarray, "size size"]
Pattern = Callable[[np.random.Generator, np.ndarray, np.ndarray], np.ndarray]


def textures(hues: Sequence[float] = (0.0, 2 / 3)) -> list[UInt8[np.ndarray, "size size 3"]]:
    """Return the texture set: `VARIANTS` of every pattern, RGB, `SIZE` pixels square, seamless when tiled.

    The patterns are always the same. Colours are greyer the nearer they are to one of `hues`, those of the
    flags, each in [0, 1): by default red and blue. So no surface looks like a flag: no colour in it is a
    saturated red or blue (the greatest channel, if red or blue, stays below 1.8 times the next).
    """
    rng = np.random.default_rng(_SEED)
    grid = (np.arange(SIZE) + 0.5) / SIZE
    u, v = np.meshgrid(grid, grid)
    made = []
    for pattern in _PATTERNS:
        for _ in range(VARIANTS):
            dark, light = _colours(rng, hues)
            blend = np.clip(pattern(rng, u, v) + rng.normal(0, 0.04, u.shape), 0, 1)[..., None]
            made.append(np.rint(255 * (dark + blend * (light - dark))).astype(np.uint8))
    return made


def _colours(
    rng: np.random.Generator, hues: Sequence[float]
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Draw a dark and a light colour of neighbouring hues."""
    hue = rng.random()
    dark = _colour(hue, rng.uniform(0.2, 0.7), rng.uniform(0.3, 0.55), hues)
    light = _colour(hue + rng.uniform(-0.1, 0.1), rng.uniform(0.1, 0.6), rng.uniform(0.7, 0.95), hues)
    return dark, light


def _colour(hue: float, saturation: float, value: float, hues: Sequence[float]) -> Float[np.ndarray, "3"]:
    """Return RGB in [0, 1], greyer the nearer the hue is to one of `hues`."""
    hue %= 1.0
    distance = min(min(abs(hue - flag), 1 - abs(hue - flag)) for flag in hues)
    return np.array(colorsys.hsv_to_rgb(hue, saturation * min(1.0, 0.35 + 6 * distance), value))


def _checker(rng: np.random.Generator, u: Map, v: Map) -> Map:
    n = 2 * rng.integers(1, 5)
    return (np.floor(u * n) + np.floor(v * n)) % 2


def _stripes(rng: np.random.Generator, u: Map, v: Map) -> Map:
    across, along = rng.permutation([rng.integers(2, 6), rng.integers(0, 3)])
    return ((across * u + along * v) % 1 < rng.uniform(0.35, 0.65)).astype(float)


def _zigzag(rng: np.random.Generator, u: Map, v: Map) -> Map:
    fold = np.abs((u * rng.integers(2, 5)) % 1 - 0.5)
    return ((v * rng.integers(3, 6) + fold) % 1 < 0.5).astype(float)


def _bricks(rng: np.random.Generator, u: Map, v: Map) -> Map:
    rows, columns = 2 * rng.integers(3, 6), rng.integers(3, 6)
    row = np.floor(v * rows).astype(int)
    shifted = (u * columns + 0.5 * (row % 2)) % columns
    shade = rng.uniform(0.0, 0.55, (rows, columns))[row, np.floor(shifted).astype(int)]
    mortar = (shifted % 1 < 0.07) | ((v * rows) % 1 < 0.14)
    return np.where(mortar, 1.0, shade)


def _planks(rng: np.random.Generator, u: Map, v: Map) -> Map:
    planks = rng.integers(4, 9)
    board = np.floor(v * planks).astype(int)
    grain = np.sin(2 * np.pi * (rng.integers(1, 3) * u + 3 * v * planks + rng.random(planks)[board]))
    return np.where((v * planks) % 1 < 0.08, 0.0, rng.uniform(0.35, 0.8, planks)[board] + 0.15 * grain)


def _tiles(rng: np.random.Generator, u: Map, v: Map) -> Map:
    n = rng.integers(3, 8)
    shade = rng.uniform(0.2, 1.0, (n, n))[np.floor(v * n).astype(int), np.floor(u * n).astype(int)]
    return np.where(((u * n) % 1 < 0.1) | ((v * n) % 1 < 0.1), 0.0, shade)


def _dots(rng: np.random.Generator, u: Map, v: Map) -> Map:
    n = rng.integers(3, 7)
    return (np.hypot((u * n) % 1 - 0.5, (v * n) % 1 - 0.5) < rng.uniform(0.25, 0.4)).astype(float)


def _smooth_noise(rng: np.random.Generator, u: Map, v: Map) -> Map:
    """Return white noise low-passed in the Fourier domain, hence seamless, stretched to [0, 1]."""
    frequency = np.fft.fftfreq(SIZE) * SIZE
    low_pass = np.exp(-np.add.outer(frequency**2, frequency**2) / (2 * rng.uniform(2, 8) ** 2))
    noise = np.fft.ifft2(np.fft.fft2(rng.normal(size=u.shape)) * low_pass).real
    return (noise - noise.min()) / np.ptp(noise)


def _blobs(rng: np.random.Generator, u: Map, v: Map) -> Map:
    return (_smooth_noise(rng, u, v) > 0.5).astype(float)


_PATTERNS: tuple[Pattern, ...] = (
    _checker,
    _stripes,
    _zigzag,
    _bricks,
    _planks,
    _tiles,
    _dots,
    _smooth_noise,
    _blobs,
)
