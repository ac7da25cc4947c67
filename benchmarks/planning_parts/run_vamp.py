"""Queries in JSON on standard input, answered by VAMP's RRT-Connect and simplifier; needs `vamp` alone."""

import json
import sys

import numpy as np
import vamp

READY = [0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785]  # high above a table
STEP_M, STEPS = 0.01, 10

Solid = tuple[str, list[float], list[float], list[float]]


def lower(solid: Solid) -> Solid:
    """The same solid, below the spheres of the arm's base where it stands on it."""
    kind, (x, y, z), *rest = solid
    lowered = ((kind, [x, y, z - step * STEP_M], *rest) for step in range(STEPS))
    return next((each for each in lowered if vamp.panda.validate(READY, build([each]))), solid)


def build(solids: list[Solid]) -> "vamp.Environment":
    """Its environment; cylinders are rounded at their ends there."""
    environment = vamp.Environment()
    for kind, center_m, angles_rad, size_m in solids:
        if kind == "box":
            environment.add_cuboid(vamp.Cuboid(center_m, angles_rad, size_m))
        elif kind == "sphere":
            environment.add_sphere(vamp.Sphere(center_m, size_m[0]))
        else:
            environment.add_capsule(vamp.Cylinder(center_m, angles_rad, size_m[0], 2 * size_m[1]))
    return environment


def answer(query: dict[str, list]) -> tuple[float, float | None]:
    """Time [ms] by its own count, and length [rad]."""
    robot, plan, settings, simplification = vamp.configure_robot_and_planner_with_kwargs("panda", "rrtc")
    environment, chance = build([lower(solid) for solid in query["solids"]]), robot.xorshift()
    goals = [goal for goal in query["goals"] if robot.validate(goal, environment)]
    if not goals or not robot.validate(query["start"], environment):
        return 0.0, None
    found = plan(query["start"], goals, environment, settings, chance)
    if not found.solved:
        return 1e-6 * found.nanoseconds, None
    short = robot.simplify(found.path, environment, simplification, chance)
    corners = short.path.numpy()
    length_rad = float(np.linalg.norm(np.diff(corners, axis=0), axis=1).sum())
    return 1e-6 * (found.nanoseconds + short.nanoseconds), length_rad


if __name__ == "__main__":
    sys.stdout.write(json.dumps([answer(query) for query in json.load(sys.stdin)]))
