import ast
from pathlib import Path

PACKAGE = Path(__file__).parent.parent / "elevator_rectify"


def imported(path: Path) -> set[str]:
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            names.add(node.module or "")
    return names


def test_the_core_knows_neither_ros_nor_the_programs() -> None:
    files = sorted((PACKAGE / "core").rglob("*.py"))
    assert len(files) > 8
    for path in files:
        for name in imported(path):
            own = not name.startswith("elevator_rectify") or name.startswith("elevator_rectify.core")
            assert own and not name.startswith(("rcl", "ros")) and "_msgs" not in name, f"{path.name} imports {name}"


def test_the_ros_layer_does_not_know_the_programs() -> None:
    for path in sorted((PACKAGE / "ros").rglob("*.py")):
        for name in imported(path):
            allowed = ("elevator_rectify.core", "elevator_rectify.ros")
            assert not name.startswith("elevator_rectify") or name.startswith(allowed), f"{path.name} imports {name}"


def test_replay_needs_no_rclpy() -> None:
    for module in (
        "recordings/replay",
        "ros/bag",
        "recordings/report",
        "recordings/make_bag",
        "render/bag",
        "ros/answer",
        "ros/convert",
        "ros/output",
        "ros/pairing",
    ):
        assert not any(name.startswith("rclpy") for name in imported(PACKAGE / f"{module}.py")), module
