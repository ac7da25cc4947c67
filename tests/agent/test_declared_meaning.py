"""What a predicate means is declared: under other names, all that decides by predicates decides the same."""

import re
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest
from rollout_forecaster.playback import Rollout, find_cause

from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.agent.goals.graph import GoalGraph, read_goal_graph
from phyagentos.agent.goals.selector import select
from phyagentos.agent.goals.spec import Promise, WantedGoal
from phyagentos.agent.judging.causes import Cause
from phyagentos.agent.judging.diagnosis import diagnose
from phyagentos.agent.memory.episodes import Surroundings
from phyagentos.agent.planning import goal_facts
from phyagentos.agent.planning.answers import PlannedGoal
from phyagentos.agent.planning.planned import plan_goal, write_graph
from phyagentos.agent.repair.recovery_policies import GraphRepair
from phyagentos.agent.repair.regressions import find_regressions
from phyagentos.agent.understanding.understanding import find_lacks
from phyagentos.agent.understanding.vocabulary import Vocabulary
from phyagentos.assembly.scene_start import draw_start
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.skill_runtimes import SkillRuntime
from phyagentos.protocol.predicates import meaning, predicate
from phyagentos.protocol.predicates.library import get_predicate_library
from phyagentos.protocol.predicates.relations import compute_relations
from phyagentos.protocol.sessions.session import Ended
from phyagentos.protocol.sessions.verdicts import Criterion
from phyagentos.protocol.world.truth import Truth
from phyagentos.runtime.preflight.arguments import iter_contradictions, iter_name_problems
from phyagentos.testing import make_contract
from tests.agent.test_diagnosis import make_bundle
from tests.agent.test_repair import HEMMED_IN, ROOT, failed_before, make_box, make_case, make_table_world, met

OTHER_NAMES = {
    "inside": "within",
    "on": "atop",
    "at": "located",
    "near": "close_by",
    "contains": "filled",
    "holding": "gripped",
    "visible": "in_view",
    "exists": "present",
    "moved": "displaced",
    "open": "ajar",
    "closed": "shut",
    "upright": "erect",
    "fallen": "toppled",
}
CACHES = (
    predicate.read_formula,
    predicate.has_metric,
    meaning.read_statement,
    meaning.list_kinds,
    meaning.normalize,
    meaning.state,
    goal_facts.make_fact,
)
_CALL = re.compile(rf"\b({'|'.join(OTHER_NAMES)})(?=\(|\"|'|$)")

Tell = Callable[[str], str]  # from the names that ship to those that are installed
Scenario = Callable[[Tell, Catalogue], object]


def rename(text: str) -> str:
    """The text with the other names, where predicates are called or chosen among."""
    return _CALL.sub(lambda found: OTHER_NAMES[found[1]], text)


@pytest.fixture(scope="module")
def shipped() -> Catalogue:
    return Catalogue.read(Library((ROOT,)))


@pytest.fixture
def install(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., None]]:
    """Installs predicates in place of those that ship, or beside these."""
    library, shipped = get_predicate_library(), dict(get_predicate_library()._definitions)

    def forget() -> None:
        for cache in CACHES:
            cache.cache_clear()

    def install(*, beside: bool) -> None:
        others = [
            replace(
                each,
                name=OTHER_NAMES.get(each.name, each.name),
                excludes=tuple(OTHER_NAMES[other] for other in each.excludes),
            )
            for each in shipped.values()
        ]
        renamed = {each.name: each for each in others}
        monkeypatch.setattr(library, "_definitions", (shipped if beside else {}) | renamed)
        forget()

    yield install
    monkeypatch.undo()
    forget()


def translate(catalogue: Catalogue) -> Catalogue:
    """The same skills, which require and guarantee by the other names."""
    texts = {name: rename(skill.model_dump_json()) for name, skill in catalogue.skills.items()}
    return replace(catalogue, skills={name: SkillRuntime.model_validate_json(each) for name, each in texts.items()})


def plan(tell: Tell, catalogue: Catalogue, scene: str, *accept: str, steps: tuple[str, ...] = ()) -> object:
    wanted = WantedGoal(
        goal="g",
        objective="o",
        scene=scene,
        targets={"arm": "panda"},
        accept=tuple(map(tell, accept)),
        steps=tuple((tell(each),) for each in steps),
    )
    planned = plan_goal(wanted, catalogue, draw_start(Library.open(), scene, ["panda"], 0))
    assert isinstance(planned, PlannedGoal), planned
    return planned.steps, write_graph(planned)


def plan_drawer(tell: Tell, catalogue: Catalogue) -> object:
    return plan(tell, catalogue, "tabletop/drawer", "closed(drawer)", steps=("inside(green_cube, drawer)",))


def plan_tower(tell: Tell, catalogue: Catalogue) -> object:
    return plan(tell, catalogue, "tabletop/panel_and_stack", "on(lower_block, upper_block)")


def choose_skills(tell: Tell, catalogue: Catalogue) -> object:
    wanted = [tell(text) for text in ("inside(a, b)", "on(a, b)", "visible(a)", "holding(target, a)")]
    return [select(Promise(guarantees=text), "panda", {}, catalogue) for text in wanted]


def diagnose_end(tell: Tell, catalogue: Catalogue) -> object:
    world = make_table_world(make_box("red_cube", (0.5, 0.0, 0.02)))
    bundle = make_bundle(world, ended=Ended.COMPLETED)
    texts = [tell(text) for text in ("holding(panda, red_cube)", "inside(red_cube, red_tray)")]
    found = [Criterion(kind="accept", text=text, truth=Truth.FALSE, because="seen") for text in texts]
    return [diagnose(bundle, [each]).cause for each in found]


def repair(tell: Tell, catalogue: Catalogue, cause: Cause, **more: Any) -> object:
    contract = {"requires": (tell("visible(red_cube)"),)} | more.pop("contract", {})
    contract |= {"accept": tuple(map(tell, contract.get("accept", ("inside(red_cube, zone)",))))}
    return GraphRepair().choose(make_case(catalogue, cause, contract=contract, **more))


def clear(tell: Tell, catalogue: Catalogue) -> object:
    return repair(tell, catalogue, Cause.NO_PLAN, **HEMMED_IN)


def take_other_means(tell: Tell, catalogue: Catalogue) -> object:
    return repair(tell, catalogue, Cause.IMPOSSIBLE, code="NOT_GRASPABLE")


def resume_held(tell: Tell, catalogue: Catalogue) -> object:
    world = make_table_world(make_box("red_cube", (0.5, 0.0, 0.2), held_by="panda"))
    target = msgspec.structs.replace(world.targets["panda"], holding=("red_cube",))
    return repair(tell, catalogue, Cause.RUNNER_LOST, world=msgspec.structs.replace(world, targets={"panda": target}))


def look_again(tell: Tell, catalogue: Catalogue) -> object:
    return repair(tell, catalogue, Cause.OBJECT_HIDDEN, missing=("red_cube",))


def avoid_repetition(tell: Tell, catalogue: Catalogue) -> object:
    earlier = failed_before(make_contract(), 1, Cause.NO_PLAN)
    return repair(tell, catalogue, Cause.NO_PLAN, trace=met("wall"), earlier=(earlier,))


def find_undone(tell: Tell, catalogue: Catalogue) -> object:
    world = make_table_world(make_box("red_cube", (0.5, 0.0, 0.02)), make_box("blue_cube", (0.5, 0.2, 0.02)))
    promises = {name: skill.guarantees for name, skill in catalogue.skills.items()}
    done = make_contract(parameters={"object": "red_cube"}, accept=(tell("inside(red_cube, zone)"),))
    later = [make_contract(skill=skill, parameters={"object": "red_cube"}) for skill in ("inspect", "pick")]
    return [
        find_regressions({"a": done, "b": each}, lambda _: {"b"}, promises, {"panda": (world, world)}) for each in later
    ]


def read_roles(tell: Tell, catalogue: Catalogue) -> object:
    seen = Surroundings(skills=catalogue.skills, scenes={}, targets={})
    values = {"object": "a", "destination": "b", "support": "c", "drawer": "d", "socket": "e", "rest": "f"}
    return [seen.describe(make_contract(skill=name, parameters=values)) for name in catalogue.skills]


def examine(tell: Tell, catalogue: Catalogue) -> object:
    world = make_table_world(make_box("red_cube", (0.5, 0.0, 0.02)))
    twice = msgspec.structs.replace(world.regions["zone"], name="far", pose=world.entities["table"].pose)
    world = msgspec.structs.replace(world, regions={**world.regions, "far": twice}, never_seen=("green_cube",))
    both = make_contract(accept=(tell("inside(red_cube, zone)"), tell("inside(red_cube, far)")))
    asked = make_contract(parameters={"object": "green_cube"})
    names = [
        [*iter_name_problems(asked, catalogue.skills[skill], world, is_fresh=True)] for skill in ("inspect", "pick")
    ]
    return [*iter_contradictions(both, world)], names


def imagine(tell: Tell, catalogue: Catalogue) -> object:
    load = make_box("load", (0.5, 0.0, 0.06))
    worlds = [make_table_world(make_box("red_cube", (0.5, y, 0.02)), load) for y in (0.0, 0.3)]
    session = make_contract(parameters={"object": "red_cube"}, accept=(tell("on(load, red_cube)"),))
    rollout = Rollout(held=(), initial=worlds[0], terminal=worlds[1])
    return find_cause(rollout, rollout, SimpleNamespace(session=session))


def relate(tell: Tell, catalogue: Catalogue) -> object:
    cubes = make_box("red_cube", (0.5, -0.3, 0.02)), make_box("blue_cube", (0.5, -0.3, 0.06))
    return compute_relations(make_table_world(*cubes))


def keep_in_place(tell: Tell, catalogue: Catalogue) -> object:
    source = (ROOT / "goal_graphs/tidy_table.yaml").read_text()
    graph = read_goal_graph_text(tell(source), catalogue)
    return graph.brought, graph.kept


def read_goal_graph_text(text: str, catalogue: Catalogue) -> GoalGraph:
    with tempfile.TemporaryDirectory() as folder:
        (path := Path(folder) / "graph.yaml").write_text(text)
        return read_goal_graph(path, catalogue)


def check_request(tell: Tell, catalogue: Catalogue) -> object:
    vocabulary = Vocabulary.read(catalogue, "tabletop/drawer")
    goals = (["inside(drawer, green_cube)"], ["open(green_cube)"], ["open(drawer)", "closed(drawer)"])
    fields = {"goal": "g", "objective": "o", "scene": "tabletop/drawer", "targets": {"robot": "panda"}}
    constraints = (tell("not moved(green_cube)"),)
    wanted = [WantedGoal(**fields, accept=tuple(map(tell, each))) for each in goals]
    wanted.append(WantedGoal(**fields, accept=(tell("inside(green_cube, drawer)"),), constraints=constraints))
    return [find_lacks(each, vocabulary) for each in wanted]


SCENARIOS: tuple[Scenario, ...] = (
    choose_skills,
    diagnose_end,
    clear,
    take_other_means,
    resume_held,
    look_again,
    avoid_repetition,
    find_undone,
    read_roles,
    examine,
    imagine,
    keep_in_place,
    check_request,
)


def show(found: object) -> str:
    """Everything that a scenario found, as sorted text."""
    return re.sub(r"frozenset\(\{(.*?)\}\)", lambda each: str(sorted(each[1].split(", "))), repr(found))


@pytest.mark.parametrize(
    "scenario",
    [*SCENARIOS, *(pytest.param(each, marks=pytest.mark.sim) for each in (plan_drawer, plan_tower))],
    ids=lambda each: each.__name__,
)
def test_a_predicate_that_means_the_same_under_another_name_decides_the_same(scenario, shipped, install):
    expected = rename(show(scenario(str, shipped)))
    for beside, catalogue in ((False, translate(shipped)), (True, shipped)):
        install(beside=beside)
        assert rename(show(scenario(rename, catalogue))) == expected, f"{beside=}"


def test_relations_are_published_by_the_name_that_is_installed(shipped, install):
    expected = rename(show(relate(str, shipped)))
    install(beside=False)
    assert show(relate(rename, shipped)) == expected
