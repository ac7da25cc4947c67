"""Xacro files: arguments, packages that they name, and every refusal of what expands them."""

import pytest

from phyagentos.errors import DefinitionError
from phyagentos.runtime.models.compiling import compile_model
from phyagentos.runtime.models.robot import read_model

pytest.importorskip("xacrodoc", reason="needs the extra `xacro`: make test-extras")

XACRO = """<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro">
<xacro:arg name="prefix" default="left_"/>
<xacro:include filename="$(find parts)/size.xacro"/>
<link name="base"/>
<link name="$(arg prefix)l1"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1"/></inertial>
<collision><geometry><cylinder radius="${size}" length="$(arg reach)"/></geometry></collision></link>
<joint name="$(arg prefix)j1" type="revolute"><parent link="base"/><child link="$(arg prefix)l1"/>
<axis xyz="0 0 1"/><limit lower="-2" upper="2" effort="10" velocity="$(arg speed)"/></joint>
</robot>"""


@pytest.fixture
def arm(tmp_path):
    (path := tmp_path / "arms" / "urdf" / "arm.urdf.xacro").parent.mkdir(parents=True)
    path.write_text(XACRO)
    (tmp_path / "parts").mkdir()
    size = '<xacro:property name="size" value="0.03"/>'
    (tmp_path / "parts" / "size.xacro").write_text(f'<robot xmlns:xacro="http://www.ros.org/wiki/xacro">{size}</robot>')
    return path


def find_refusal(path, **arguments):
    with pytest.raises(DefinitionError) as error:
        read_model(path, arguments)
    return str(error.value)


def test_arguments_are_given_and_packages_are_found_beside_that_of_the_file(arm):
    spec = read_model(arm, {"reach": "0.2", "speed": "1"}).spec
    model = compile_model(spec, arm)
    assert model.joint(0).name == "left_j1"
    assert model.geom(0).size[:2] == pytest.approx((0.03, 0.1))


@pytest.mark.parametrize("name", ["size.xacro", "../urdf/size.xacro"])
def test_a_file_beside_the_one_that_includes_it_is_found_from_any_working_folder(arm, tmp_path, monkeypatch, name):
    arm.write_text(XACRO.replace("$(find parts)/size.xacro", name))
    (tmp_path / "parts" / "size.xacro").rename(arm.with_name("size.xacro"))
    monkeypatch.chdir(tmp_path)
    assert read_model(arm, {"reach": "0.2", "speed": "1"}).spec.body("left_l1") is not None


def test_all_arguments_that_are_missing_are_named_at_once_with_how_to_give_them(arm):
    found = find_refusal(arm)
    assert "arm.urdf.xacro: MODEL_INVALID: found no value for its arguments 'reach', 'speed'" in found
    assert "--arg reach=VALUE --arg speed=VALUE" in found
    assert "'reach'" not in find_refusal(arm, reach="1")


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("find parts", "find prats", ("UNREADABLE_FILE", "no package 'prats'", "PHYAGENTOS_MODELS")),
        ("/size.xacro", "/gone.xacro", ("MODEL_INVALID", "no file", "gone.xacro")),
        ("${size}", "${sise}", ("'sise', which nothing defines",)),
        ("${size}", "${1/0}", ("cannot be expanded", "division by zero")),
        ("<link name", "<xacro:leg/><link name", ("'leg', which nothing defines",)),
        ("</robot>", "", ("no whole XML",)),
        ("revolute", "revolut", ("joint 'left_j1'", "revolute")),
    ],
)
def test_what_cannot_be_expanded_is_one_problem_of_the_file(arm, old, new, says):
    arm.write_text(XACRO.replace(old, new))
    found = find_refusal(arm, reach="1", speed="1")
    assert all(each in found for each in ("arm.urdf.xacro: ", *says)), found
