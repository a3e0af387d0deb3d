"""What a wheel, a source archive and the conda recipe hold; ``.ci/install_offline.py`` installs them."""

from __future__ import annotations

import os
import re
import runpy
import sys
import tarfile
import tomllib
import zipfile
from email import message_from_bytes
from pathlib import Path

import pytest

import lcp_plugin

ROOT = Path(__file__).parents[2]
TOLD = tomllib.loads(ROOT.joinpath("pyproject.toml").read_text(encoding="utf-8"))
EXTRAS = ("report", "qpsolvers", "pyomo", "global", "fclib", "test")
RELEASED = (
    *("lcp_plugin/__init__.py", "CITATION.cff", "pyproject.toml"),
    *(".ci/conda/recipe.yaml", "examples/manual/CHANGELOG.md"),
)
BUILD, PROJECT = TOLD["build-system"], TOLD["project"]
DEPENDENCIES = [line.partition(";")[0] for line in PROJECT["dependencies"]]
SMALL = 1_300_000  # bytes: nothing but code, which grew by the search for the best solution, SCIP's interface, cones


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """A folder with the wheel and the source archive of this tree."""
    build = pytest.importorskip("hatchling.build")
    folder = tmp_path_factory.mktemp("dist")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(ROOT)
        build.build_wheel(str(folder))
        build.build_sdist(str(folder))
    return folder


@pytest.fixture(scope="module")
def recipe():
    """The conda recipe without its comments."""
    file = ROOT / ".ci" / "conda" / "recipe.yaml"
    if not file.exists():
        pytest.skip("a source archive has no .ci")
    return re.sub(r"^ *#.*\n", "", file.read_text(encoding="utf-8"), flags=re.M)


def sources(folder: str) -> set[str]:
    """The files below a folder of this tree that belong to the project."""
    files = (file for file in ROOT.joinpath(folder).rglob("*") if file.is_file())
    return {
        file.relative_to(ROOT).as_posix()
        for file in files
        if "__pycache__" not in file.parts
        and file.suffix in {".py", ".pyi", ".json", ".html", ".typed", ".jinja2", ".css"}
    }


def test_the_wheel_holds_the_package_and_nothing_else(built):
    """Below 1.15 MB: every module and data file of the package, the licence, the metadata; no test, no example."""
    (wheel,) = built.glob("*.whl")
    assert wheel.stat().st_size < SMALL
    names = set(zipfile.ZipFile(wheel).namelist())
    about = {
        name for name in names if name.startswith(f"lcp_plugin-{lcp_plugin.__version__}.dist-info/")
    }
    assert names - about == sources("lcp_plugin")
    assert any(name.endswith("LICENSE") for name in about)


def test_the_metadata_say_what_the_project_says(built):
    """Version of the package itself, licence, Python, README, and the command with the function behind it."""
    (wheel,) = built.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        folder = f"lcp_plugin-{lcp_plugin.__version__}.dist-info"
        told = message_from_bytes(archive.read(f"{folder}/METADATA"))
        entries = archive.read(f"{folder}/entry_points.txt").decode()
    assert told["Version"] == lcp_plugin.__version__
    assert told["License-Expression"] == "Apache-2.0"
    assert told["Requires-Python"] == PROJECT["requires-python"] == ">=3.11"
    assert told["Description-Content-Type"] == "text/markdown"
    for command, function in PROJECT["scripts"].items():
        assert f"{command} = {function}" in entries
    needed = {
        re.match(r"[\w.-]+", line)[0]
        for line in told.get_all("Requires-Dist")
        if "extra ==" not in line
    }  # type: ignore[index]
    assert needed == {re.match(r"[\w.-]+", line)[0] for line in DEPENDENCIES}  # type: ignore[index]


def test_the_source_archive_can_be_tested(built):
    """It holds the package, every test with its data, every example with its picture, and what the tests read."""
    (archive,) = built.glob("*.tar.gz")
    with tarfile.open(archive) as opened:
        names = {name.partition("/")[2] for name in opened.getnames()}
    needed = sources("lcp_plugin") | sources("tests") | sources("examples")
    needed |= {
        "README.md",
        "LICENSE",
        "CITATION.cff",
        "pyproject.toml",
        "examples/pictures/three_problems.png",
    }
    assert needed <= names


@pytest.mark.full
def test_the_source_archive_builds_the_same_wheel(built, tmp_path, monkeypatch):
    """Byte for byte, from an unpacked archive and an hour later: what is uploaded can be built again by anybody."""
    import hatchling.build

    (wheel,) = built.glob("*.whl")
    (archive,) = built.glob("*.tar.gz")
    with tarfile.open(archive) as opened:
        opened.extractall(tmp_path, filter="data")
    (source,) = tmp_path.iterdir()
    for file in source.rglob("*"):
        os.utime(file, (1e9, 1e9))
    monkeypatch.chdir(source)
    again = tmp_path / hatchling.build.build_wheel(str(tmp_path))
    assert again.name == wheel.name
    assert again.read_bytes() == wheel.read_bytes()


def listed(recipe: str, key: str) -> list[str]:
    """The entries of a list in the recipe."""
    found = re.search(rf"^( *){key}:\n((?:\1 +- .*\n)+)", recipe, re.M)
    assert found is not None
    return [line.strip().removeprefix("- ") for line in found[2].splitlines()]


def test_the_conda_recipe_says_what_the_project_says(recipe):
    """The same version, Python, dependencies, commands, licence and summary; qdldl has another name there."""
    floor = PROJECT["requires-python"].removeprefix(">=")
    assert f'version: "{lcp_plugin.__version__}"' in recipe
    assert f'python_min: "{floor}"' in recipe
    run, host = ({line.replace(" ", "") for line in listed(recipe, key)} for key in ("run", "host"))
    run = {line.replace("qdldl-python", "qdldl") for line in run}
    assert run == {"python>=${{python_min}}", *DEPENDENCIES}
    assert host == {"python${{python_min}}.*", "pip", *BUILD["requires"]}
    assert listed(recipe, "entry_points") == [
        f"{name} = {function}" for name, function in PROJECT["scripts"].items()
    ]
    assert f"license: {PROJECT['license']}\n" in recipe
    assert f'summary: "{PROJECT["description"]}"' in recipe


def test_the_oldest_versions_are_the_floors_of_the_project():
    """``oldest_versions.txt`` pins each dependency, and each extra of the tests, to its floor in pyproject.toml."""
    lines = ROOT.joinpath(".ci", "oldest_versions.txt").read_text(encoding="utf-8").splitlines()
    pins = dict(line.split("==") for line in lines if not line.startswith("#"))
    extras = PROJECT["optional-dependencies"]
    stated = [*DEPENDENCIES, *(line for name in EXTRAS for line in extras[name])]
    floors = dict(line.split(",")[0].split(">=") for line in stated if not line.startswith("lcp"))
    assert set(DEPENDENCIES) <= {f"{name}>={floors[name]}" for name in pins}
    for name, pin in pins.items():
        numbers, floor = pin.split(".")[:3], floors[name].split(".")
        assert numbers == [*floor, "0", "0"][: len(numbers)], name


def test_the_version_is_written_once():
    """pyproject.toml takes the version from the package, and names every Python that it is tested with."""
    assert PROJECT["dynamic"] == ["version"]
    assert "version" not in PROJECT
    tested = {f"Programming Language :: Python :: 3.{minor}" for minor in (11, 12, 13)}
    assert tested <= set(PROJECT["classifiers"])
    assert f"Programming Language :: Python :: 3.{sys.version_info.minor}" in PROJECT["classifiers"]


def test_a_release_with_a_placeholder_is_refused(tmp_path):
    """publish.yml first runs the check, which names each placeholder; with addresses and a dated version it passes."""
    workflows = ROOT / ".github" / "workflows"
    if not workflows.exists():
        pytest.skip("a source archive has no .github")
    steps = workflows.joinpath("publish.yml").read_text("utf-8")
    assert steps.index("python .ci/check_release.py") < steps.index("python -m build")
    find_faults = runpy.run_path(str(ROOT / ".ci" / "check_release.py"))["find_faults"]
    faults = find_faults(ROOT, f"v{lcp_plugin.__version__}")
    assert [name for name, url in PROJECT["urls"].items() if f"{name} = {url} is" in str(faults)]
    for name in RELEASED:
        text = ROOT.joinpath(name).read_text("utf-8").replace(".invalid", ".org")
        text = text.replace(lcp_plugin.__version__, "1.2")
        text = re.sub("(?<=released: )[0-9-]+", "2027-01-01", text)
        file = tmp_path / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text.replace("## [Unreleased]", "## [1.2] - 2027-01-01"), "utf-8")
    assert find_faults(tmp_path, "v1.2") == []
    assert len(find_faults(tmp_path, "v1.3")) == 4


def test_workflow_runs_the_commands_of_the_readme():
    """test.yml has both shell blocks of the README on every system, without the virtual environment."""
    workflow = ROOT / ".github" / "workflows" / "test.yml"
    if not workflow.exists():
        pytest.skip("a source archive has no .github")
    for block in re.findall(
        r"^```bash\n(.*?)^```", ROOT.joinpath("README.md").read_text("utf-8"), re.S | re.M
    ):
        for command in re.split(r" && |\n", block.strip()):
            assert "venv" in command or f"          {command}\n" in workflow.read_text("utf-8")
