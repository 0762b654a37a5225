"""Seconds of a boosting round, and seconds to the accuracy that LightGBM reaches after 300 rounds."""

from collections.abc import Iterator
from typing import Any

from plan import Plan, settled
from report import Row
from stumps import EXACT

__all__ = ["PEERS", "rows", "rows_to_accuracy"]

PEERS: dict[str, tuple[str, dict[str, Any]]] = {
    "LightGBM": ("peers.lightgbm", {}),
    "LightGBM row-wise": ("peers.lightgbm", {"layout": "row"}),
    "XGBoost": ("peers.xgboost", {}),
    "XGBoost, a tree for all classes": ("peers.xgboost", {"trees": "multi_output_tree"}),
    "CatBoost": ("peers.catboost", {}),
    "HistGradientBoosting": ("peers.hist_gradient_boosting", {}),
    "AdaBoost": ("peers.ada_boost", {}),
}
ROUNDS, QUICK_ROUNDS = 300, 30  # of LightGBM, whose held-out accuracy is to be reached
MOST, QUICK_MOST = 2_000, 200  # of ours, trying


def rows(plan: Plan) -> Iterator[Row]:
    """Every peer beside the exact search, then our other learners, on every matrix."""
    for kind in plan.matrices:
        if (found := plan.matrix(kind)) is None:
            continue
        matrix, case = found
        ours = plan.attempt("stumps.ours", matrix=matrix, option=EXACT, rounds=plan.rounds)
        if ours is None:
            continue
        for name in plan.peers:
            function, options = PEERS[name]
            threads = plan.threads
            peer = plan.attempt(function, matrix=matrix, rounds=plan.rounds, threads=threads, **options)
            if peer is None:
                continue
            yield _round(f"{case}, {peer['rounds']} rounds", ours, name, peer)
            yield plan.memory(case, ours, name, peer)
        for option in (option for option in plan.learners if option != EXACT):
            other = plan.attempt("stumps.ours", matrix=matrix, option=option, rounds=plan.rounds)
            if other is None:
                continue
            rounds = min(ours["rounds"], other["rounds"])
            after = {key: ours[key][rounds - 1] for key in ("training_accuracy", "accuracy")}
            exact = ours | after | {"rounds": rounds}
            yield _round(f"{case}, {rounds} rounds, {option}", other, f"ours, {EXACT}", exact)
            yield plan.memory(f"{case}, {option}", other, f"ours, {EXACT}", ours)


def _round(case: str, ours: dict[str, Any], name: str, peer: dict[str, Any]) -> Row:
    """Seconds of a round, and the accuracies after as many rounds as the peer had."""
    return Row(
        "round",
        case,
        settled(ours["seconds"]),
        name,
        settled(peer["seconds"]),
        accuracy=ours["accuracy"][peer["rounds"] - 1],
        peer_accuracy=peer["accuracy"],
        training_accuracy=ours["training_accuracy"][peer["rounds"] - 1],
        peer_training_accuracy=peer["training_accuracy"],
    )


def rows_to_accuracy(plan: Plan) -> Iterator[Row]:
    """Our learners against LightGBM's binning and 300 rounds, once each, on every matrix."""
    rounds, most = (QUICK_ROUNDS, QUICK_MOST) if plan.quick else (ROUNDS, MOST)
    function, options = PEERS["LightGBM"]
    for kind in plan.matrices:
        if (found := plan.matrix(kind)) is None:
            continue
        matrix, case = found
        arguments = {"matrix": matrix, "rounds": rounds, "threads": plan.threads, "patience": None}
        peer = plan.attempt(function, **arguments, **options)
        if peer is None:
            continue
        seconds = peer["binning"] + sum(peer["seconds"])
        for option in plan.learners:
            goal = {"target": peer["accuracy"], "most": most, "limit": seconds}
            ours = plan.attempt("stumps.ours_until", matrix=matrix, option=option, **goal)
            if ours is None:
                continue
            ends = "" if ours["reached"] else f", not reached in {ours['seconds']:.0f} s"
            case_of = f"{case}, {option}, {ours['rounds']} rounds{ends}"
            yield Row(
                "accuracy",
                case_of,
                ours["seconds"] if ours["reached"] else None,
                f"LightGBM, {rounds} rounds",
                seconds,
                accuracy=ours["accuracy"],
                peer_accuracy=peer["accuracy"],
                training_accuracy=ours["training_accuracy"],
                peer_training_accuracy=peer["training_accuracy"],
            )
            yield plan.memory(f"{case}, {option}, to accuracy", ours, f"LightGBM, {rounds} rounds", peer)
