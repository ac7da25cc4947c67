"""`paos robot new`: a draft from a model, which the profile names so that it is found again."""

import pytest

from phyagentos.cli.outcome import ExitCode

MODEL = """<mujoco model="scara">
  <compiler angle="radian"/>
  <worldbody>
    <body name="upper" pos="0 0 0.2">
      <joint name="shoulder" axis="0 0 1" range="-2.5 2.5"/>
      <geom type="capsule" fromto="0 0 0 0.25 0 0" size="0.02" mass="1"/>
      <body name="lower" pos="0.25 0 0">
        <joint name="elbow" axis="0 0 1" range="-2.5 2.5"/>
        <geom type="capsule" fromto="0 0 0 0.2 0 0" size="0.015" mass="0.5"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


@pytest.fixture
def model(tmp_path, monkeypatch):
    (file := tmp_path / "models" / "vendor" / "scara.xml").parent.mkdir(parents=True)
    file.write_text(MODEL)
    (tmp_path / "mine").mkdir()
    monkeypatch.chdir(tmp_path / "mine")
    return file


def test_a_draft_names_its_model_below_the_folder_of_models(paos, model, monkeypatch):
    monkeypatch.setenv("PHYAGENTOS_MODELS", str(model.parents[1]))
    assert paos("robot", "new", model, "--name", "arm").code == ExitCode.GOAL_MET
    checked = paos("robot", "check", "arm")
    assert "MODEL_MISSING" not in checked.out
    assert "robots/arm/target.yaml" in checked.err


def test_without_that_folder_the_variable_to_set_is_named(paos, model, monkeypatch):
    monkeypatch.delenv("PHYAGENTOS_MODELS", raising=False)
    drafted = paos("robot", "new", model)
    assert f"set PHYAGENTOS_MODELS to {model.parent}" in drafted.out + drafted.err
    assert "MODEL_MISSING" in paos("robot", "check", "scara").out
