"""What is there is reused, what is not is made, what was made by other options is made anew."""

import io
import json
import shutil
import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tqdm import tqdm

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "benchmarks"))  # as the script itself finds its neighbours

import table_cells  # noqa: E402
import table_runs  # noqa: E402
from table_cells import Cell, demonstrations_needed  # noqa: E402
from table_jobs import forget  # noqa: E402
from table_runs import CHUNK, Runs, chunks, work  # noqa: E402

TEACHER = Cell("fixed", "teacher", 0, None, 60)
BASELINE = Cell("random", "baseline", 5, 1, 120)
MORE = Cell("random", "baseline", 10, 1, 30)


class Scripts:
    """Stands for the scripts: writes the files that tell, remembers what it was asked for."""

    def __init__(self):
        self.jobs = []
        self.learned = lambda job: job.folder.name.encode()

    def __call__(self, job, commit, threads, moved):
        self.jobs.append(job)
        forget(job.folder)
        job.folder.mkdir(parents=True)
        given = dict(option[2:].split("=", 1) for option in (*job.options, *job.others))
        if job.script == "datasets/record.py":
            size = json.loads(given["world.render_size"])
            write(job.folder / "meta/info.json", {"total_episodes": int(given["episodes"])})
            world = {"flags": given["world.flags"], "render_size": size}
            write(job.folder / "meta/dpmacro.json", {"world": world})
        if job.script == "train.py":
            policy = job.folder / "checkpoints/last/pretrained_model"
            write(
                policy / "config.json",
                {"thresholds": [0.5], "cues": [[0]], "max_transitions": len(job.options)},
            )
            (policy / "model.safetensors").write_bytes(self.learned(job))
        if job.script == "eval.py":
            seeds = list(range(int(given["seed"]), int(given["seed"]) + int(given["episodes"])))
            outcomes = ["success" if seed % 3 else "red_first" for seed in seeds]
            write(job.folder / "eval_info.json", {"dpmacro": {"seeds": seeds, "outcomes": outcomes}})
            moved(len(seeds) // 2)
        stamp = {"options": list(job.options), "command": job.script, "commit": commit, "seconds": 1.0}
        write(job.folder.with_name(job.folder.name + ".json"), stamp)
        return stamp

    def did(self):
        """What was done since it was last asked, the folder's name with it."""
        done = [f"{job.script} {job.folder.name}" for job in self.jobs]
        self.jobs = []
        return done


def write(path, values):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(values))


@pytest.fixture
def scripts(monkeypatch):
    fake = Scripts()
    monkeypatch.setattr(table_runs, "run", fake)
    return fake


def runs_of(folder, *plan, commit="abc"):
    needed = demonstrations_needed(plan)
    with tqdm(total=work(plan, needed), file=io.StringIO()) as bar:
        runs = Runs(folder, 1, 1, commit, needed, bar)
        found = [runs.outcomes(cell) for cell in plan]
        assert bar.n == bar.total
    return found


def test_everything_is_made_once(tmp_path, scripts):
    first = runs_of(tmp_path, TEACHER, BASELINE, MORE)
    assert scripts.did() == [
        "eval.py 10000-10049",
        "eval.py 10050-10059",
        "datasets/record.py random_1",
        "train.py random_1_baseline_5",
        "eval.py 10000-10049",
        "eval.py 10050-10099",
        "eval.py 10100-10119",
        "train.py random_1_baseline_10",
        "eval.py 10000-10029",
    ]
    for (outcomes, stamps), cell in zip(first, (TEACHER, BASELINE, MORE), strict=True):
        assert list(outcomes) == list(cell.worlds)
        assert outcomes[10002] == "red_first" and outcomes[10001] == "success"
        assert {stamp["commit"] for stamp in stamps} == {"abc"}
        assert (stamps[0]["command"] == "train.py") == (cell.train_seed is not None)
    again = runs_of(tmp_path, TEACHER, BASELINE, MORE, commit="def")
    assert scripts.did() == [] and again == first


def test_a_longer_cell_runs_what_is_missing_only(tmp_path, scripts):
    runs_of(tmp_path, replace(BASELINE, episodes=30))
    scripts.did()
    [(outcomes, _)] = runs_of(tmp_path, BASELINE)
    assert scripts.did() == ["eval.py 10030-10049", "eval.py 10050-10099", "eval.py 10100-10119"]
    assert len(outcomes) == 120
    [(outcomes, _)] = runs_of(tmp_path, replace(BASELINE, episodes=10))
    assert scripts.did() == [] and len(outcomes) == 10


def test_what_was_interrupted_is_done_again(tmp_path, scripts):
    runs_of(tmp_path, BASELINE)
    scripts.did()
    (tmp_path / "eval/random_1_baseline_5/10050-10099.json").unlink()
    runs_of(tmp_path, BASELINE)
    assert scripts.did() == ["eval.py 10050-10099"]
    (tmp_path / "train/random_1_baseline_5.json").unlink()
    runs_of(tmp_path, BASELINE)
    assert scripts.did()[0] == "train.py random_1_baseline_5"


def test_other_options_train_and_run_anew(tmp_path, scripts, monkeypatch, capsys):
    runs_of(tmp_path, BASELINE)
    scripts.did()
    tuned = replace(
        table_cells.PLANNERS["baseline"], options=("--planner.type=baseline", "--planner.rounds=9")
    )
    monkeypatch.setitem(table_cells.PLANNERS, "baseline", tuned)
    runs_of(tmp_path, BASELINE)
    assert "random_1_baseline_5 was trained by other options" in capsys.readouterr().out
    assert scripts.did() == [
        "train.py random_1_baseline_5",
        "eval.py 10000-10049",
        "eval.py 10050-10099",
        "eval.py 10100-10119",
    ]


def test_too_few_demonstrations_are_recorded_anew_and_policies_stay(tmp_path, scripts, capsys):
    runs_of(tmp_path, BASELINE)
    scripts.did()
    runs_of(tmp_path, MORE, BASELINE)
    assert "holds 5 demonstrations of 10: all are recorded anew" in capsys.readouterr().out
    assert scripts.did() == [
        "datasets/record.py random_1",
        "train.py random_1_baseline_10",
        "eval.py 10000-10029",
    ]


def test_demonstrations_of_another_world_are_an_error(tmp_path, scripts):
    runs_of(tmp_path, replace(BASELINE, flags="fixed"))
    shutil.copytree(tmp_path / "data/fixed_1", tmp_path / "data/random_1")
    with pytest.raises(ValueError, match=r"random_1 was recorded with flags=fixed, not random: remove it$"):
        runs_of(tmp_path, BASELINE)


@given(st.sets(st.integers(10_000, 10_300)))
def test_chunks_are_consecutive_and_end_at_multiples(seeds):
    found = list(chunks(sorted(seeds)))
    assert [seed for chunk in found for seed in chunk] == sorted(seeds)
    for chunk in found:
        assert chunk == list(range(chunk[0], chunk[-1] + 1))
        assert chunk[0] // CHUNK == chunk[-1] // CHUNK
    for left, right in pairwise(found):
        assert right[0] != left[-1] + 1 or right[0] % CHUNK == 0


def test_policies_that_are_the_same_bit_for_bit_share_their_runs(tmp_path, scripts):
    two, four, baseline = (Cell("random", name, 5, 1, 60) for name in ("dpboost-2", "dpboost-4", "baseline"))
    scripts.learned = lambda job: b"baseline" if "baseline" in job.folder.name else b"dpboost"
    found = runs_of(tmp_path, two, four, baseline)
    assert found[0][0] == found[1][0]
    done = scripts.did()
    assert done.count("eval.py 10000-10049") == 2
    assert sum(job.startswith("train.py") for job in done) == 3
    more = Cell("random", "dpboost-4", 5, 1, 100)
    runs_of(tmp_path, more)
    assert scripts.did() == ["eval.py 10060-10099"]
    assert (tmp_path / "eval" / four.name).exists()


def test_recovery_runs_the_policy_that_is_there_and_keeps_its_runs_apart(tmp_path, scripts):
    plain, recovering = (Cell("random", name, 5, 1, 60) for name in ("dpboost-2", "dpboost-2-recovery"))
    runs_of(tmp_path, plain)
    scripts.did()
    runs_of(tmp_path, recovering)
    asked = [job.options for job in scripts.jobs]
    assert scripts.did() == ["eval.py 10000-10049", "eval.py 10050-10059"]
    assert all("--policy.recovery=true" in options for options in asked)
    assert f"--policy.path={tmp_path}/train/{plain.name}/checkpoints/last/pretrained_model" in asked[0]
    runs_of(tmp_path, plain, recovering)
    assert scripts.did() == []
    # Whatever comes first trains the policy, and runs of one that goes are those of both.
    (tmp_path / "train" / f"{plain.name}.json").write_text(
        json.dumps({"options": [], "command": "", "commit": "", "seconds": 0})
    )
    runs_of(tmp_path, recovering, plain)
    assert scripts.did() == [
        "train.py random_1_dpboost-2_5",
        *["eval.py 10000-10049", "eval.py 10050-10059"] * 2,
    ]


def test_a_twin_of_the_policy_lends_the_runs_of_the_same_planner_only(tmp_path, scripts):
    four, plain, recovering = (
        Cell("random", name, 5, 1, 50) for name in ("dpboost-4", "dpboost-2", "dpboost-2-recovery")
    )
    scripts.learned = lambda job: b"same"
    runs_of(tmp_path, four)
    scripts.did()
    runs_of(tmp_path, plain)
    assert scripts.did() == ["train.py random_1_dpboost-2_5"]
    runs_of(tmp_path, recovering)
    assert scripts.did() == ["eval.py 10000-10049"]


def test_fresh_worlds_are_run_beside_the_others(tmp_path, scripts):
    runs_of(tmp_path, BASELINE)
    scripts.did()
    [(outcomes, _)] = runs_of(tmp_path, replace(BASELINE, episodes=60, role="fresh"))
    assert scripts.did() == ["eval.py 40000-40049", "eval.py 40050-40059"]
    assert list(outcomes) == list(range(40_000, 40_060))


@pytest.mark.parametrize("other", [{"thresholds": [0.6]}, {"cues": [[0, 1]]}, {"made later": 1}])
def test_policies_that_decide_otherwise_do_not(tmp_path, scripts, other):
    two, four = (Cell("random", name, 5, 1, 30) for name in ("dpboost-2", "dpboost-4"))
    scripts.learned = lambda job: b"same"
    runs_of(tmp_path, two)
    scripts.did()
    folder = tmp_path / "train" / two.name
    config = folder / "checkpoints/last/pretrained_model/config.json"
    write(config, json.loads(config.read_text()) | other)
    runs_of(tmp_path, four)
    assert [job for job in scripts.did() if job.startswith("eval.py")]


def test_stamps_are_those_of_the_cells_own_worlds(tmp_path, scripts):
    first, more = (replace(BASELINE, episodes=episodes) for episodes in (50, 100))
    runs_of(tmp_path, first)
    [(_, stamps)] = runs_of(tmp_path, more, commit="def")
    assert [stamp["commit"] for stamp in stamps] == ["abc", "abc", "def"]  # training, and runs of 50 worlds
    [(_, stamps)] = runs_of(tmp_path, first, commit="ghi")
    assert [stamp["commit"] for stamp in stamps] == ["abc", "abc"]
