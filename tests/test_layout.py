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
KNOW_NOBODY = ("worlds", "features", "quantising", "segmentation", "learners", "metrics", "outcomes")
SCRIPTS = ("train", "eval", "record", "record_babyai", "annotate")

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


@pytest.mark.parametrize("part", KNOW_NOBODY)
def test_the_bottom_knows_nobody(part):
    bottom = f"dpmacro.{part}"
    files = [path for path in MODULES if (module_name(path) + ".").startswith(bottom + ".")]
    assert files, f"{bottom} is gone"
    for path in files:
        others = {name for name in own_imports(path) if not (name + ".").startswith(bottom + ".")}
        assert not others, f"{path.name} imports {others}"


def test_imports_run_one_way():
    # A package's __init__ and its modules may know each other; a circle across files may not be.
    graph = {module_name(path): own_imports(path) for path in MODULES if path.name != "__init__.py"}
    TopologicalSorter(graph).prepare()


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
