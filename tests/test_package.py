"""The package: imported quickly, its names in their places, its imports one way through the stages."""

import ast
import subprocess
import sys
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

import omnistereo_lib as osl

PACKAGE = Path(osl.__file__).parent
SOURCES = {".".join(path.relative_to(PACKAGE).with_suffix("").parts): path for path in PACKAGE.rglob("*.py")}
SOURCES = {name.removesuffix(".__init__"): path for name, path in SOURCES.items() if name != "__init__"}

# In the order in which the data travels. A module imports those of earlier lines and of its own.
STAGES = """
errors
files parsed
camera pose sphere metrics
rig lenses foreign dialects export
calibrate calibrate.board
calibrate.captures
calibrate.detect calibrate.bundle
calibrate.start calibrate.report
calibrate.camera calibrate.rig
sweep
costs costs.zncc costs.weights costs.learned costs.mccnn costs.sweepnet
volume
sgm
depth
dataset pipeline
train.recipes
train.frames
train.spheres train.patches
train.loop
train train.card
sensitivity doctor health plot view3d exercises
render
evaluate.methods evaluate.records evaluate.strata
evaluate.run evaluate.table
evaluate.formulas
evaluate.ledger
evaluate
bench
cli
__main__
"""
STAGE = {name: number for number, line in enumerate(STAGES.split("\n")) for name in line.split()}
UPWARDS = {("camera", "dialects"), ("rig", "dialects")}  # OcamCamera.load and Rig.load, when they are called

# Slow or large libraries, and what needs Blender, stay with the modules that exist for them.
AT_HOME = {
    "matplotlib": {"plot", "view3d"},
    "pyvista": {"view3d"},
    "IPython": {"plot"},
    "bpy": {"render"},
}


def imports(path, inside_functions):
    """Yield the modules that a file imports, `omnistereo_lib.` left out; those for type checkers aside."""
    nodes = [ast.parse(path.read_text())]
    while nodes:
        node = nodes.pop()
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            continue
        if isinstance(node, ast.FunctionDef) and not inside_functions:
            continue
        nodes += ast.iter_child_nodes(node)
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module == "omnistereo_lib":
            yield from (f"omnistereo_lib.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.module


def ours(path, inside_functions=True):
    names = {name for name in imports(path, inside_functions) if name.startswith("omnistereo_lib.")}
    return {name.removeprefix("omnistereo_lib.") for name in names}


def stage(name):
    """The number of a module's stage; everything of the renderer is one stage."""
    return STAGE["render" if name.startswith("render.") else name]


def test_every_module_has_a_stage():
    assert [name for name in SOURCES if name.split(".")[0] != "render" and name not in STAGE] == []


@pytest.mark.parametrize("name", SOURCES)
def test_imports_run_one_way(name):
    for other in ours(SOURCES[name]):
        assert stage(other) <= stage(name) or (name, other) in UPWARDS, f"{name} imports {other}"


def test_no_module_imports_itself_in_a_circle():
    TopologicalSorter({name: ours(path, inside_functions=False) for name, path in SOURCES.items()}).prepare()


@pytest.mark.parametrize("library", AT_HOME)
def test_large_libraries_stay_with_their_modules(library):
    users = {name for name, path in SOURCES.items() if any(i.split(".")[0] == library for i in imports(path, True))}
    assert {name.split(".")[0] for name in users} <= AT_HOME[library]


@pytest.mark.parametrize("library", [*AT_HOME, "cv2", "yaml", "tifffile", "scipy"])
def test_the_largest_are_imported_when_used(library):
    eager = {name for name, path in SOURCES.items() if library in {i.split(".")[0] for i in imports(path, False)}}
    allowed = {
        "cv2": {"sweep", "health", "bench", "calibrate.detect"},
        "scipy": {"lenses", "calibrate.bundle", "calibrate.rig"},
    }
    assert {name for name in eager if not name.startswith("render")} <= allowed.get(library, set())


@pytest.mark.parametrize("name", osl.__all__)
def test_every_name_of_the_face_resolves(name):
    value = getattr(osl, name)
    assert callable(value) and value.__name__ == name and name in dir(osl)


def run(code):
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip()


@pytest.mark.parametrize("name", ["camera", "pose", "sphere", "metrics", "errors"])
def test_the_geometry_needs_numpy_alone(name):
    """Blender's interpreter has nothing else."""
    heavy = "{'torch', 'cv2', 'numba', 'matplotlib', 'pyvista', 'yaml', 'scipy', 'tifffile', 'psutil'}"
    assert run(f"import sys, omnistereo_lib.{name}; print({heavy} & set(sys.modules))") == "set()"


def test_the_package_itself_imports_nothing():
    assert run("import sys, omnistereo_lib; print({'numpy', 'torch'} & set(sys.modules))") == "set()"


@pytest.mark.parametrize("first", ["osl.estimate_depth", "import omnistereo_lib.view3d", "import omnistereo_lib.sgm"])
def test_a_function_is_not_replaced_by_the_module_of_its_name(first):
    """Python binds imported modules to their package: `osl.sgm` must stay the function whatever came before."""
    code = f"import omnistereo_lib as osl\n{first}\nprint(type(osl.sgm).__name__, type(osl.doctor).__name__)"
    assert run(code) == "function function"


def test_a_name_that_does_not_exist():
    with pytest.raises(AttributeError, match="has no attribute 'no_such_name'"):
        osl.no_such_name
