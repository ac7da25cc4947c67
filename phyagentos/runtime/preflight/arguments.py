"""The contract itself: arguments, time limits, predicates, and the names in them. Independent of the live target."""

import math
from collections.abc import Iterable, Iterator
from itertools import combinations

import msgspec
import numpy as np

from phyagentos.errors import DefinitionError, Problem
from phyagentos.geometry import compute_rotation, to_parent
from phyagentos.protocol.capabilities.skill_runtimes import SkillRuntime, find_mismatch
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.predicates.exchanges import exchange, find_groups
from phyagentos.protocol.predicates.library import Meaning
from phyagentos.protocol.predicates.meaning import Statement, only_looks, read_statement, state
from phyagentos.protocol.predicates.predicate import (
    Predicate,
    View,
    find_formula,
    iter_entities,
    iter_postures,
    parse_predicate,
)
from phyagentos.protocol.predicates.syntax import And, Name
from phyagentos.protocol.sessions.session import Session
from phyagentos.protocol.settings.safety import TargetLimits
from phyagentos.protocol.world.descriptions import find_candidates
from phyagentos.protocol.world.environment import UNNAMED, Environment
from phyagentos.protocol.world.truth import Truth
from phyagentos.runtime.preflight.findings import make_problem

_CONDITIONS = ("requires", "hold", "accept")


def iter_parameter_problems(session: Session, skill: SkillRuntime) -> Iterator[Problem]:
    """Arguments that are unknown to the skill, missing, or invalid."""
    by = f"skill {skill.skill}: parameters"
    for name in session.parameters:
        if name not in skill.parameters:
            yield Problem.unknown("parameter", f"parameters.{name}", name, skill.parameters, by=by)
    for name, parameter in skill.parameters.items():
        value, address = session.parameters.get(name), f"parameters.{name}"
        if value is None:
            if parameter.is_needed:
                yield make_problem(
                    "MISSING_VALUE", address, "nothing", parameter.type, by, fix=f"Give {name!r} under 'with'."
                )
        elif reason := find_mismatch(parameter, value):
            yield make_problem("INVALID_VALUE", address, repr(str(value)), reason, by)


def iter_limit_problems(session: Session, limits: TargetLimits) -> Iterator[Problem]:
    """Time limits that bound nothing, or more than safety.yaml allows a session."""
    for name in session.limits.__struct_fields__:
        value = getattr(session.limits, name)
        if not math.isfinite(value) or value <= 0.0:
            yield make_problem("INVALID_VALUE", f"limits.{name}", value, "a number of seconds above 0")
    allowed_s = limits.session_duration_max.value
    if isinstance(allowed_s, float | int) and session.limits.timeout_s > allowed_s:
        yield make_problem(
            "SESSION_TOO_LONG",
            "limits.timeout_s",
            session.limits.timeout_s,
            expected=f"at most {allowed_s:g} s",
            triggered_by="safety.yaml: session_duration_max",
            fix="Shorten 'timeout_s', or split the session.",
        )


def iter_predicate_problems(session: Session) -> Iterator[Problem]:
    """Conditions that cannot be parsed."""
    for kind in _CONDITIONS:
        for index, text in enumerate(getattr(session, kind)):
            try:
                parse_predicate(text, address=f"{kind}[{index}]")
            except DefinitionError as error:
                yield from error.problems


def iter_name_problems(
    session: Session, skill: SkillRuntime | None, now: Environment, *, is_fresh: bool
) -> Iterator[Problem]:
    """Arguments that name what is not in the world; in a fresh world, from which nothing is gone, conditions too.

    A skill that only looks may look for what the inventory names and no look has shown; so may an agent.
    """
    may_be_unseen = skill is not None and (only_looks(skill.guarantees) or skill.loop is not None)
    unseen = now.never_seen if may_be_unseen else ()
    objects = now.entities.keys() | set(unseen)
    places = objects | now.regions.keys()
    known = {"entity": objects, "entities": objects, "place": places}
    reported: set[str] = set()
    for name, parameter in skill.parameters.items() if skill is not None else ():
        given = session.parameters.get(name)
        named = [given] if isinstance(given, str) else given if isinstance(given, list | tuple) else []
        for value in named if parameter.type in known else ():
            by = f"skill {session.skill}: parameters.{name}"
            if value in known[parameter.type]:
                entity = now.entities.get(value)
                kind, moves = (entity.kind, entity.mechanism) if entity is not None else ("", None)
                if parameter.mechanism not in (None, moves and moves.kind):
                    yield make_problem(
                        "INVALID_VALUE",
                        f"parameters.{name}",
                        found=f"{value}, which has {f'a {moves.kind}' if moves else 'no joint'}",
                        expected=f"an object with a {parameter.mechanism}",
                        triggered_by=by,
                        fix="Choose another object, or another skill.",
                    )
                if parameter.kinds and kind not in parameter.kinds:
                    yield make_problem(
                        "INVALID_VALUE", f"parameters.{name}", f"{value}: {kind}", " or ".join(parameter.kinds), by
                    )
                continue
            reported.add(value)
            yield _make_missing(session, now, f"parameters.{name}", value, sorted(known[parameter.type]), by)
    for kind in ("hold", "accept") if is_fresh else ():
        for index, text in enumerate(getattr(session, kind)):
            for name in _find_names(text):
                if name not in known["place"] and name not in reported:
                    reported.add(name)
                    address = f"{kind}[{index}]"
                    yield _make_missing(session, now, address, name, sorted(known["place"]), f"{kind}: {text}")


def iter_posture_problems(session: Session, skill: SkillRuntime | None, profile: TargetProfile) -> Iterator[Problem]:
    """Postures that the profile of the target does not name: arguments, and those of conditions about this target."""
    parameters = skill.parameters.items() if skill is not None else ()
    named = {f"parameters.{name}": session.parameters.get(name) for name, each in parameters if each.type == "posture"}
    for kind in _CONDITIONS:
        for index, text in enumerate(getattr(session, kind)):
            asked = (posture for target, posture in iter_postures(text) if target in {"target", session.target})
            named |= {f"{kind}[{index}]": posture for posture in asked}
    for address, posture in named.items():
        if isinstance(posture, str) and posture not in profile.postures:
            yield Problem.unknown(
                "posture", address, posture, profile.postures, by=f"target {profile.target}: postures"
            )


def _make_missing(
    session: Session, now: Environment, address: str, name: str, known: Iterable[str], by: str
) -> Problem:
    """A name that the world does not hold; where it stands for a description, with what that fits."""
    if (text := session.scene.described.get(name)) is None:
        return msgspec.structs.replace(Problem.unknown("", address, name, known, by=by), code="NOT_OBSERVED")
    fitting = find_candidates(text, now.entities)
    several = len(fitting) > 1 and Truth.TRUE in fitting.values()
    shown = [each for each in now.entities.values() if (each.name in fitting if fitting else each.kind == UNNAMED)]
    objects = "; ".join(f"{each.name}: {each.color} {each.form or 'thing'}" for each in shown) or "nothing unnamed"
    return make_problem(
        "AMBIGUOUS" if several else "NOT_OBSERVED",
        address,
        found=f"{name!r}, described as {text!r}, and {'perhaps ' if fitting and not several else ''}{objects}",
        expected="one that surely fits",
        triggered_by=by,
        fix="Write `any` where each of them will do." if several else "",
    )


def iter_precondition_problems(session: Session, now: Environment) -> Iterator[Problem]:
    """Preconditions that do not hold in the world as observed, and hold conditions that are false already.

    And each condition, that of the end too, whose predicate raises: nothing moves for what cannot be judged.
    """
    texts = [(kind, text) for kind in _CONDITIONS for text in getattr(session, kind)]
    for kind, text in texts:
        try:
            evaluation = parse_predicate(text).evaluate(_look_at(session, now))
        except DefinitionError:
            continue  # reported by `iter_predicate_problems`
        is_false = evaluation.truth is Truth.FALSE and kind != "accept"
        if is_false or evaluation.defect or (kind == "requires" and evaluation.truth is Truth.UNKNOWN):
            code = "PRECONDITION_UNMET" if kind == "requires" else "CONSTRAINT_VIOLATED"
            code = "BROKEN_PYTHON" if evaluation.defect else code
            found, by = f"{text} is {evaluation.truth}", f"{kind}: {text}"
            yield make_problem(code, kind, found, "true", by, evaluation.because, text)


def iter_ambiguity_problems(session: Session, skill: SkillRuntime | None, now: Environment) -> Iterator[Problem]:
    """Acceptance that asks which of some objects is which, where nothing tells them apart.

    What the session acts on meets its acceptance afterwards; the others that it may be have to meet it already. Where
    it only looks, its acceptance has to be decided now.
    """
    moves = skill is None or not only_looks(skill.guarantees)
    acted = session.find_object(now)
    entity = now.entities.get(acted or "")
    agreed = {name for names in session.interchangeable if acted in names for name in names}
    others = [name for name in entity.alternatives if name not in agreed] if entity is not None else []
    for index, text in enumerate(session.accept):
        try:
            predicate = parse_predicate(text)
        except DefinitionError:
            continue  # reported by `iter_predicate_problems`
        doubtful = predicate.evaluate(_look_at(session, now)).alternatives
        if moves and acted is not None:
            named = acted in iter_entities(predicate)
            doubtful = tuple(
                other for other in others if named and not _is_met_by(other, acted, predicate, session, now)
            )
        if doubtful:
            yield make_problem(
                "AMBIGUOUS",
                address=f"accept[{index}]",
                found=f"{text}, and nothing tells {' and '.join(sorted({*doubtful, acted or doubtful[0]}))} apart",
                expected="objects that can be told apart",
                triggered_by=f"accept: {text}",
                fix="Mark one of them, ask for a number of them, or write them into 'interchangeable' of the goal.",
                subject=text,
            )


def _is_met_by(other: str, acted: str, predicate: Predicate, session: Session, now: Environment) -> bool:
    """Whether a predicate is true if another body has the name of the one that is acted on."""
    world = exchange(now, {acted: other, other: acted})
    named = tuple(tuple(group) for group in find_groups(world))  # as they are in that world
    view = View(now=world, initial=world, target=session.target, interchangeable=named)
    return predicate.evaluate(view).truth is Truth.TRUE


def _look_at(session: Session, now: Environment) -> View:
    return session.make_view(now, now)


def iter_contradictions(session: Session, now: Environment) -> Iterator[Problem]:
    """Objects that the acceptance wants inside of two places at once that do not overlap."""
    wanted: dict[str, list[str]] = {}
    for text in session.accept:
        formula = find_formula(text)
        for part in formula.parts if isinstance(formula, And) else (formula,):
            match read_statement(part):
                case Statement(Meaning.INSIDE, Name(item), Name(place)):
                    wanted.setdefault(item, []).append(place)
    for item, places in wanted.items():
        for one, other in combinations(dict.fromkeys(places), 2):
            room, further = _compute_room(now, one), _compute_room(now, other)
            if room is None or further is None:
                continue
            gap_m = float(np.maximum(room[0] - further[1], further[0] - room[1]).max())
            if gap_m > 0.0:
                both = " and ".join(state(Meaning.INSIDE, item, place) for place in (one, other))
                yield make_problem(
                    "CRITERIA_CONTRADICT",
                    "accept",
                    found=f"{both}, which are {gap_m:.3f} m apart",
                    expected="places that overlap",
                    triggered_by="accept",
                    fix="Ask for one of them, or for two nodes one after the other.",
                )


def _compute_room(now: Environment, place: str) -> tuple[np.ndarray, np.ndarray] | None:
    """Least and greatest coordinates (3,) of the inside of a place, in the world [m]; None where it is not known."""
    if place in now.regions:
        pose, middle, half = now.regions[place].pose, (0.0, 0.0, 0.0), now.regions[place].half_m
    elif place in now.entities and (interior := now.entities[place].interior) is not None:
        pose, middle, half = now.entities[place].pose, interior.center_m, interior.half_m
    else:
        return None
    center = np.array(to_parent(pose, middle))
    reach = np.abs(compute_rotation(pose.quaternion_wxyz)) @ np.array(half)
    return center - reach, center + reach


def _find_names(text: str) -> list[str]:
    try:
        return list(iter_entities(parse_predicate(text)))
    except DefinitionError:
        return []
