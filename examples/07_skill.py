"""7. A skill: what a goal may ask for, and the tree that does it. Run me: python examples/07_skill.py"""

SKILL = """---
skill: squeeze
description: Squeeze an object for a while.
tree: squeeze
parameters:
  object: {type: entity, role: object, description: What to squeeze.}
  seconds: {type: number, unit: s, default: 0.2, minimum: 0.1, maximum: 5.0, description: How long.}
requires: ["visible(${object})"]
guarantees: ["not moved(${object})"]
needs:
  observations: [joint_state, entity_poses]
  actions: [gripper_width]
---

# Squeeze

Closes the fingers where they are. Bring the hand there before.
"""
TREE = """
tree: squeeze
description: Squeeze an object for a while.
inputs:
  object: {type: entity, description: What to squeeze.}
  seconds: {type: number, default: 0.2, description: How long.}
root:
  sequence:
    children: [close_gripper, {verify_grasp: {object: "${object}"}}, {wait: {seconds: "${seconds}"}}, open_gripper]
"""

if __name__ == "__main__":
    import sys
    import tempfile
    from pathlib import Path

    from phyagentos.__main__ import main

    with tempfile.TemporaryDirectory() as folder:
        for name, text in {"skills/squeeze/SKILL.md": SKILL, "trees/squeeze.yaml": TREE}.items():
            path = Path(folder, name)
            path.parent.mkdir(parents=True)
            path.write_text(text)
        sys.argv = ["paos", "lint", folder]
        main()
