"""Files of corrections: the JSON that the page saves, and tables as the export `csv` writes them.

Both are strangers' files: every value is checked before it is used, and an error is one line that names the
file, the place in it, the value and what to do.
"""

import csv
import io
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dpmacro.annotation.naming import checked_names
from dpmacro.utils.checks import shown

__all__ = ["FORMAT", "CorrectedEpisode", "CorrectionFile", "read_corrections"]

FORMAT = "dpmacro corrections 1"
TABLES = (".csv", ".tsv")
LARGEST_FILE = 2**24  # bytes: corrections of a hundred thousand segments have fewer
LARGEST_NUMBER = 2**53  # what JavaScript counts exactly
DELIMITERS = ",;\t"
COLUMNS = ("episode", "start_frame", "end_frame", "label")  # those that a table needs
PERSON = "person"  # the source of a segment that a person said


@dataclass(frozen=True)
class CorrectedEpisode:
    """The segments of one demonstration, which follow one another from its first frame to its last.

    Attributes:
        episode: its number in the dataset.
        ends: frame after the last one of every segment, rising; the last is the number of frames.
        labels: stage of every segment, a place in the file's names.
        by_person: whether the file says that a person said all of them.
        seconds: when every segment begins, as the file has it; None where it does not say.
        places: where in the file every segment stands.
    """

    episode: int
    ends: tuple[int, ...]
    labels: tuple[int, ...]
    by_person: bool
    seconds: tuple[float | None, ...]
    places: tuple[str, ...]

    @property
    def starts(self) -> tuple[int, ...]:
        """First frame of every segment."""
        return (0, *self.ends[:-1])


@dataclass(frozen=True)
class CorrectionFile:
    """What a file of corrections says.

    Attributes:
        names: of the stages, as they are to be.
        episodes: in the order of the file, each once.
        renamed: of every stage as it was the place in `names` that it has now; None in a table.
        has_sources: whether the file says who said a segment.
        dataset: the dataset's name, "" where the file does not say.
        fps: frames a second; None where the file does not say.
    """

    names: tuple[str, ...]
    episodes: tuple[CorrectedEpisode, ...]
    renamed: tuple[int, ...] | None
    has_sources: bool
    dataset: str = ""
    fps: float | None = None


def read_corrections(path: Path) -> CorrectionFile:
    """Read a file of corrections: a table where it is called *.csv or *.tsv, else JSON.

    Raises ValueError for a file that is no such one or is wrong in any place, and OSError where it cannot be
    read.
    """
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file; give the one that the page saved, or a labels.csv")
    if not path.is_file():
        raise ValueError(f"{path}: is no file; give the one that the page saved, or a labels.csv")
    with path.open("rb") as file:
        content = file.read(LARGEST_FILE + 1)
    if len(content) > LARGEST_FILE:
        raise ValueError(f"{path}: has more than {LARGEST_FILE:,} bytes; corrections are smaller")
    is_table = path.suffix.lower() in TABLES
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        remedy = "save it as CSV UTF-8" if is_table else "save it from the page again"
        raise ValueError(f"{path}: byte {error.start} is no UTF-8; {remedy}") from error
    return _read_table(path, text) if is_table else _read_json(path, text)


def _read_json(path: Path, text: str) -> CorrectionFile:
    def refuse(value: Any) -> None:
        raise ValueError(f"{value} is no number of JSON")

    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        found = dict(pairs)
        if len(found) < len(pairs):
            raise ValueError(f"an object has a key twice, among {shown([key for key, _ in pairs])}")
        return found

    try:
        found = json.loads(text, parse_constant=refuse, object_pairs_hook=unique)
    except (ValueError, RecursionError) as error:
        problem = " ".join(str(error).split())
        raise ValueError(f"{path}: is no JSON ({problem}); save it from the page again") from error
    if not isinstance(found, dict) or found.get("format") != FORMAT:
        said = found.get("format") if isinstance(found, dict) else found
        raise ValueError(
            f"{path}, format is {shown(said)}: give a file of format {FORMAT!r}, as the page saves"
        )
    names = checked_names(found.get("names"), what=f"{path}, names")
    if not names:
        raise ValueError(f"{path}, names is []: name one stage at least")
    dataset, fps = found.get("dataset", ""), found.get("fps")
    if not isinstance(dataset, str):
        raise ValueError(f"{path}, dataset is {shown(dataset)}: give its name")
    if isinstance(fps, bool) or not isinstance(fps, int | float) or not 0 < fps <= LARGEST_NUMBER:
        raise ValueError(f"{path}, fps is {shown(fps)}: give the frames of a second, above 0")
    renamed = _renamed(path, found.get("renamed"), len(names))
    listed = found.get("episodes")
    if not isinstance(listed, list):
        raise ValueError(f"{path}, episodes is {shown(listed)}: give a list of corrected demonstrations")
    episodes: dict[int, CorrectedEpisode] = {}
    for place, one in enumerate(listed):
        own = _json_episode(f"{path}, episodes[{place}]", one, len(names))
        if own.episode in episodes:
            raise ValueError(
                f"{path}, episodes[{place}].episode is {own.episode}: it is there twice, keep one"
            )
        episodes[own.episode] = own
    return CorrectionFile(names, tuple(episodes.values()), renamed, True, dataset, float(fps))


def _renamed(path: Path, pairs: Any, count: int) -> tuple[int, ...]:
    """What became of stage 0, 1, ..., each listed once."""
    if not isinstance(pairs, list) or not pairs:
        raise ValueError(f"{path}, renamed is {shown(pairs)}: give [old number, new number] for every stage")
    found: dict[int, int] = {}
    for place, pair in enumerate(pairs):
        where = f"{path}, renamed[{place}]"
        if not isinstance(pair, list) or len(pair) != 2:
            raise ValueError(f"{where} is {shown(pair)}: give [old number, new number]")
        old, new = (
            _whole(f"{where}[{k}]", one, most)
            for k, one, most in zip((0, 1), pair, (len(pairs), count), strict=True)
        )
        if old in found:
            raise ValueError(f"{where}[0] is {old}: it is there twice, name every stage as it was once")
        found[old] = new
    return tuple(found[old] for old in range(len(pairs)))


def _json_episode(where: str, one: Any, n_names: int) -> CorrectedEpisode:
    if not isinstance(one, dict):
        raise ValueError(f"{where} is {shown(one)}: give an object with episode, frames and segments")
    episode = _whole(f"{where}.episode", one.get("episode"))
    frames = _whole(f"{where}.frames", one.get("frames"))
    listed = one.get("segments")
    if not isinstance(listed, list) or not listed:
        raise ValueError(f"{where}.segments is {shown(listed)}: give a list of one segment at least")
    ends: list[int] = []
    labels: list[int] = []
    places: list[str] = []
    for place, own in enumerate(listed):
        inside = f"{where}.segments[{place}]"
        if not isinstance(own, dict):
            raise ValueError(f"{inside} is {shown(own)}: give an object with start, end and label")
        start, end = (_whole(f"{inside}.{name}", own.get(name)) for name in ("start", "end"))
        _check_follows(f"{inside}.start", f"{inside}.end", start, end, ends[-1] if ends else 0)
        ends.append(end)
        labels.append(_whole(f"{inside}.label", own.get("label"), n_names))
        places.append(inside)
    if ends[-1] != frames:
        raise ValueError(f"{places[-1]}.end is {ends[-1]}: the demonstration has {frames} frames, end there")
    return CorrectedEpisode(episode, tuple(ends), tuple(labels), True, (None,) * len(ends), tuple(places))


def _check_follows(start_name: str, end_name: str, start: int, end: int, before: int) -> None:
    """Raise ValueError where a segment does not begin at the end of the one before, or has no frame."""
    if start != before:
        kind = "a gap" if start > before else "an overlap"
        raise ValueError(
            f"{start_name} is {start}: that leaves {kind}, segments have to follow, give {before}"
        )
    if end <= start:
        raise ValueError(
            f"{end_name} is {end}: a segment that starts at {start} ends at {start + 1} or later"
        )


def _whole(where: str, value: Any, below: int = LARGEST_NUMBER) -> int:
    """A whole number of 0 or more, below a limit."""
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < below:
        wanted = "0 or more" if below == LARGEST_NUMBER else f"0 to {below - 1}"
        raise ValueError(f"{where} is {shown(value)}: give a whole number, {wanted}")
    return value


@dataclass(frozen=True)
class _Row:
    """A line of a table."""

    where: str
    episode: int
    start: int
    end: int
    label: str
    second: float | None
    source: str


def _read_table(path: Path, text: str) -> CorrectionFile:
    by_episode: dict[int, list[_Row]] = {}
    names: dict[str, int] = {}
    has_sources = False
    try:
        for row in _rows(path, text):
            by_episode.setdefault(row.episode, []).append(row)
            names.setdefault(row.label, len(names))
            has_sources |= bool(row.source)
    except csv.Error as error:
        raise ValueError(f"{path}: is no table ({error}); save it as CSV UTF-8") from error
    if not by_episode:
        raise ValueError(f"{path}: has no line with a segment; give one for each at least")
    for name in names:
        where = next(row.where for rows in by_episode.values() for row in rows if row.label == name)
        checked_names([name], what=f"{where}: labels")
    checked_names(list(names), what=f"{path}: labels")
    episodes = [_table_episode(episode, rows, names) for episode, rows in by_episode.items()]
    return CorrectionFile(tuple(names), tuple(episodes), None, has_sources)


def _rows(path: Path, text: str) -> Iterator[_Row]:
    head = text.split("\n", 1)[0]
    delimiter = max(DELIMITERS, key=head.count)
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, strict=True)
    columns = {name.strip().lower().replace(" ", "_"): place for place, name in enumerate(next(reader, []))}
    missing = [name for name in COLUMNS if name not in columns]
    if missing:
        raise ValueError(
            f"{path}, line 1 is {shown(head)}: give the columns {', '.join(COLUMNS)}; {missing[0]} is missing"
        )
    for cells in reader:
        where = f"{path}, line {reader.line_num}"
        if not any(cell.strip() for cell in cells):
            continue
        values = {name: cells[place].strip() if place < len(cells) else "" for name, place in columns.items()}
        episode, start, end = (_cell(f"{where}, {name}", values[name]) for name in COLUMNS[:3])
        second = _second(values.get("start_s", ""))
        yield _Row(where, episode, start, end, values["label"], second, values.get("source", "").lower())


def _cell(where: str, text: str) -> int:
    """A whole number as spreadsheets write it, "57" or "57.0"."""
    digits = text.removesuffix(".0").removesuffix(",0")
    if not (digits.isascii() and digits.isdecimal()) or len(digits) > 15:
        raise ValueError(f"{where} is {shown(text)}: give a whole number, 0 or more")
    return int(digits)


def _second(text: str) -> float | None:
    """Seconds, with a point or a comma; None for anything else: frames alone say where a segment is."""
    try:
        return float(text.replace(",", "."))
    except ValueError:
        return None


def _table_episode(episode: int, rows: Sequence[_Row], names: dict[str, int]) -> CorrectedEpisode:
    ordered = sorted(rows, key=lambda row: (row.start, row.end))
    before = 0
    for row in ordered:
        _check_follows(f"{row.where}, start_frame", f"{row.where}, end_frame", row.start, row.end, before)
        before = row.end
    return CorrectedEpisode(
        episode,
        tuple(row.end for row in ordered),
        tuple(names[row.label] for row in ordered),
        all(row.source == PERSON for row in ordered),
        tuple(row.second for row in ordered),
        tuple(row.where for row in ordered),
    )
