import json
import re
from pathlib import Path

import pytest
import yaml

from elevator_rectify.ros.documentation import all_parameters, parameter_page, parameter_yaml
from elevator_rectify.ros.output import TARGET, TOPICS

ROOT = Path(__file__).parent.parent


def test_parameter_file_is_the_dataclasses() -> None:
    text = (ROOT / "config" / "elevator_rectify.yaml").read_text()
    assert text == parameter_yaml(), (
        "run: python3 -m elevator_rectify.ros.documentation yaml > config/elevator_rectify.yaml"
    )
    loaded = yaml.safe_load(text)["/**/elevator_rectify"]["ros__parameters"]
    assert loaded == {path: default for path, (_, default) in all_parameters().items()}


def test_parameter_page_is_the_dataclasses() -> None:
    assert (ROOT / "docs" / "parameters.md").read_text() == parameter_page(), (
        "run: python3 -m elevator_rectify.ros.documentation page > docs/parameters.md"
    )


def test_pages_link_to_pages_that_exist() -> None:
    for page in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))):
        for link in re.findall(r"\]\(([^)#:]+)\)", page.read_text()):
            assert (page.parent / link).exists(), f"{page.name} links to {link}"
        for name in re.findall(r"`(\w+\.md)`", page.read_text()):
            assert (ROOT / "docs" / name).exists(), f"{page.name} names {name}"


def test_the_readme_is_short() -> None:
    assert len((ROOT / "README.md").read_text().splitlines()) <= 200


@pytest.mark.parametrize("name", ["elevator_rectify.rviz", "elevator_rectify.foxglove.json"])
def test_what_is_shown_is_published(name: str) -> None:
    shown = re.findall(r"/elevator_rectify/([a-z_/]+)", (ROOT / "config" / name).read_text())
    assert len(shown) >= 4
    assert set(shown) <= {*TOPICS, *TARGET}


def test_every_panel_of_the_foxglove_layout_has_its_place() -> None:
    layout = json.loads((ROOT / "config" / "elevator_rectify.foxglove.json").read_text())
    places: list[object] = [layout["layout"]]
    for place in places:
        if isinstance(place, dict):
            places += [place["first"], place["second"]]
    assert sorted(str(p) for p in places if isinstance(p, str)) == sorted(layout["configById"])


@pytest.mark.parametrize("path", sorted((ROOT / "config").glob("*.yaml")), ids=lambda path: path.stem)
def test_a_cameras_file_names_known_parameters(path: Path) -> None:
    loaded = yaml.safe_load(path.read_text())["/**/elevator_rectify"]["ros__parameters"]
    unknown = {name for name in loaded if name not in all_parameters() and not name.startswith("qos_overrides.")}
    assert not unknown
