# `make help` lists the targets. PYTHON picks the interpreter (3.11 or 3.12), VENV the environment's folder.

VENV ?= .venv
# Without PYTHON an environment that exists stays as it is.
PYTHON ?= $(if $(wildcard $(VENV)/.installed-*),$(VENV)/bin/python,python3)
VERSION := $(shell $(PYTHON) -c 'import sys; print("%d.%d" % sys.version_info[:2])')
INSTALLED := $(VENV)/.installed-$(VERSION)
PEERS := $(VENV)/.bench-$(VERSION)
SIMULATOR := $(VENV)/.metaworld-$(VERSION)
BIN := $(VENV)/bin
WORKERS ?= 2

.PHONY: help venv test lint types pytest fuzz test-versions test-benchmarks demo clean-demo bench bench-segmentation \
        bench-selectors bench-reading bench-files bench-ranks kills odd-datasets table table-metaworld lerobot-metaworld
.DEFAULT_GOAL := help

help: ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "make %-18s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

venv: $(INSTALLED) ## build the environment in .venv (make venv PYTHON=python3.12 for another Python)

# PyBullet built in pip's isolated environment would come out without numpy and render eight times slower.
$(INSTALLED): pyproject.toml
	@case "$(VERSION)" in 3.11|3.12) ;; \
	  *) echo "error: $(PYTHON) is Python '$(VERSION)': give PYTHON=python3.11 or PYTHON=python3.12" >&2; exit 2;; esac
	test -e $@ || $(PYTHON) -m venv --clear $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet 'setuptools>=77,<81' wheel 'numpy>=2.0,<2.3'
	$(BIN)/python -m pip install --quiet --no-build-isolation 'pybullet>=3.2.7'
	$(BIN)/python -m pip install --quiet --editable '.[dev]'
	touch $@

test: lint types pytest ## lint, types and all tests but those of make test-benchmarks

lint: $(INSTALLED)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(INSTALLED)
	$(BIN)/mypy

# A module's tests stay in one process, since they share what takes long to build; tests/conftest.py orders the modules.
TESTS := $(BIN)/python -m pytest -n $(WORKERS) --dist loadscope --no-loadscope-reorder
SHAPES := --jaxtyping-packages=dpmacro,beartype.beartype

pytest: $(INSTALLED)
	$(TESTS) $(SHAPES) -m 'not benchmark'

# What another LeRobot or Python may break: datasets read and written, options, scripts, worlds, a training.
VERSIONS := tests/annotation/exports tests/data tests/scripts tests/worlds tests/policy/lerobot tests/utils/test_cli.py tests/test_layout.py tests/training/test_train.py
ONE_TRAINING := 'not test_train.py or mistake or spoiled or folder_holds or tensorboard or in_a_run or process_itself'

test-versions: $(INSTALLED) ## the tests that depend on the versions of Python and LeRobot
	$(TESTS) -m 'not benchmark' -k $(ONE_TRAINING) $(VERSIONS)

CASES ?= 500

fuzz: $(INSTALLED) ## damage files in every way: CASES random cases of each test, 500 by default
	FUZZ_CASES=$(CASES) $(BIN)/python -m pytest -s tests/fuzz

test-benchmarks: $(PEERS) ## whole benchmarks in small, with the other libraries (make test leaves these out)
	$(TESTS) $(SHAPES) -m benchmark

# The demo: every stage is a file, so that a second call reuses what exists.
DEMO := outputs/demo
DATASET := datasets/two_flags_random
EPISODES ?= 50
SEED ?= 10000
PLANNERS := teacher baseline dpboost
EVAL := $(DEMO)/eval/$(EPISODES)-from-$(SEED)
RESULTS := $(PLANNERS:%=$(EVAL)/%/eval_info.json)
# Runs of an earlier policy are done anew; an evaluation that was interrupted goes on.
evaluate = $(if $<,[ $(@D)/runs.jsonl -nt $< ] || rm -rf $(@D); )$(BIN)/python eval.py --episodes=$(EPISODES) --seed=$(SEED) --workers=$(WORKERS) --output_dir=$(@D)

demo: $(RESULTS) ## record 20 demonstrations, train baseline and DPBoost, run both and the teacher, print one table
	$(BIN)/python benchmarks/summary.py --results='$(RESULTS)' --chart=$(DEMO)/success.png
	@echo "pictures     $(DEMO)/success.png, $(DEMO)/train/dpboost/figures"
	@echo "TensorBoard  $(BIN)/tensorboard --logdir=$(DEMO)"

$(DATASET)/meta/info.json: | $(INSTALLED)
	$(BIN)/python datasets/record.py --root=$(DATASET) --episodes=20 --seed=0 --workers=$(WORKERS)

$(DEMO)/train/%/checkpoints/last/pretrained_model/config.json: $(DATASET)/meta/info.json
	rm -rf $(DEMO)/train/$*
	$(BIN)/python train.py --dataset.root=$(DATASET) --planner.type=$* --planner.recovery=true --output_dir=$(DEMO)/train/$*

# The teacher sees positions, not pixels: small pictures save its time and change nothing.
$(EVAL)/teacher/eval_info.json: | $(INSTALLED)
	$(evaluate) --policy.type=teacher --world.render_size='[64,48]'

$(EVAL)/%/eval_info.json: $(DEMO)/train/%/checkpoints/last/pretrained_model/config.json
	$(evaluate) --policy.path=$(<D)

.SECONDARY:
.DELETE_ON_ERROR:

clean-demo: ## remove what make demo made
	rm -rf $(DEMO) $(DATASET)

SMALL := --quick=true --matrices='[pixels, random]'

bench: $(PEERS) $(DATASET)/meta/info.json ## measure against other libraries (make bench QUICK=1 for small data)
	$(BIN)/python benchmarks/bench.py --dataset=$(DATASET) --threads=$(WORKERS) $(if $(QUICK),$(SMALL)) $(BENCH)

BABYAI := datasets/babyai
LEVELS := $(addprefix BabyAI-,GoToSeqS5R2-v0 UnlockLocal-v0 PutNextS5N2-v0 PickupAbove-v0 UnlockPickup-v0 SynthS5R2-v0)
LEVELS := $(LEVELS:%=$(BABYAI)/%/meta/info.json)

METAWORLD := datasets/metaworld
TASKS := $(addsuffix -v3,pick-place assembly coffee-push drawer-close hammer)
TASKS := $(TASKS:%=$(METAWORLD)/%/meta/info.json)
# Datasets that others made: MOCAP=folder of mocap6, CR5=folder of the CR5 arm with a banana.
OTHERS = $(if $(MOCAP),--mocap=$(MOCAP)) $(if $(CR5),--cr5=$(CR5))

bench-segmentation: $(PEERS) $(DATASET)/meta/info.json $(LEVELS) $(TASKS) ## compare segmentations with other methods' where the truth is known (QUICK=1 likewise)
	$(BIN)/python benchmarks/bench_segmentation.py --two_flags=$(DATASET) --babyai=$(BABYAI) --metaworld=$(METAWORLD) $(OTHERS) $(if $(QUICK),--quick=true) $(BENCH)

bench-selectors: $(INSTALLED) $(DATASET)/meta/info.json $(LEVELS) ## which criterion tells the true segmentation from other candidates (hours; QUICK=1 likewise)
	$(BIN)/python benchmarks/bench_selectors.py --two_flags=$(DATASET) --babyai=$(BABYAI) $(if $(QUICK),--quick=true) $(BENCH)

# DATA=folder of a LeRobot dataset with videos; without it both generate one in outputs.
bench-reading: $(INSTALLED) ## how fast videos are read, beside PyAV's bare decoding (DATA=a dataset; QUICK=1 a small one)
	$(BIN)/python benchmarks/reading.py --threads=$(WORKERS) $(if $(DATA),--dataset.root=$(DATA)) $(if $(QUICK),--frames=300 --repeats=1) $(BENCH)

FEW := --frames=200 --cameras=1 --size='[160,120]' --length=50 --options='--planner.rounds=5 --planner.restarts=2 --planner.macros=2'

bench-files: $(INSTALLED) ## from files to labels and pictures: time by stages, and memory (DATA=a dataset; QUICK=1 a small one)
	$(BIN)/python benchmarks/files_to_pictures.py $(if $(DATA),--dataset.root=$(DATA)) $(if $(QUICK),$(FEW)) $(BENCH)

bench-ranks: $(INSTALLED) ## boosting on several ranks: time, bytes, memory, and whether all find the same (QUICK=1 likewise)
	$(BIN)/python benchmarks/ranks.py $(if $(QUICK),--frames=5000 --columns=100) $(BENCH)

kills: $(INSTALLED) ## kill every script at random moments and see that nothing is lost (QUICK=1 three times each)
	$(BIN)/python benchmarks/kills.py --kills=$(if $(QUICK),3,20) $(BENCH)

odd-datasets: $(INSTALLED) ## what dpmacro and the installed LeRobot make of odd datasets, into docs/odd_datasets.md
	$(BIN)/python benchmarks/odd_datasets.py --report=docs/odd_datasets.md

# A quick table is printed only: docs/results.md holds the whole one.
table: $(INSTALLED) ## success of teacher, baseline and DPBoost, into docs/results.md (hours; QUICK=1 a coarse table in minutes)
	$(BIN)/python benchmarks/table1.py --workers=$(WORKERS) $(if $(QUICK),--quick=true,--report=docs/results.md) $(TABLE)

$(BABYAI)/%/meta/info.json: | $(INSTALLED)
	$(BIN)/python datasets/record.py --root=$(BABYAI)/$* --world.id=$* --workers=$(WORKERS) --episodes=100 --seed=0

$(METAWORLD)/%/meta/info.json: | $(SIMULATOR)
	$(BIN)/python datasets/record.py --root=$(METAWORLD)/$* --world.id=Meta-World/$* --workers=$(WORKERS) --episodes=50 --noise=0.1 --seed=0

table-metaworld: $(PEERS) $(SIMULATOR) ## policies in Meta-World beside other learners, into docs/metaworld.md (a day; BENCH=--rows='[dpmacro, trees]' for some)
	$(BIN)/python benchmarks/table_metaworld.py --workers=$(WORKERS) --report=docs/metaworld.md $(BENCH)

lerobot-metaworld: $(SIMULATOR) ## a policy in LeRobot's own Meta-World, by stock lerobot-eval (half an hour; BENCH=--task=... for another task)
	$(BIN)/python benchmarks/lerobot_metaworld.py $(BENCH)

$(SIMULATOR): $(INSTALLED)
	$(BIN)/python -m pip install --quiet --editable '.[metaworld]'
	touch $@

$(PEERS): $(INSTALLED)
	$(BIN)/python -m pip install --quiet --editable '.[bench]'
	touch $@
