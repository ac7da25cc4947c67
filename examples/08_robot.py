"""8. A robot: a model, and a profile with what the model does not say. Run me: python examples/08_robot.py"""

MODEL = """
<mujoco model="scara">
  <compiler angle="radian"/>
  <worldbody>
    <body name="upper" pos="0 0 0.2">
      <joint name="shoulder" axis="0 0 1" range="-2.5 2.5"/>
      <geom name="upper" type="capsule" fromto="0 0 0 0.25 0 0" size="0.02" mass="1"/>
      <body name="lower" pos="0.25 0 0">
        <joint name="elbow" axis="0 0 1" range="-2.5 2.5"/>
        <geom name="lower" type="capsule" fromto="0 0 0 0.2 0 0" size="0.015" mass="0.5"/>
        <site name="tool" pos="0.2 0 0" euler="3.1416 0 0"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""
PROFILE = """
target: scara
description: Two hinges about the vertical, with a pin at the end, which pushes.
kind: simulation
embodiment: arm
model: scara.xml
tcp: tool
end_effector: none
control_period_s: 0.02
physics_step_s: 0.002
arm:
  joints: [shoulder, elbow]
  home_rad: [0.5, -1.0]
  velocity_rad_s: [2.0, 2.0]
  acceleration_rad_s2: [10.0, 10.0]
  jerk_rad_s3: [1000.0, 1000.0]
  torque_nm: [20.0, 10.0]
  stiffness_nm_rad: [400.0, 200.0]
  damping_nms_rad: [40.0, 20.0]
observations: [joint_state]
actions: [joint_position]
capabilities: [pushing]
"""

if __name__ == "__main__":
    import tempfile
    from pathlib import Path

    from phyagentos.operations.lint import lint_paths
    from phyagentos.protocol.capabilities.registries import read_target
    from phyagentos.runtime.motion.profile_checks import describe_robot
    from phyagentos.runtime.motion.robot_model import build_robot_model

    with tempfile.TemporaryDirectory() as folder:
        robot = Path(folder, "robots", "scara")
        robot.mkdir(parents=True)
        (robot / "scara.xml").write_text(MODEL)
        (robot / "target.yaml").write_text(PROFILE)
        print(*lint_paths([robot]).problems or ["no problem"], sep="\n")
        for name, fact in describe_robot(build_robot_model(read_target(robot / "target.yaml"), robot)).items():
            print(f"{name}: {fact}")
