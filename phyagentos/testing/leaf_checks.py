"""What every leaf has to satisfy beside its own behaviour."""

from phyagentos.runtime.execution.leaf import Leaf, Role
from phyagentos.runtime.execution.port_types import PORT_TYPES

PORTS = {Role.PLAN_GRASP: {"object"}, Role.PLAN_SITE: {"destination", "relation", "near"}, Role.VERIFY: {"object"}}


def check_leaf(leaf: type[Leaf]) -> None:
    """A leaf is documented, its ports are of types that trees know, described, and those of its role are there."""
    assert leaf.__doc__, f"{leaf.__name__} has no docstring"
    assert isinstance(leaf.ROLE, Role), f"{leaf.__name__}.ROLE is no Role"
    for port, declared in {**leaf.INPUT_PORTS, **leaf.OUTPUT_PORTS}.items():
        assert port != "name", "name is the node's own"
        assert declared.description, f"{leaf.__name__}.{port} has no description"
        known = {dict, *PORT_TYPES.values()}
        names = ", ".join(sorted(each.__name__ for each in known))
        assert declared.data_type in known, f"{leaf.__name__}.{port} is none of {names}"
    missing = PORTS.get(leaf.ROLE, set()) - leaf.INPUT_PORTS.keys()
    assert not missing, f"the role {leaf.ROLE} needs the inputs {', '.join(sorted(missing))}"
