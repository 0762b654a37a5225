"""Table I as markdown: rates, planners side by side in the same worlds, failures, learning curve."""

from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

from report import inserted, markdown
from table_cells import DEFAULT_SIZE, FLAGS, PAPER_SIZE, PLANNERS, SWEEP, TEACHER, TEST
from table_rows import Row, as_json, count, curve_points, groups, paired, pooled, sweep_seed

from dpmacro import figures
from dpmacro.metrics.success import Paired, wilson_interval
from dpmacro.utils.files import replacing
from dpmacro.worlds.base import SUCCESS
from dpmacro.worlds.two_flags.diagnosis import OUTCOMES

__all__ = ["main_table", "marks", "report", "write_report"]

PICTURE = "learning_curve.png"
PAIRS = (
    ("dpboost-2", "baseline"),
    ("dpboost-4", "baseline"),
    ("dpboost-4", "dpboost-2"),
    ("dpboost-2", "paper"),
    ("dpboost-2", TEACHER),
    ("dpboost-2-recovery", "dpboost-2"),
    ("dpboost-2-recovery", TEACHER),
    ("dpboost-4", TEACHER),
    ("dpboost-2-dagger", "dpboost-2"),
    ("dpboost-2-dagger", TEACHER),
    ("paper", "baseline"),
)
POOLED = """\
Successes are pooled over training seeds. The 95% Wilson interval takes all runs for independent, which those
of one policy are not: they share its luck in training. So the rate of every training seed stands beside it.
Beside the teacher: in the worlds that both have run in. The paper's rates are those of its own world."""
COMPARED = """\
A pair is two runs of the same training seed in the same world; the teacher, which has one run a world, stands
in the pair of every training seed. p: exact two-sided McNemar test, which takes pairs for independent."""


def marks(worlds: str) -> tuple[str, str]:
    """What stands before and after the results of a role's worlds in a report."""
    section = "table" if worlds == TEST else worlds
    return f"<!-- {section} -->", f"<!-- /{section} -->"


def write_report(
    found: Row, demonstrations: int, path: Path, rows: str, between: tuple[str, str] = marks(TEST)
) -> None:
    """Put `report` between two marks of a markdown file (new if need be), picture and rows beside it.

    `rows` is the name of the file of rows.

    Raises ValueError where the file has one mark without the other.
    """
    text = inserted(path.read_text() if path.exists() else "", report(found, demonstrations, rows), between)
    seed = sweep_seed(found["rows"])
    points = curve_points(found["rows"], seed)
    if points:
        teacher = groups(found["rows"], "random", demonstrations).get(TEACHER, [])
        levels = {_title(TEACHER): count(row, SWEEP) for row in teacher}
        lines = {_title(name): counts for name, counts in points.items()}
        title = f"Random flags, training seed {seed}, {SWEEP} runs a point"
        figures.save(figures.learning_curve(lines, levels, title), path.parent / PICTURE)
    with replacing(path.with_name(rows)) as temporary:
        temporary.write_text(as_json(found))
    with replacing(path) as temporary:
        temporary.write_text(text)


def report(found: Row, demonstrations: int, rows_name: str) -> str:
    """All tables.

    Args:
        found: {"commit", "date", "command", "machine", "versions", "rows"}.
        demonstrations: that the planners of the main table learn from.
        rows_name: of the file of rows, beside the report.
    """
    rows = found["rows"]
    seed = sweep_seed(rows)
    blocks = [
        list(_origin(found, demonstrations, rows_name)),
        main_table(rows, demonstrations),
        [POOLED],
        _comparisons(rows, demonstrations),
        [COMPARED],
        _failures(rows, demonstrations),
        _curve(rows, seed),
        _rendering(rows, demonstrations, seed),
    ]
    return "\n\n".join("\n".join(block) for block in blocks if block)


def main_table(rows: Sequence[Row], demonstrations: int) -> list[str]:
    """A line for every planner and kind of flags: pooled rate, interval, rate of each training seed."""
    lines = []
    for flags in FLAGS:
        of_planner = groups(rows, flags, demonstrations)
        for name, group in of_planner.items():
            successes, runs = pooled(group)
            rate, paper = _rate(successes, runs), PLANNERS[name].paper.get(flags)
            beside = paired(group, of_planner.get(TEACHER, [])) if name != TEACHER else None
            low, high = wilson_interval(successes, runs)
            lines.append(
                [
                    flags,
                    _title(name),
                    f"{successes} of {runs}",
                    f"{rate:.1%}",
                    f"{low:.1%} to {high:.1%}",
                    ", ".join(f"{_rate(*count(row)):.1%}" for row in group) if name != TEACHER else "",
                    f"{100 * beside.gain:+.1f} points" if beside is not None else "",
                    f"{paper}%" if paper is not None else "",
                ]
            )
    headings = "flags|planner|successes|rate|95% interval|by training seed|beside the teacher|paper"
    return _table(headings, lines)


def _origin(found: Row, demonstrations: int, rows_name: str) -> Iterator[str]:
    seeds = sorted({seed for row in found["rows"] for seed in row["seeds"]})
    commits = sorted({commit for row in found["rows"] for commit in row["commits"]})
    training = sorted({row["train_seed"] for row in found["rows"]} - {None})
    learned = f"training seeds {', '.join(map(str, training)) or 'none'}"
    yield f"{demonstrations} demonstrations unless said; {learned}; test worlds {seeds[0]} to {seeds[-1]},"
    yield "a cell with fewer runs has the first of them."
    yield f"Trained and run at commit {', '.join(commits)}; written {found['date']}."
    yield f"{found['machine']}; {found['versions']}."
    yield f"Every run's outcome is in [{rows_name}]({rows_name}).\n"
    yield f"    {found['command']}"


def _comparisons(rows: Sequence[Row], demonstrations: int) -> list[str]:
    lines = []
    for flags in FLAGS:
        of_planner = groups(rows, flags, demonstrations)
        for first, second in PAIRS:
            compared = paired(of_planner.get(first, []), of_planner.get(second, []))
            if compared is not None:
                lines.append([flags, _title(first), _title(second), *_compared(compared)])
    return _table("flags|first|second|pairs|only the first succeeds|only the second|p", lines)


def _failures(rows: Sequence[Row], demonstrations: int) -> list[str]:
    kinds = [outcome for outcome in OUTCOMES if outcome != SUCCESS]
    lines = []
    for flags in FLAGS:
        for name, group in groups(rows, flags, demonstrations).items():
            counts: Counter[str] = Counter()
            for row in group:
                counts.update(row["outcomes"])
            failures = str(sum(counts[kind] for kind in kinds))
            lines.append([flags, _title(name), failures, *(str(counts[kind]) for kind in kinds)])
    return _table("|".join(["flags|planner|failures", *(kind.replace("_", " ") for kind in kinds)]), lines)


def _curve(rows: Sequence[Row], seed: int) -> list[str]:
    points = curve_points(rows, seed)
    if not points:
        return []
    numbers = sorted({number for counts in points.values() for number in counts})
    lines = [
        [_title(name), *("{} of {}".format(*counts[n]) if n in counts else "" for n in numbers)]
        for name, counts in points.items()
    ]
    picture = f"![Success over the number of demonstrations]({PICTURE})"
    return [picture, "", *_table("|".join(["random flags, demonstrations", *map(str, numbers)]), lines)]


def _rendering(rows: Sequence[Row], demonstrations: int, seed: int) -> list[str]:
    ours, theirs = (
        {
            name: [row for row in group if row["train_seed"] == seed]
            for name, group in groups(rows, "random", demonstrations, size).items()
        }
        for size in (DEFAULT_SIZE, PAPER_SIZE)
    )
    lines = []
    for name, group in theirs.items():
        compared = paired(group, ours.get(name, []), SWEEP)
        if compared is not None:
            rates = ["{} of {}".format(*count(row, SWEEP)) for row in (*group, *ours[name])]
            lines.append([_title(name), *rates, *_compared(compared)])
    default, paper = ("{}x{}".format(*size) for size in (DEFAULT_SIZE, PAPER_SIZE))
    return _table(f"random flags, rendered at|{paper}|{default}|pairs|only {paper}|only {default}|p", lines)


def _rate(successes: int, runs: int) -> float:
    return successes / runs


def _compared(found: Paired) -> list[str]:
    p = "< 0.001" if found.p < 0.001 else f"{found.p:.3f}"
    return [str(found.pairs), str(found.only_first), str(found.only_second), p]


def _title(name: str) -> str:
    return PLANNERS[name].title


def _table(headings: str, lines: Sequence[Sequence[str]]) -> list[str]:
    """Markdown under headings that bars part; nothing where there is no line."""
    return markdown(headings.split("|"), lines)
