"""1. A leaf: one action or question of a skill. Run me: python examples/01_leaf.py"""

import math

from phyagentos.skills import Leaf, Port, Status


class ChooseNearest(Leaf):
    """Names the object of a kind that is nearest to the tool."""

    INPUT_PORTS = {"kind": Port(str, description="Such as cube.")}
    OUTPUT_PORTS = {"object": Port(str, description="Its name.")}

    def on_start(self) -> Status:
        tool_m = self.context.step.target.tcp.position_m
        known = [each for each in self.belief.entities.values() if each.kind == self.read("kind")]
        if not known:
            return self.fail("NOTHING_TO_CHOOSE", f"no {self.read('kind')} is known")
        self.write("object", min(known, key=lambda each: math.dist(tool_m, each.pose.position_m)).name)
        return self.succeed()


if __name__ == "__main__":
    from phyagentos.testing import SkillStand, make_cube

    stand = SkillStand(entities=[make_cube("near_cube"), make_cube("far_cube", (0.9, 0.0, 0.02))])
    print(stand.run_leaf(ChooseNearest, kind="cube").outputs)
    print(stand.run_leaf(ChooseNearest, kind="cup").message)
