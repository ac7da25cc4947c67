"""Solids in COLLADA: all triangles of the scene, in metres; what cannot be read is refused, a picture left out."""

import numpy as np
import pytest

from phyagentos.errors import DefinitionError
from phyagentos.runtime.models.compiling import compile_model
from phyagentos.runtime.models.robot import read_model

pytest.importorskip("collada", reason="needs the extra `collada`: make test-extras")
pytestmark = pytest.mark.filterwarnings("ignore:the matrix subclass:PendingDeprecationWarning")  # of the package

# Two meshes, the second a polygon list moved by its node: a pyramid of 100 mm with its tip on an edge 200 mm away.
COLLADA = """<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit meter="0.001" name="millimeter"/><up_axis>Y_UP</up_axis></asset>
<library_geometries>{geometries}</library_geometries>
<library_visual_scenes><visual_scene id="scene">
<node id="first"><instance_geometry url="#a"/></node>
<node id="second"><translate>0 0 200</translate><instance_geometry url="#b"/></node>
</visual_scene></library_visual_scenes><scene><instance_visual_scene url="#scene"/></scene></COLLADA>"""
GEOMETRY = """<geometry id="{name}"><mesh><source id="{name}p"><float_array id="{name}f" count="12">
0 0 0 100 0 0 0 100 0 0 0 100</float_array><technique_common><accessor source="#{name}f" count="4" stride="3">
<param name="X" type="float"/><param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common>
</source><vertices id="{name}v"><input semantic="POSITION" source="#{name}p"/></vertices>{faces}</mesh></geometry>"""
INPUT = '<input semantic="VERTEX" source="#{name}v" offset="0"/>'
FACES = "0 2 1 0 1 3 0 3 2 1 2 3"
TRIANGLES = f'<triangles count="4">{INPUT}<p>{FACES}</p></triangles>'
POLYGONS = f'<polylist count="4">{INPUT}<vcount>3 3 3 3</vcount><p>{FACES}</p></polylist>'
URDF = """<robot name="r"><link name="base"/><link name="arm">
<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1"/></inertial>
<{tag}><geometry><mesh filename="part.dae" scale="2 2 2"/></geometry></{tag}>
<collision><geometry><sphere radius="0.01"/></geometry></collision></link>
<joint name="turn" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="30" velocity="2"/></joint></robot>"""


@pytest.fixture
def arm(tmp_path):
    parts = {"a": TRIANGLES, "b": POLYGONS}
    shown = "".join(GEOMETRY.format(name=name, faces=faces.format(name=name)) for name, faces in parts.items())
    (tmp_path / "part.dae").write_text(COLLADA.format(geometries=shown))
    (path := tmp_path / "r.urdf").write_text(URDF.format(tag="collision"))
    return path


def test_all_meshes_of_a_scene_are_one_solid_in_metres_as_its_nodes_and_the_link_place_them(arm):
    model = compile_model(read_model(arm).spec, arm)
    corners = model.mesh_vert @ _turn(model) + model.mesh_pos[0]
    assert corners.min(axis=0) == pytest.approx((0.0, 0.0, 0.0), abs=1e-6)
    assert corners.max(axis=0) == pytest.approx((0.2, 0.2, 0.6), abs=1e-6)


def _turn(model):
    import mujoco

    mujoco.mju_quat2Mat(R := np.empty(9), model.mesh_quat[0])
    return R.reshape(3, 3).T


@pytest.mark.parametrize("text", ["<COLLADA", "<COLLADA/>", COLLADA.format(geometries="")])
def test_a_file_that_holds_no_solid_is_refused_by_its_name(arm, text):
    arm.with_name("part.dae").write_text(text)
    with pytest.raises(DefinitionError, match=r"part\.dae: MODEL_INVALID: found a COLLADA file that cannot be read"):
        read_model(arm)


def test_a_picture_is_left_out_whether_or_not_it_could_be_read(arm):
    arm.write_text(URDF.format(tag="visual"))
    source = read_model(arm)
    assert "left out of pictures: part.dae" in source.remarks[0]
    assert not source.spec.meshes
