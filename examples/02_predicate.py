"""2. A predicate: one fact of a criterion. Run me: python examples/02_predicate.py"""

from phyagentos.predicates import Argument, ArgumentKind, Entity, PredicateDefinition, Reading, View

REACH_M = 0.6


def measure_far_out(view: View, a: Entity) -> Reading:
    """Its origin is more than 0.6 m in front of the robot; margin 1 where it is twice as far."""
    x_m = a.pose.position_m[0]
    return Reading(x_m / REACH_M - 1.0, {"x_m": x_m}, f"{a.name} is {x_m:.2f} m in front of the robot")


FAR_OUT = PredicateDefinition(
    name="far_out",
    arguments=(Argument("a", ArgumentKind.ENTITY),),
    measure=measure_far_out,
    description="Its origin is more than 0.6 m in front of the robot.",
)

if __name__ == "__main__":
    from phyagentos.predicates import get_predicate_library, parse_predicate
    from phyagentos.testing import check_predicate, make_cube, make_world

    check_predicate(FAR_OUT)
    get_predicate_library().admit(FAR_OUT)  # as `paos run` does with each predicates/*.py of a project
    world = make_world(make_cube("near_cube"), make_cube("far_cube", (0.9, 0.0, 0.02)))
    for text in ("far_out(near_cube)", "far_out(far_cube)", "count(far_out(*)) >= 1"):
        found = parse_predicate(text).evaluate(View(now=world))
        print(f"{text}: {found.truth}, {found.because}")
