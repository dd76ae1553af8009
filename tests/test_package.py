"""The package: quick to import, every name in its place, imports one way."""

import ast
import subprocess
import sys
from functools import cache
from graphlib import TopologicalSorter
from importlib import import_module
from pathlib import Path
from types import FunctionType

import pytest

import omnistereo_lib as osl

ROOT = Path(osl.__file__).resolve().parents[1]

# A package imports only itself and those before it; within the library a file imports from its own
# folder and from those of the lines above. Function-level imports count.
PACKAGES = ("omnistereo_lib", "omnistereo_rigs", "omnistereo_learn", "omnistereo_tools")
PACKAGES += ("course", "workshop")
LAYERS = """
errors lazy progress
arrays
files
pictures
geometry
parse reference
consumer_images ocam_text
rig_file
frame
dataset
stereo
"""
LAYER = {name: number for number, line in enumerate(LAYERS.split("\n")) for name in line.split()}

NEVER = {"matplotlib", "pyvista", "IPython", "bpy", "ipywidgets"}  # by the library
# Slow or large libraries that are imported when used, but for the modules that exist for them.
EAGER = {"cv2": "stereo.sweep"}


def module_name(path):
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


def sources(folder):
    return {module_name(path): path for path in sorted((ROOT / folder).rglob("*.py"))}


@cache
def parse(path):
    return ast.parse(path.read_text(encoding="utf-8"))


def imports(path, inside_functions=True):
    """Yield the full names of the modules that a file imports; those for type checkers aside."""
    nodes = [parse(path)]
    while nodes:
        node = nodes.pop()
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            continue
        if isinstance(node, ast.FunctionDef) and not inside_functions:
            continue
        nodes += ast.iter_child_nodes(node)
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            for alias in node.names:  # a package's module, or a name of a module
                full = f"{node.module}.{alias.name}"
                yield full if full in EVERYTHING else node.module


EVERYTHING = {name: path for package in PACKAGES for name, path in sources(package).items()}


def ours(path, inside_functions=True):
    return {
        name for name in imports(path, inside_functions) if name.split(".")[0] == "omnistereo_lib"
    }


def layer(name):
    return LAYER[name.split(".")[1]]


def test_imports_go_one_way():
    for name, path in EVERYTHING.items():
        package = name.split(".")[0]
        allowed = PACKAGES[: PACKAGES.index(package) + 1]
        for other in imports(path):
            top, *inside = other.split(".")
            assert top not in PACKAGES or top in allowed, f"{name} imports {other}"
            if top == package == "omnistereo_lib" and inside and name != package:
                same_folder = inside[0] == name.split(".")[1]
                assert same_folder or layer(other) < layer(name), f"{name} imports {other}"


def test_every_package_says_who_comes_there():
    folders = {path.parent for path in EVERYTHING.values()}
    for folder in folders:
        assert ast.get_docstring(parse(folder / "__init__.py")), folder


def test_the_command_line_and_its_bar_import_what_is_slow_when_it_is_needed():
    heavy = "{'torch', 'numpy', 'cv2', 'numba', 'matplotlib', 'yaml', 'scipy'}"
    slim = "import sys, omnistereo_tools.cli, omnistereo_tools.progress"
    assert run(f"{slim}; print({heavy} & set(sys.modules))") == "set()"


def test_the_renderer_uses_geometry_and_files_only():
    used = {other for path in sources("workshop/render").values() for other in ours(path)}
    assert {name.split(".")[1] for name in used} <= {"geometry", "errors", "files", "pictures"}
    every = {other for path in sources("workshop/render").values() for other in imports(path)}
    assert not [name for name in every if "omnistereo_tools" in name]  # absent in Blender's Python


def test_there_is_no_circle():
    files = EVERYTHING.items()
    graph = {name: {n for n in imports(path) if n in EVERYTHING} - {name} for name, path in files}
    TopologicalSorter(graph).prepare()


def test_the_library_draws_nothing():
    for name, path in sources("omnistereo_lib").items():
        assert not NEVER & {other.split(".")[0] for other in imports(path)}, name


@pytest.mark.parametrize("library", ["cv2", "yaml", "tifffile", "scipy"])
def test_large_libraries_are_imported_when_used(library):
    eager = {
        name.removeprefix("omnistereo_lib.")
        for name, path in sources("omnistereo_lib").items()
        if library in {i.split(".")[0] for i in imports(path, inside_functions=False)}
    }
    assert eager == set(EAGER.get(library, "").split())


def run(code):
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout.strip()


# What the first cells of notebooks 01 to 03 import, and of 04 and 05 but for the methods.
FIRST_CELLS = """
import omnistereo_lib as osl
from course.classroom.doctor import doctor
from course.exercises import nb01, nb02, nb03, nb04, nb05
from course.figures import drawings, plot, uncertainty
from omnistereo_rigs import Checkerboard, calibrate_camera, calibrate_rig
from omnistereo_rigs.boards import captures, detect
from omnistereo_rigs.doctor import rig_check
osl.load_dataset, osl.load_rig, osl.SphereGrid
"""


def test_notebooks_start_without_what_finds_depth():
    heavy = "{'torch', 'numba', 'psutil', 'simplejpeg', 'pyvista', 'scipy.stats'}"
    assert run(f"import sys{FIRST_CELLS}print({heavy} & set(sys.modules))") == "set()"


def test_the_package_itself_imports_nothing_and_geometry_only_numpy():
    """Blender's interpreter has nothing else."""
    heavy = "{'torch', 'cv2', 'numba', 'matplotlib', 'yaml', 'scipy', 'tifffile', 'psutil'}"
    geometry = "from omnistereo_lib.geometry import camera, pose, rig, sphere"
    package = "import sys, omnistereo_lib; print({'numpy', 'torch'} & set(sys.modules))"
    assert run(f"{package}; {geometry}; print({heavy} & set(sys.modules))") == "set()\nset()"


def test_a_function_is_not_replaced_by_the_module_of_its_name():
    """Python binds imported modules to their package: `osl.sgm` must stay the function."""
    assert osl.estimate_depth and import_module("omnistereo_lib.stereo.sgm") is not osl.sgm
    assert isinstance(osl.sgm, FunctionType)


def test_a_name_that_does_not_exist():
    with pytest.raises(AttributeError, match="no_such_name"):
        osl.no_such_name
