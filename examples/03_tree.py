"""3. A tree: how leaves follow each other, in YAML. Run me: python examples/03_tree.py"""

TREE = """
tree: squeeze
description: Close the fingers on an object and open them again.
inputs:
  object: {type: entity, description: What to squeeze.}
  seconds: {type: number, default: 0.2, description: How long.}
root:
  sequence:
    children:
      - close_gripper
      - verify_grasp: {object: "${object}"}
      - wait: {seconds: "${seconds}"}
      - open_gripper
"""

if __name__ == "__main__":
    from phyagentos.testing import PerfectTarget, SkillStand, make_contract, make_cube, read_robot

    for graspable in ("red_cube", None):
        stand = SkillStand(target=PerfectTarget(read_robot()[0], [make_cube("red_cube")], graspable))
        stand.add_tree(TREE)
        session = make_contract(skill="squeeze", parameters={"object": "red_cube"})
        ran = stand.run(session)
        print(ran.ended, *(f"{each.path}: {each.status}" for each in stand.read_trace(session, ran)), sep="\n  ")
