"""Print one table of several evaluations, and draw it.

python benchmarks/summary.py --results='outputs/a/eval_info.json outputs/b/eval_info.json' --chart=success.png
"""

import json
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dpmacro import figures
from dpmacro.metrics.success import wilson_interval
from dpmacro.utils import cli


@dataclass(frozen=True)
class SummaryOptions:
    """Which evaluations."""

    results: str
    """eval_info.json files, separated by blanks."""
    chart: Path | None = None
    """Where to draw the table."""


def main(options: SummaryOptions) -> None:
    sections = [json.loads(Path(path).read_text())["dpmacro"] for path in options.results.split()]
    print("\n".join(table(sections)))
    if options.chart is not None:
        outcomes = {section["planner"]: dict(Counter(section["outcomes"])) for section in sections}
        first, last = sections[0]["seeds"][0], sections[0]["seeds"][-1]
        figures.save(figures.success_chart(outcomes, f"Success, seeds {first} to {last}"), options.chart)


def table(sections: list[dict[str, Any]]) -> list[str]:
    """A line for every evaluation: successes, n, rate, 95% Wilson interval, how the failures split."""
    lines = [f"{'planner':<10} {'success':>9} {'rate':>6}  {'95% interval':<15} seeds         failures"]
    for section in sections:
        outcomes = Counter(section["outcomes"])
        successes, runs = outcomes.pop("success", 0), len(section["outcomes"])
        low, high = wilson_interval(successes, runs)
        split = ", ".join(f"{count} {name.replace('_', ' ')}" for name, count in outcomes.most_common())
        seeds = f"{section['seeds'][0]}..{section['seeds'][-1]}"
        lines.append(
            f"{section['planner']:<10} {f'{successes}/{runs}':>9} {successes / runs:>6.0%}  "
            f"{f'{low:.0%} to {high:.0%}':<15} {seeds:<13} {split}"
        )
    return lines


if __name__ == "__main__":
    cli.run(main, SummaryOptions)
