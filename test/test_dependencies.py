"""The rooms of the package: which may know which, and that nothing imports in a circle."""

from __future__ import annotations

import ast
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parent.parent / "elevator_rectify"
# A room may import itself and the rooms of the rows above its own, never those beside or below it.
ROWS = (
    ("core.types", "core.config"),
    ("core.compiled", "core.robust"),
    ("core.geometry",),
    ("core.detections", "core.paper", "core.lattice", "core.reading", "core.view", "core.detector", "core.lamps"),
    ("core.confidence", "core.track", "core.self_calibration"),
    ("core.result",),
    ("core.picture",),
    ("core.outline", "core.known"),
    ("core.attempts",),
    ("core.left_out",),
    ("core.pipeline",),
    ("core.find", "core.warm_up"),
    ("core",),
    ("ros", "progress", "share", "threads", "train"),
    ("arguments",),
    ("render",),
    ("recordings",),
    ("benchmark", "live"),
    ("calibrate",),
    ("programs",),
    ("__main__",),
)
RANK = {room: row for row, rooms in enumerate(ROWS) for room in rooms}
FILES = sorted(path for path in PACKAGE.rglob("*.py") if path != PACKAGE / "__init__.py")


def imported(path: Path) -> set[str]:
    """Return all that the file imports, in functions and for type checkers too."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            module = node.module or ""
            whole = PACKAGE.parent / module.replace(".", "/")
            names |= {f"{module}.{a.name}" for a in node.names if (whole / f"{a.name}.py").exists()} or {module}
    return names


def own_imports(path: Path) -> set[str]:
    """Return the package's modules that the file imports, without the package's own name."""
    start = "elevator_rectify."
    return {name.removeprefix(start) for name in imported(path) if name.startswith(start)}


def module_of(path: Path) -> str:
    name = ".".join(path.relative_to(PACKAGE).with_suffix("").parts)
    return name.removesuffix(".__init__")


def room_of(module: str) -> str:
    """Return the folder of a module, or the module itself where it stands on the core's or package's own floor."""
    parts = module.split(".")
    return ".".join(parts[:2]) if parts[0] == "core" else parts[0]


@pytest.mark.parametrize("path", FILES, ids=module_of)
def test_a_room_imports_only_rooms_above_it(path: Path) -> None:
    room = room_of(module_of(path))
    for name in own_imports(path):
        other = room_of(name)
        assert room == other or RANK[other] < RANK[room], f"{module_of(path)} imports {name}"


def test_no_module_imports_itself_by_way_of_others() -> None:
    TopologicalSorter({module_of(path): own_imports(path) for path in FILES}).prepare()


def test_the_core_knows_no_ros() -> None:
    files = [path for path in FILES if path.is_relative_to(PACKAGE / "core")]
    assert len(files) > 30
    for path in files:
        for name in imported(path):
            assert not name.startswith(("rcl", "ros")) and "_msgs" not in name, f"{path.name} imports {name}"


def test_only_training_knows_torch() -> None:
    for path in FILES:
        if not path.is_relative_to(PACKAGE / "train"):
            assert not any(name.split(".")[0] == "torch" for name in imported(path)), path


def test_replay_needs_no_rclpy() -> None:
    without = [path for path in FILES if path.is_relative_to(PACKAGE / "recordings") and path.stem != "play"]
    for module in ("bag", "answer", "convert", "output", "pairing"):
        without.append(PACKAGE / "ros" / f"{module}.py")
    for path in [*without, PACKAGE / "render" / "bag.py"]:
        assert not any(name.startswith("rclpy") for name in imported(path)), path
