"""Any tree of composites and decorators does what a second, plain interpreter of the format says, tick by tick."""

import json
from types import SimpleNamespace

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from py_trees.common import Status

from phyagentos.protocol.capabilities.library import Library
from phyagentos.runtime.execution.leaf import Leaf, PortInformation, Role
from phyagentos.runtime.execution.leaf_registry import LeafRegistry
from phyagentos.runtime.execution.tree_loader import build_tree

PERIOD_S = 0.02
TICKS = 40
LETTERS = {"S": "SUCCESS", "F": "FAILURE"}


class Acts(Leaf):
    """Runs so many ticks and ends as its script says, once more each activation; notes what it was given."""

    ROLE = Role.WAIT
    INPUT_PORTS = {
        "script": PortInformation(data_type=str, description="One letter an activation."),
        "ticks": PortInformation(data_type=int, description="Ticks before it ends."),
        "thing": PortInformation(data_type=str, required=False, description="An element."),
    }

    def on_start(self):
        self.left = self.read("ticks")
        self.context.log.append(("start", self.read("script"), self.find("thing")))
        return self.on_running()

    def on_running(self):
        self.left -= 1
        if self.left >= 0:
            return Status.RUNNING
        script = self.read("script")
        return Status[LETTERS[script[(self.activations - 1) % len(script)]]]


class Judges(Acts):
    """The same without time: what may stand beside another action in a reactive composite."""

    on_running = Leaf.on_running

    def on_start(self):
        self.context.log.append(("start", self.read("script"), self.find("thing")))
        script = self.read("script")
        return Status[LETTERS[script[(self.activations - 1) % len(script)]]]


class Reference:
    """One node, interpreted without py_trees: `tick()` gives S, F or R."""

    def __init__(self, node, world):
        ((self.kind, body),) = node.items()
        self.body, self.world = body, world
        below = body.get("children") or ([body["child"]] if "child" in body else [])
        self.children = [Reference(child, world) for child in below]
        self.running, self.ended_s, self.activations = False, None, 0

    def halt(self):
        self.running = False
        for child in self.children:
            child.halt()

    def tick(self):
        result = getattr(self, self.kind)()
        if result != "R":
            for child in self.children:
                child.halt()
        self.running = result == "R"
        return result

    def acts(self):
        if not self.running:
            self.left, self.activations = self.body["ticks"], self.activations + 1
            self.world.log.append(("start", self.body["script"], self.world.element if "thing" in self.body else None))
        self.left -= 1
        script = self.body["script"]
        return "R" if self.left >= 0 else script[(self.activations - 1) % len(script)]

    judges = acts

    def _in_order(self, goes_on, memory):
        if not (self.running and memory):
            self.at = 0
        for index in range(self.at, len(self.children)):
            result = self.children[index].tick()
            if result != goes_on:
                self.at = index
                for later in self.children[index + 1 :]:
                    later.halt()
                return result
        return goes_on

    def sequence(self):
        return self._in_order("S", memory=True)

    def fallback(self):
        return self._in_order("F", memory=True)

    def reactive_sequence(self):
        return self._in_order("S", memory=False)

    def reactive_fallback(self):
        return self._in_order("F", memory=False)

    def _again_after(self, result, limit):
        self.count = self.count if self.running else 0
        now = self.children[0].tick()
        self.count += now == result
        return "R" if now == result and self.count < limit else now

    def repeat(self):
        return self._again_after("S", self.body["times"])

    def retry(self):
        return self._again_after("F", self.body["attempts"])

    def invert(self):
        return {"S": "F", "F": "S", "R": "R"}[self.children[0].tick()]

    def for_each(self):
        if not self.running:
            self.place = 0
        self.world.element = self.body["in"][self.place]
        result = self.children[0].tick()
        if result == "S" and self.place + 1 < len(self.body["in"]):
            self.place += 1
            return "R"
        return result

    def cooldown(self):
        if self.ended_s is not None and self.world.time_s - self.ended_s < self.body["seconds"] - PERIOD_S / 2:
            return "F"
        result = self.children[0].tick()
        self.ended_s = None if result == "R" else self.world.time_s
        return result


scripts = st.text("SF", min_size=1, max_size=3)
quick = st.builds(lambda script: {"judges": {"script": script, "ticks": 0, "thing": "$one"}}, scripts)
slow = st.builds(lambda s, n: {"acts": {"script": s, "ticks": n, "thing": "$one"}}, scripts, st.integers(0, 3))


def extend(nodes):
    some = st.lists(nodes, min_size=1, max_size=3)
    reactive = st.tuples(st.lists(quick, max_size=2), nodes, st.lists(quick, max_size=1)).map(
        lambda parts: [*parts[0], parts[1], *parts[2]]
    )
    return st.one_of(
        st.builds(
            lambda kind, children: {kind: {"children": children}}, st.sampled_from(["sequence", "fallback"]), some
        ),
        st.builds(
            lambda kind, children: {kind: {"children": children}},
            st.sampled_from(["reactive_sequence", "reactive_fallback"]),
            reactive,
        ),
        st.builds(lambda child, n: {"repeat": {"times": n, "child": child}}, nodes, st.integers(1, 3)),
        st.builds(lambda child, n: {"retry": {"attempts": n, "child": child}}, nodes, st.integers(1, 3)),
        st.builds(lambda child: {"invert": {"child": child}}, nodes),
        st.builds(lambda child, n: {"cooldown": {"seconds": n * PERIOD_S, "child": child}}, nodes, st.integers(1, 5)),
    )


trees = st.recursive(slow | quick, extend, max_leaves=6)


def nest(node, names):
    """Below one `for_each`, which writes the key that leaves read."""
    return {"for_each": {"each": "$one", "in": names, "child": node}}


@pytest.fixture(scope="module")
def registry():
    registry = LeafRegistry()
    registry.register("acts", Acts)
    registry.register("judges", Judges)
    return registry


@pytest.mark.slow
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(trees, st.lists(st.sampled_from(["cup", "cube", "can"]), min_size=1, max_size=3), st.data())
def test_a_tree_does_what_the_plain_interpreter_says(tmp_path, registry, node, names, data):
    number = len(list(tmp_path.glob("trees/*"))) if (tmp_path / "trees").exists() else 0
    (tmp_path / "trees").mkdir(exist_ok=True)
    root, name = nest(node, names), f"t{number}"
    (tmp_path / "trees" / f"{name}.yaml").write_text(json.dumps({"tree": name, "description": "A tree.", "root": root}))
    context = SimpleNamespace(time_s=0.0, log=[], profile=SimpleNamespace(control_period_s=PERIOD_S))
    world = SimpleNamespace(time_s=0.0, log=[], element="")
    built = build_tree(name, {}, context, Library((tmp_path,)), registry).root
    reference = Reference(root, world)
    for _ in range(TICKS):
        context.time_s = world.time_s = context.time_s + PERIOD_S
        built.tick_once()
        assert built.status.value[0] == reference.tick()
        assert context.log == world.log


def test_an_empty_list_is_success_without_its_child(tmp_path, registry):
    (tmp_path / "trees").mkdir()
    text = {"tree": "none", "description": "A tree.", "inputs": {"all": {"type": "entities"}}}
    child = {"acts": {"script": "F", "ticks": 0}}
    text["root"] = {"for_each": {"each": "$one", "in": "$all", "child": child}}
    (tmp_path / "trees" / "none.yaml").write_text(json.dumps(text))
    context = SimpleNamespace(time_s=0.0, log=[])
    built = build_tree("none", {"all": []}, context, Library((tmp_path,)), registry).root
    built.tick_once()
    assert (built.status, context.log) == (Status.SUCCESS, [])
