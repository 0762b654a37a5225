"""Tiny convolutional networks as weak learners: ten thousand weights that see a frame and what has moved.

A weak hypothesis h is trained on Z = sum_n sum_m w_n^m exp(-y_n^m h^m(x_n)), the loss that adding it to the
strong classifier leaves: Schapire and Singer (1999) choose confidence-rated hypotheses so, and stumps are
chosen so. The other way, functional gradient boosting (Mason et al. 2000, Friedman 2001), fits h to the
direction w y and searches its length afterwards, but every output of a bounded network that follows the
direction alone ends at the bound. Z sets direction and length together: its gradient at h = 0 is the
functional gradient, and its minimum is half the log-odds of the weights.

A hyperbolic tangent bounds the outputs, so no hypothesis multiplies a frame's loss by more than exp(BOUND).
There is no line search: on the demonstrations' training frames it never shortened a trained hypothesis (the
factors were 1.2 to 4), and `Boosting` leaves out one that raises the loss.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Float, Int64, Shaped, UInt8
from torch import Tensor
from torch.nn import functional

from dpmacro.boosting.learners.base import HEAVIEST, Frames, StrongClassifier, overflow
from dpmacro.boosting.losses.base import Loss
from dpmacro.boosting.losses.classes import ExponentialLoss
from dpmacro.utils.stages import storable

__all__ = ["ConvNetClassifier", "ConvNetLearner", "ConvNets"]

CLASSES = ExponentialLoss()
BOUND = 2.0  # on the outputs of a weak hypothesis
STRIDE = 2  # of the first convolution
KERNEL = 3  # side of both
CHUNK_FRAMES = 64  # what they fill stays in a cache
ACTIVATIONS = 2**22  # of the first convolution, for a chunk of frames


@storable
@dataclass(frozen=True)
class ConvNets:
    """Networks of the same shape side by side: convolution, convolution, a linear vote for every class."""

    first: Float[Tensor, "*nets narrow 6 kernel kernel"]
    first_bias: Float[Tensor, "*nets narrow"]
    second: Float[Tensor, "*nets wide narrow kernel kernel"]
    second_bias: Float[Tensor, "*nets wide"]
    head: Float[Tensor, "*nets classes wide rows columns"]
    head_bias: Float[Tensor, "*nets classes"]

    @classmethod
    def random(
        cls, channels: tuple[int, int], n_classes: int, size: tuple[int, int], generator: torch.Generator
    ) -> "ConvNets":
        """One network for reduced images of `size`: variances of He et al. (2015), the head's near zero."""
        narrow, wide = channels
        rows, columns = (-(-side // STRIDE) for side in size)

        def normal(*shape: int, gain: float = 2.0) -> Tensor:
            deviation = (gain / torch.Size(shape[1:]).numel()) ** 0.5
            return torch.randn(shape, generator=generator) * deviation

        return cls(
            normal(narrow, 6, KERNEL, KERNEL),
            torch.zeros(narrow),
            normal(wide, narrow, KERNEL, KERNEL),
            torch.zeros(wide),
            normal(n_classes, wide, rows, columns, gain=0.01),
            torch.zeros(n_classes),
        )

    @classmethod
    def stack(cls, nets: list["ConvNets"]) -> "ConvNets":
        """Networks, or stacks of them, along a new first axis."""
        return cls(*(torch.stack(parts) for parts in zip(*map(_parts, nets), strict=True)))

    def votes(self, pixels: Float[Tensor, "frames 6 height width"]) -> Float[Tensor, "frames nets classes"]:
        """Votes of a stack of networks with one leading axis, within -BOUND..BOUND."""
        n_nets = len(self.first)
        maps = functional.conv2d(
            pixels, self.first.flatten(0, 1), self.first_bias.flatten(), STRIDE, KERNEL // 2
        ).relu_()
        maps = functional.conv2d(
            maps, self.second.flatten(0, 1), self.second_bias.flatten(), 1, KERNEL // 2, groups=n_nets
        ).relu_()
        seen = maps.unflatten(1, (n_nets, -1)).flatten(2)
        unbounded = torch.einsum("fnk,nmk->fnm", seen, self.head.flatten(2)) + self.head_bias
        return BOUND * (unbounded / BOUND).tanh()


@storable
@dataclass(frozen=True)
class ConvNetClassifier:
    """Strong classifiers made of networks: f^m(x) = sum_t step_t h_t^m(x)."""

    first: Float[Tensor, "rounds problems narrow 6 kernel kernel"]
    first_bias: Float[Tensor, "rounds problems narrow"]
    second: Float[Tensor, "rounds problems wide narrow kernel kernel"]
    second_bias: Float[Tensor, "rounds problems wide"]
    head: Float[Tensor, "rounds problems classes wide rows columns"]
    head_bias: Float[Tensor, "rounds problems classes"]
    steps: Float[Tensor, "rounds problems"]
    kind = "convnet"

    def select(self, problems: Int64[Tensor, " selected"]) -> "ConvNetClassifier":
        """The strong classifiers of just these problems, in this order."""
        return ConvNetClassifier(*(part[:, problems] for part in _parts(self)))

    def scores(self, frames: Frames) -> Float[Tensor, "frames problems classes"]:
        """f^m(x) of every frame, problem and class. Raises ValueError for frames without images."""
        if frames.images is None or frames.previous is None:
            raise ValueError("frames without images: convnets look at the image and the one before it")
        *parts, steps = (part.flatten(0, 1) for part in _parts(self))
        pair = reduced(frames.images), reduced(frames.previous)
        outputs = _outputs(ConvNets(*parts), *pair, torch.arange(len(pair[0]), device=steps.device))
        return (outputs * steps[:, None]).unflatten(1, self.steps.shape).sum(1)

    def used_columns(self) -> Int64[Tensor, " used"]:
        """None: networks look at images."""
        return torch.zeros(0, dtype=torch.int64, device=self.steps.device)

    def renumbered(self, columns: Int64[Tensor, " kept"]) -> "ConvNetClassifier":
        """The same classifiers: feature columns mean nothing to them."""
        return self

    def tensors(self) -> dict[str, Tensor]:
        """What defines the classifiers, for a file."""
        return dict(vars(self))


@dataclass(frozen=True)
class ConvNetLearner:
    """Trains a network for every problem and round, from new random weights.

    A problem's batches hold the frames that have weight in it, drawn in proportion to their weight
    (stratified: an epoch draws as many frames as have weight, each as often as its share says, give or take
    one). So Z is estimated without bias, and the few positive frames of a switch function, which hold half
    the weight, fill half of every batch.

    Args:
        images: the training frames.
        previous: which frame was seen before each; the first of a trajectory is its own predecessor.
        epochs: passes over a problem's frames in a round.
        batch: frames of a gradient step.
        rate: learning rate of Adam, which falls linearly to zero within the round.
        channels: outputs of the two convolutions.

    Raises ValueError for options and images that cannot be.
    """

    images: UInt8[Tensor, "frames height width 3"]
    previous: Int64[Tensor, " frames"]
    epochs: int = 1
    batch: int = 16
    rate: float = 2e-3
    channels: tuple[int, int] = (16, 16)

    def __post_init__(self) -> None:
        if min(self.images.shape[1:3]) < 2:
            raise ValueError(f"images are {tuple(self.images.shape[1:3])}: give 2 x 2 pixels or more")
        if min(self.epochs, self.batch, *self.channels) < 1 or not self.rate > 0:
            raise ValueError(
                f"epochs {self.epochs}, batch {self.batch}, channels {self.channels}, rate {self.rate}: "
                "give 1 or more, and a rate above 0"
            )

    @property
    def n_frames(self) -> int:
        """The number of training frames."""
        return len(self.images)

    @property
    def device(self) -> torch.device:
        """Where the images are."""
        return self.images.device

    def shown(
        self, strong: StrongClassifier, n_frames: int, size: int
    ) -> tuple[StrongClassifier, Iterator[Frames]]:
        """The classifiers, and the first training frames as they look at them, `size` at a time."""
        parts = (slice(k, min(k + size, n_frames)) for k in range(0, n_frames, size))
        return strong, (self._frames(part) for part in parts)

    def _frames(self, part: slice) -> Frames:
        images = self.images[part]
        return Frames(images.new_empty(0, len(images)), images, self.images[self.previous[part]])

    def fit(
        self,
        weights: Float[Tensor, "frames problems width"],
        responses: Shaped[Tensor, "frames #problems outputs"],
        generator: torch.Generator,
        memory: None = None,
        loss: Loss = CLASSES,
    ) -> tuple[ConvNets, None]:
        """A newly trained network for every problem; it votes 0 in a problem whose frames have no weight."""
        if not bool((weights.sum((0, 2)) < HEAVIEST).all()):  # nor where one is NaN
            raise ValueError(overflow(weights))
        all_responses = responses.expand(-1, weights.shape[1], -1).unbind(1)
        pairs = zip(weights.unbind(1), all_responses, strict=True)
        return ConvNets.stack([self._train(*pair, loss, generator) for pair in pairs]), None

    @torch.no_grad()
    def outputs(self, hypotheses: ConvNets) -> Float[Tensor, "frames problems classes"]:
        """h^m(x) of the training frames."""
        return _outputs(hypotheses, self._reduced, self._reduced, self.previous)

    def strong(self, rounds: list[ConvNets], steps: Float[Tensor, "rounds problems"]) -> ConvNetClassifier:
        """sum_t step_t h_t of the rounds that have any step; of the first where none has."""
        used = steps.ne(0).any(1)
        used[0] |= ~used.any()
        kept = ConvNets.stack([nets for nets, use in zip(rounds, used.tolist(), strict=True) if use])
        return ConvNetClassifier(**vars(kept), steps=steps[used].to(self.device))

    @cached_property
    def _reduced(self) -> UInt8[Tensor, "frames half_height half_width 3"]:
        return reduced(self.images)

    @torch.enable_grad()
    def _train(
        self,
        weights: Float[Tensor, "frames width"],
        responses: Shaped[Tensor, "frames outputs"],
        loss: Loss,
        generator: torch.Generator,
    ) -> ConvNets:
        """One network that leaves little of the loss; its parameters need no gradient any more."""
        size = (self._reduced.shape[1], self._reduced.shape[2])
        start = ConvNets.random(self.channels, responses.shape[1], size, generator)
        frame_weights = weights.sum(1)
        held = frame_weights.nonzero()[:, 0]
        if not len(held):
            return ConvNets(*(torch.zeros_like(part, device=self.device) for part in _parts(start)))
        parameters = [part[None].to(self.device).requires_grad_() for part in _parts(start)]
        nets, optimiser = ConvNets(*parameters), torch.optim.Adam(parameters, self.rate)
        batches = [
            batch
            for _ in range(self.epochs)
            for batch in held[_drawn(frame_weights[held], generator)].split(self.batch)
        ]
        schedule = torch.optim.lr_scheduler.LinearLR(optimiser, 1.0, 0.0, len(batches))
        for batch in batches:
            outputs = nets.votes(_pixels(self._reduced[batch], self._reduced[self.previous[batch]]))[:, 0]
            shares = weights[batch] / frame_weights[batch, None]
            losses = loss.remaining(shares, responses[batch], outputs)
            optimiser.zero_grad()
            losses.sum(1).mean().backward()
            optimiser.step()
            schedule.step()
        return ConvNets(*(parameter.detach()[0] for parameter in parameters))


def reduced(
    images: UInt8[Tensor, "frames height width 3"],
) -> UInt8[Tensor, "frames half_height half_width 3"]:
    """Images of half the size: rounded means of 2 x 2 pixels; an odd last row or column is left out."""
    height, width = (side // 2 * 2 for side in images.shape[1:3])
    result = images.new_empty(len(images), height // 2, width // 2, 3)
    for half, whole in zip(result.split(CHUNK_FRAMES), images.split(CHUNK_FRAMES), strict=True):
        sums = whole[:, :height:2, :width].to(torch.int16) + whole[:, 1:height:2, :width]
        half.copy_((sums[:, :, ::2] + sums[:, :, 1::2] + 2) // 4)
    return result


def _parts(nets: ConvNets | ConvNetClassifier) -> list[Tensor]:
    return list(vars(nets).values())


def _pixels(
    now: UInt8[Tensor, "frames height width 3"], before: UInt8[Tensor, "frames height width 3"]
) -> Float[Tensor, "frames 6 height width"]:
    """Colours, and their differences to the image before, about -2..2; channels last in memory."""
    colours = now.float()
    return torch.cat([(colours - 127.5) / 64, (colours - before) / 32], 3).permute(0, 3, 1, 2)


def _outputs(
    nets: ConvNets,
    images: UInt8[Tensor, "seen height width 3"],
    others: UInt8[Tensor, "others height width 3"],
    previous: Int64[Tensor, " seen"],
) -> Float[Tensor, "seen nets classes"]:
    """Votes on every image; `others[previous]` are the images before."""
    maps = nets.first.shape[:2].numel() * images.shape[1] * images.shape[2] // STRIDE**2
    frames = torch.arange(len(images), device=images.device)
    chunks = frames.split(max(1, min(ACTIVATIONS // max(maps, 1), CHUNK_FRAMES)))
    return torch.cat([nets.votes(_pixels(images[chunk], others[previous[chunk]])) for chunk in chunks])


def _drawn(weights: Float[Tensor, " held"], generator: torch.Generator) -> Int64[Tensor, " held"]:
    """As many places as there are weights, each drawn in proportion to its weight, in random order.

    Systematic: one place from every equal part of the total weight.
    """
    shift = torch.rand(1, generator=generator, dtype=torch.float64)
    order = torch.randperm(len(weights), generator=generator)
    ends = weights.cumsum(0, dtype=torch.float64)
    marks = ((order + shift) / len(order)).to(weights.device) * ends[-1]
    return torch.searchsorted(ends, marks, right=True).clamp(max=len(ends) - 1)
