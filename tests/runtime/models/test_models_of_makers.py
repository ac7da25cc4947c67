"""Models as makers publish them: what of them is read, and which file, link or joint a refusal names."""

import importlib.util
import struct
from pathlib import Path

import numpy as np
import pytest

from phyagentos.errors import DefinitionError
from phyagentos.runtime.models.compiling import compile_model
from phyagentos.runtime.models.robot import build_robot, read_model, read_profile

CORNERS = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]], dtype=np.float32)
FACES = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
INERTIAL = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1"/></inertial>'
BOX = '<collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision>'
JOINT = """<joint name="turn" type="revolute"><parent link="base"/><child link="arm"/>
<axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="30" velocity="2"/></joint>"""
URDF = f"""<robot name="r">
<link name="base"/>
<link name="arm">{INERTIAL}{BOX}</link>
{JOINT}
</robot>"""
MJCF = """<mujoco><compiler meshdir="assets"/><asset>
<mesh name="part" file="part.stl"/></asset><worldbody><body name="base"><geom size="0.1"/>
<body name="arm"><joint name="turn" axis="0 0 1" range="-1 1"/><geom name="link" type="mesh" mesh="part"/>
<geom size="0.01" pos="0.2 0 0"/></body></body></worldbody></mujoco>"""
NARROW = "<body><joint axis='0 0 1' range='-2.5 2.5' limited='true'/><geom size='0.1'/>" * 3 + "</body>" * 3
PROFILE = """target: mine
description: An arm.
model: mine.xml
hand: {model: hand.xml, at: {body: arm}}
end_effector: none
tool: {body: hand/base}
arm: {joints: [turn], home_rad: [0], velocity_rad_s: [1], acceleration_rad_s2: [5], jerk_rad_s3: [500],
  torque_nm: [9], stiffness_nm_rad: [90], damping_nms_rad: [9]}
"""


def write_stl(path: Path, *, is_text: bool = False) -> None:
    path.parent.mkdir(exist_ok=True)
    triangles = [CORNERS[list(face)] for face in FACES]
    if is_text:
        corners = ["\n".join(f"vertex {x} {y} {z}" for x, y, z in each) for each in triangles]
        facets = [f"facet normal 0 0 0\nouter loop\n{each}\nendloop\nendfacet" for each in corners]
        path.write_text("\n".join(("solid part", *facets, "endsolid")))
    else:
        rows = [struct.pack("<12fH", 0, 0, 0, *each.ravel(), 0) for each in triangles]
        path.write_bytes(bytes(80) + struct.pack("<I", len(rows)) + b"".join(rows))


def with_mesh(name: str, tag: str = "collision") -> str:
    return URDF.replace(BOX, f'{BOX}<{tag}><geometry><mesh filename="{name}"/></geometry></{tag}>')


def find_refusal(path: Path, text: str) -> str:
    path.write_text(text)
    with pytest.raises(DefinitionError) as error:
        compile_model(read_model(path).spec, path)
    return str(error.value)


@pytest.mark.parametrize("name", ["assets/part.stl", r"assets\part.stl", "file://{here}/assets/part.stl", "file:///home/other/mine/assets/part.stl",
                                  "package://mine/assets/part.stl", "model://mine/assets/part.stl"])  # fmt: skip
@pytest.mark.parametrize("is_text", [False, True], ids=["binary", "text"])
def test_a_mesh_is_found_by_every_form_of_reference_and_read_in_both_forms(tmp_path, name, is_text):
    (path := tmp_path / "mine" / "r.urdf").parent.mkdir()
    path.write_text(with_mesh(name.format(here=path.parent)))
    write_stl(path.parent / "assets" / "part.stl", is_text=is_text)
    model = compile_model(read_model(path).spec, path)
    assert model.nmesh == 1
    assert np.ptp(model.mesh_vert, axis=0) == pytest.approx((0.1, 0.1, 0.1), abs=1e-6) or model.nmeshvert == 4


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("assets/gone.stl", ("UNREADABLE_FILE", "r.urdf:3", "link 'arm'", "'assets/gone.stl'")),
        ("assets/Part.STL", ("UNREADABLE_FILE", "Did you mean 'assets/part.stl'?")),
        ("package://x/assets/part.STL", ("UNREADABLE_FILE", "Did you mean 'package://x/assets/part.stl'?")),
        ("assets/part.dae", ("MODEL_INVALID", "'assets/part.dae'", "Convert it", "[collada]")),
        ("assets/part.fbx", ("MODEL_INVALID", "'assets/part.fbx'", "Convert it")),
        ("package://x/gone.stl", ("UNREADABLE_FILE", "folder x", "PHYAGENTOS_MODELS")),
        ("assets/torn.stl", ("UNREADABLE_FILE", "r.urdf:3", "'assets/torn.stl', which is torn")),
        ("assets/pointer.stl", ("UNREADABLE_FILE", "r.urdf:3", "git lfs pull")),
    ],
)
def test_a_solid_that_cannot_be_read_is_named_and_a_picture_is_left_out_with_a_remark(
    tmp_path, monkeypatch, name, says
):
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)  # without the extra
    write_stl(tmp_path / "assets" / "part.stl")
    for kind in ("dae", "fbx"):
        (tmp_path / "assets" / f"part.{kind}").write_text("<COLLADA/>")
    (tmp_path / "assets" / "torn.stl").write_bytes(bytes(90))
    (tmp_path / "assets" / "pointer.stl").write_text("version https://git-lfs.github.com/spec/v1\nsize 9\n")
    found = find_refusal(tmp_path / "r.urdf", with_mesh(name))
    assert all(each in found for each in says), found
    (tmp_path / "r.urdf").write_text(with_mesh(name, "visual"))
    assert Path(name).name in read_model(tmp_path / "r.urdf").remarks[0]


@pytest.mark.parametrize("old", ["", "contype", "pair", "include", "attach", "hand"])
def test_the_absent_mesh_of_a_solid_is_never_left_out_of_a_mjcf(tmp_path, old):
    hidden = MJCF.replace('mesh="part"/>', 'mesh="part" contype="0" conaffinity="0"/>')
    texts = {
        "contype": MJCF.replace('mesh="part"/>', 'mesh="part" contype="0"/>'),
        "pair": hidden.replace("</mujoco>", '<contact><pair geom1="link" geom2="link"/></contact></mujoco>'),
        "include": '<mujoco><include file="sub/part.xml"/></mujoco>',
        "attach": '<mujoco><asset><model name="m" file="sub/part.xml"/></asset><worldbody>'
        '<attach model="m" body="base" prefix="m/"/></worldbody></mujoco>',
    }
    (path := tmp_path / "mine" / "mine.xml").parent.mkdir()
    (path.parent / "sub").mkdir()
    (path.parent / "sub" / "part.xml").write_text(MJCF)
    if old == "hand":
        path.write_text(MJCF.replace('<geom name="link" type="mesh" mesh="part"/>', "").replace("<mesh name", "<!--").
                        replace('"part" file="part.stl"/>', "-->"))  # fmt: skip
        (path.parent / "hand.xml").write_text(MJCF)
        (path.parent / "target.yaml").write_text(PROFILE)
        with pytest.raises(DefinitionError, match=r"hand\.xml:2.*UNREADABLE_FILE.*assets/part\.stl"):
            build_robot(*read_profile(path.parent / "target.yaml"))
        return
    assert "UNREADABLE_FILE" in (found := find_refusal(path, texts.get(old, MJCF)))
    assert "part.stl" in found
    path.write_text(hidden)
    assert "part.stl" in read_model(path).remarks[0]
    (path.parent / "assets").mkdir()
    write_stl(path.parent / "assets" / "part.stl", is_text=True)
    path.write_text(MJCF)
    assert compile_model(read_model(path).spec, path).nmesh == 1


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('mass value="1"', 'mass value="0"', ("r.urdf:3", "link 'arm'", "mass")),
        ('ixx="1"', 'ixx="-1"', ("r.urdf:3", "link 'arm'", "inertia")),
        ("0 0 1", "0 0 0", ("r.urdf:4", "joint 'turn'", "axis")),
        ("0 0 1", "0 0", ("r.urdf:5", 'xyz="0 0"', "3 numbers")),
        ('"-1"', '"nan"', ("r.urdf:5", "lower", "a number")),
        ('"-1"', '"2"', ("r.urdf:5", "joint 'turn'", "lower 2 above upper 1")),
        ("revolute", "floating", ("r.urdf:4", "joint 'turn'", 'type="fixed"')),
        ("revolute", "revolut", ("r.urdf:4", "joint 'turn'", "revolute")),
        ('link="base"/><child', 'link="bas"/><child', ("UNKNOWN_NAME (link)", "Did you mean 'base'?")),
        ("</joint>", '<mimic joint="turn"/></joint>', ("joint 'turn' that mimics itself",)),
        ("</joint>", '<mimic joint="trun"/></joint>', ("UNKNOWN_NAME (joint)", "'trun'")),
        ('link name="arm"', 'link name="base"', ("r.urdf:3", "link 'base' twice")),
        ('<inertia ixx="1" iyy="1" izz="1"/>', "", ("r.urdf:3", "link 'arm'", "without inertia")),
        ("</robot>", f"{JOINT.replace('turn', 'more').replace('base', 'arm')}</robot>", ("link 'arm'", "one parent")),
        ('velocity="2"', 'velocity="-2"', ("r.urdf:5", '<limit velocity="-2">', "below zero")),
        ('box size="0.1', 'box size="-0.1', ("r.urdf:3", "<box size=", "below zero")),
        ('box size="0.1 0.1 0.1"', "cone", ("r.urdf:3", "<cone> in link 'arm'", "cylinder")),
        ('size="0.1 0.1 0.1"', 'size="0.1 0 0.1"', ("r.urdf:3", "<box> of link 'arm' without size", "above zero")),
        ('box size="0.1 0.1 0.1"', 'sphere radius="0"', ("r.urdf:3", "<sphere> of link 'arm' without size", "radius")),
        ('"-1"', '"-170"', ("r.urdf:4", "from -170 to 1 rad", "degrees? Then write -2.967 and 0.01745")),
        ("robot", "sdf", ("r.urdf:1", "<sdf>", "<robot>")),
        ("</robot>", "", ("no whole XML: no element found",)),
    ],
)  # fmt: skip
def test_what_no_robot_can_be_made_of_is_named_with_its_line_and_what_to_write(tmp_path, old, new, says):
    assert old in URDF
    found = find_refusal(tmp_path / "r.urdf", URDF.replace(old, new))
    assert all(each in found for each in says), found


@pytest.mark.parametrize(
    ("old", "new", "remark"),
    [
        (INERTIAL + BOX, "", "weighs a gram"),
        (INERTIAL + BOX, "<visual/>", "without size"),
        ("0.1 0.1", "0.1\t0.1", ""),
        ('lower="-1" upper="1"', 'lower="0" upper="0"', "joint 'turn' has no range"),
        ("revolute", "continuous", ""),
        ('"arm"', '"the arm, 2"', ""),
        ('izz="1"', 'izz="1" ixy="1" ixz="1" iyz="1"', "products of inertia"),
    ],
)
def test_what_makers_leave_out_is_filled_in_with_a_remark(tmp_path, old, new, remark):
    (path := tmp_path / "r.urdf").write_text(URDF.replace(old, new))
    source = read_model(path)
    assert compile_model(source.spec, path).nv == 1
    assert remark in "".join(source.remarks)
    assert bool(source.remarks) == bool(remark)


def test_a_mesh_that_encloses_nothing_counts_as_a_shell(tmp_path):
    (tmp_path / "assets").mkdir()
    corners = "\n".join(f"v {x} {y} {z}" for x, y, z in CORNERS)
    (tmp_path / "assets" / "flat.obj").write_text(f"{corners}\nf 1 3 2\n")
    (path := tmp_path / "r.urdf").write_text(with_mesh("assets/flat.obj"))
    spec = read_model(path).spec
    with pytest.raises(ValueError, match="volume"):
        spec.compile()
    assert compile_model(spec, path).nmesh == 1


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("<mujoco><worldbody><body name='a'><joint/></body></worldbody></mujoco>", ("m.xml:1", "link 'a'", "mass")),
        (
            "<mujoco><asset><hfield name='f' file='f.png' size='1 1 1 1'/></asset></mujoco>",
            ("UNREADABLE_FILE", "f.png"),
        ),
        (f"<mujoco><worldbody>{NARROW}</worldbody></mujoco>", ("none turns by more than 5 degrees", "radian")),
        ("<mujoco><include file='gone.xml'/></mujoco>", ("UNREADABLE_FILE", "gone.xml")),
        ("<mujoco><worldbody><geom type='blob'/></worldbody></mujoco>", ("m.xml:1", "'blob'", "<geom>")),
        ("<mujoco>\n<extension><plugin plugin='a.b'/></extension></mujoco>", ("m.xml:2", "plugin a.b")),
        (
            "<mujoco><contact><exclude body1='a' body2='world'/></contact></mujoco>",
            ("m.xml:1", "'a', which nothing in the model is called"),
        ),
        ("<sdf/>", ("<sdf>", "URDF")),
        ("text", ("no whole XML",)),
    ],
)
def test_what_mujoco_refuses_of_a_mjcf_is_said_in_words_of_this_project(tmp_path, text, says):
    found = find_refusal(tmp_path / "m.xml", text)
    assert all(each in found for each in says), found
    assert "Error" not in found


def test_bodies_and_joints_without_a_name_get_one(tmp_path):
    body = "<body><joint/><geom size='0.1'/><body name='body_1'><joint name='joint_0'/><geom size='0.1'/></body></body>"
    (path := tmp_path / "m.xml").write_text(f"<mujoco><worldbody>{body}</worldbody></mujoco>")
    spec = read_model(path).spec
    assert [each.name for each in spec.joints] == ["joint_1", "joint_0"]
    assert [each.name for each in spec.bodies] == ["world", "body_0", "body_1"]
