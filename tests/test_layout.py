"""The tree itself: what may lie where, and who may import whom."""

import ast
import importlib.util
import re
import subprocess
import sys
from graphlib import TopologicalSorter
from pathlib import Path

import pytest
from draccus.argparsing import ArgumentParser

REPOSITORY = Path(__file__).resolve().parent.parent
MODULES = sorted((REPOSITORY / "dpmacro").rglob("*.py"))
KNOW_LITTLE = ("utils", "segmentation", "features", "metrics", "worlds")
SCRIPTS = ("train", "eval", "record", "annotate")

# A package may import those before it, and itself; figures are drawn by the packages at the end alone.
ORDER = (
    "parallel",
    "utils",
    "segmentation",
    "features",
    "metrics",
    "data",
    "worlds",
    "boosting",
    "switching",
    "discovery",
    "estimator",
    "policy",
    "annotation",
    "evaluation",
    "training",
)
MAY_IMPORT = {package: {*ORDER[:place], package} for place, package in enumerate(ORDER)}
for _package in ("annotation", "evaluation", "training"):
    MAY_IMPORT[_package].add("figures")
MAY_IMPORT["figures"] = {"utils", "metrics", "segmentation", "data", "figures"}

LONGEST = 300  # lines of a module
ONE_MEANING = ("Search", "ACTIONS", "FOLDS", "MARGIN", "STRETCHES", "PATIENCE")

# What does not keep the rules yet. A line that is no longer true fails: these shrink to nothing.
WRONG_WAY: set[tuple[str, str]] = set()
TOO_LONG: set[str] = set()
MANY_MEANINGS = {"ACTIONS", "PATIENCE"}
MOCKED: set[str] = set()

STARTS = re.compile(r"cli\.run\(main, (\w+)\)")
WITH_OPTIONS = [
    path
    for folder in (".", "datasets", "benchmarks")
    for path in sorted((REPOSITORY / folder).glob("*.py"))
    if STARTS.search(path.read_text())
]


def module_name(path):
    parts = path.relative_to(REPOSITORY).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports(path):
    """Every module that a file imports, wherever in it, with the names it takes from each."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


NAMES = {module_name(path) for path in MODULES}


def own_imports(path):
    return {name for name in imports(path) if name in NAMES - {"dpmacro", module_name(path)}}


def package_of(name):
    return name.split(".")[1]


def defined(path):
    """The names that a module's own statements give to classes, functions and constants."""
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef):
            yield node.name
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names = (name for target in targets for name in ast.walk(target))
            yield from (name.id for name in names if isinstance(name, ast.Name))


def calls(path):
    return {
        node.func.id
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
    }


def test_the_folder_of_scripts_does_not_hide_the_package_datasets():
    assert not (REPOSITORY / "datasets/__init__.py").exists()
    assert not (REPOSITORY / "datasets.py").exists()
    subprocess.run([sys.executable, "-c", "import datasets; datasets.Dataset"], cwd=REPOSITORY, check=True)


@pytest.mark.parametrize("part", KNOW_LITTLE)
def test_the_bottom_knows_little(part):
    bottom = f"dpmacro.{part}"
    files = [path for path in MODULES if (module_name(path) + ".").startswith(bottom + ".")]
    assert files, f"{bottom} is gone"
    for path in files:
        others = {name for name in own_imports(path) if package_of(name) not in (part, "parallel", "utils")}
        assert not others, f"{path.name} imports {others}"


def test_imports_run_one_way():
    # A package's __init__ and its modules may know each other; a circle across files may not be.
    graph = {module_name(path): own_imports(path) for path in MODULES if path.name != "__init__.py"}
    TopologicalSorter(graph).prepare()


def test_every_package_has_its_place():
    found = {path.relative_to(REPOSITORY).parts[1] for path in MODULES} - {"__init__.py"}
    assert found == set(MAY_IMPORT)


def test_packages_import_those_before_them():
    wrong = {
        (module_name(path), name)
        for path in MODULES
        for name in own_imports(path)
        if path.parent.name != "dpmacro" and package_of(name) not in MAY_IMPORT[package_of(module_name(path))]
    }
    assert wrong == WRONG_WAY


def test_no_module_is_too_long():
    long = {module_name(path) for path in MODULES if len(path.read_text().splitlines()) > LONGEST}
    assert long == TOO_LONG


def test_one_name_means_one_thing():
    homes = {name: [] for name in ONE_MEANING}
    for path in MODULES:
        for name in homes.keys() & set(defined(path)):
            homes[name].append(module_name(path))
    assert {name for name, places in homes.items() if len(places) > 1} == MANY_MEANINGS, homes


def test_nothing_is_mocked_outside_the_tests():
    mocking = {
        module_name(path) for path in MODULES if any((n + ".").startswith("unittest.") for n in imports(path))
    }
    assert mocking == MOCKED


@pytest.mark.parametrize("path", MODULES, ids=module_name)
def test_a_module_leaves_the_edge_to_the_scripts(path):
    used = set(imports(path))
    assert not {name for name in used if name.split(".")[0] in SCRIPTS}
    if module_name(path) != "dpmacro.data.lerobot.compat":
        assert not {name for name in used if (name + ".").startswith(("lerobot.datasets.", "datasets."))}
    if module_name(path) != "dpmacro.utils.cli":
        assert not calls(path) & {"print", "input", "exit", "quit"}
        assert not used & {"sys.exit", "argparse", "draccus"}


@pytest.mark.parametrize("path", WITH_OPTIONS, ids=lambda path: path.stem)
def test_every_option_has_a_sentence(path, monkeypatch):
    """Draccus takes a docstring of one line with one colon for the next field, and then shows neither."""
    monkeypatch.syspath_prepend(path.parent)
    specification = importlib.util.spec_from_file_location(f"options_of_{path.stem}", path)
    script = importlib.util.module_from_spec(specification)
    monkeypatch.setitem(sys.modules, specification.name, script)  # dataclasses look their module up
    specification.loader.exec_module(script)
    options = getattr(script, STARTS.search(path.read_text())[1])
    told = {action.option_strings[0]: action.help for action in ArgumentParser(options).parser._actions}
    assert "--config_path" in told and not [name for name, text in told.items() if not (text or "").strip()]
