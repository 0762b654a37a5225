"""How DPBoost searches: the parts of its recipe that have a name of their own."""

from dataclasses import dataclass

from dpmacro.switching.settings import SwitchSettings

__all__ = ["ORDERS", "RECIPES", "SearchSettings", "paper_switches"]

RECIPES = ("dpmacro", "paper")
ORDERS = ("free", "chain")
STARTS = ("all", "random")
CRITERIA = ("left_out", "loss")


@dataclass(frozen=True)
class SearchSettings:
    """How candidate segmentations are found and which is kept; a value out of range raises ValueError.

    Attributes:
        starts: initial segmentations, "all" kinds (dpmacro/discovery/starts.py) or uniform "random" cuts.
        criterion: what decides, "left_out" data or the training "loss".
        rounds: boosting rounds from every initial segmentation, 1 or more.
        warmup: rounds that keep the labels they start from, half of them at most: relabelling by barely
            trained classifiers forgets a good start. After it the labels are re-estimated every round.
        drawn: random columns searched a round, 1 or more.
        switch_weight: how much the losses of the switch functions count beside those of the actions when
            demonstrations are cut, in nats each; 0 keeps them out.
        held: share of the final fit's rounds in which its labels are held, 0 to 1.
    """

    starts: str = "all"
    criterion: str = "left_out"
    rounds: int = 80
    warmup: int = 30
    drawn: int = 48
    switch_weight: float = 1.0
    held: float = 0.5

    def __post_init__(self) -> None:
        for name, known in (("starts", STARTS), ("criterion", CRITERIA)):
            if getattr(self, name) not in known:
                raise ValueError(f"{name} is {getattr(self, name)!r}: choose one of {', '.join(known)}")
        for name in ("rounds", "drawn"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} is {getattr(self, name)}: give 1 or more")
        if self.warmup < 0:
            raise ValueError(f"warmup is {self.warmup}: give 0 or more")
        if not 0 <= self.switch_weight < float("inf"):
            raise ValueError(f"switch_weight is {self.switch_weight}: give 0 or more, and finite")
        if not 0 <= self.held <= 1:
            raise ValueError(f"held is {self.held}: give 0 to 1")

    @classmethod
    def paper(cls) -> "SearchSettings":
        """The paper's: random cuts, least training loss, switch functions fitted afterwards."""
        return cls(starts="random", criterion="loss", switch_weight=0.0, held=0.0)


def paper_switches(rounds: int, window: int) -> SwitchSettings:
    """Switch functions as in Section IV of the paper.

    The J frames from a change on against all frames of the trajectory before it, both sides weighing the
    same; a function fires where its score is above 0. AdaBoost without shrinkage.
    """
    return SwitchSettings(
        rounds,
        window,
        shrinkage=1.0,
        focused=False,
        whole_past=True,
        calibrated=False,
        cues=False,
        aligned=False,
    )
