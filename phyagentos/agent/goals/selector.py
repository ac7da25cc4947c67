"""The selector: which skill brings about a wanted predicate, and which target can execute it. Paper section 3.3.

A wanted predicate is unified with the guarantees of each skill, which binds the skill's parameters. A pair of skill and
target remains when the target offers all that the skill needs. Every choice and every refusal keeps its reason.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.agent.goals.spec import Promise
from phyagentos.errors import DefinitionError, Problem
from phyagentos.protocol.capabilities.skill_runtimes import SkillRuntime
from phyagentos.protocol.capabilities.targets import TargetProfile, is_beside
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.predicates import syntax
from phyagentos.protocol.predicates.meaning import find_held, normalize
from phyagentos.protocol.predicates.predicate import Predicate, parse_predicate, substitute

ANY = "any"
WRITE_SKILL = "docs/skills_and_trees.md"


@dataclass(frozen=True, slots=True, kw_only=True)
class Choice:
    """Skill, target and parameters of a node: arguments as authored, plus those bound by unification.

    Attributes:
        reasons: Empty when the author named both.
        rejected: Candidate -> why not.
    """

    skill: str
    target: str
    parameters: Mapping[str, Any]
    reasons: tuple[str, ...] = ()
    rejected: Mapping[str, str] = field(default_factory=dict)


def select(
    skill: str | Promise,
    target: str,
    arguments: Mapping[str, object],
    catalogue: Catalogue,
    *,
    established: Sequence[str] = (),
    mechanisms: Mapping[str, str] = {},
    address: str = "selector",
) -> Choice:
    """Choose skill and target for one node.

    Args:
        skill: A name, or a guarantee.
        target: A name of TARGETS.md, or `any`: one whose model is sure to be here comes first.
        arguments: As authored.
        catalogue: The candidates.
        established: Guarantees of earlier nodes; a skill that begins with holding an object needs one of them.
        mechanisms: How each known object moves, `slide` or `hinge`; a skill for the other kind does not fit it.
        address: Where the node stands, for messages.

    Raises:
        DefinitionError: A name is unknown, or every candidate is rejected: with the reason of each rejection.
    """
    rejected: dict[str, str] = {}
    skills = [*_iter_skills(skill, arguments, catalogue, established, mechanisms, rejected)]
    own = {name: is_beside(profile.model) for name, profile in catalogue.targets.items()}
    targets = sorted(own, key=lambda name: (not own[name], name)) if target == ANY else [target]
    candidates = []
    for runtime, parameters, reasons in skills:
        for name in targets:
            lacks = list(find_lacks(runtime, catalogue.targets[name])) if name in catalogue.targets else ["a profile"]
            if lacks:
                rejected[f"{runtime.skill} on {name}"] = f"{name} lacks {', '.join(lacks)}"
            else:
                candidates.append((runtime, name, parameters, reasons))
    if not candidates:
        raise DefinitionError(_describe_nothing(skill, target, rejected, catalogue, address))
    candidates.sort(key=lambda each: (len(each[0].requires), each[0].skill, targets.index(each[1])))
    (runtime, where, parameters, reasons), *others = candidates
    if target == ANY:
        needs = runtime.needs
        needed = ", ".join((*needs.observations, *needs.actions, *needs.capabilities)) or "nothing"
        reasons = (*reasons, f"{where} offers what {runtime.skill} needs: {needed}")
    first = f"{runtime.skill} on {where} comes first: fewer assumptions, own model, name"
    rejected |= {f"{other.skill} on {place}": f"possible, but {first}" for other, place, _, _ in others}
    return Choice(skill=runtime.skill, target=where, parameters=parameters, reasons=reasons, rejected=rejected)


def unify(wanted: syntax.Formula, offered: syntax.Formula) -> Fields | None:
    """Values of the variables of `offered` that make it equal to `wanted`, or None."""
    match wanted, offered:
        case syntax.Call(), syntax.Call():
            asked, promised = normalize(wanted), normalize(offered)
            if asked.name != promised.name or len(asked.terms) != len(promised.terms):
                return None
            bound: dict[str, object] = {}
            for term, pattern in zip(asked.terms, promised.terms, strict=True):
                if not _unify_term(term, pattern, bound):
                    return None
            return bound
        case syntax.Not(inner), syntax.Not(pattern_inner):
            return unify(inner, pattern_inner)
        case syntax.Compare(left, relation, limit), syntax.Compare(pattern_left, other_relation, other_limit):
            found = unify(left, pattern_left) if relation == other_relation else None
            terms = syntax.make_term(limit), syntax.make_term(other_limit)
            return found if found is not None and _unify_term(*terms, found) else None
    return {} if wanted == offered else None


def bind_guarantee(
    wanted: syntax.Formula,
    runtime: SkillRuntime,
    parameters: dict[str, object],
    bind: Callable[[syntax.Formula, syntax.Formula], dict[str, object] | None] = unify,
) -> str | None:
    """Add to `parameters` those with which a skill guarantees what is wanted; its guarantee, None without one."""
    for text in runtime.guarantees:
        bound = bind(wanted, parse_predicate(text, template=True).formula)
        if bound is not None and all(parameters.get(key, value) == value for key, value in bound.items()):
            parameters.update(bound)
            return text
    return None


def _unify_term(term: syntax.Term, pattern: syntax.Term, bound: dict[str, object]) -> bool:
    if not isinstance(pattern, syntax.Variable):
        return term == pattern
    value: object
    match term:
        case syntax.Name(value):
            pass
        case syntax.Number(number):
            value = int(number) if number.is_integer() else number
        case syntax.Point(position_m):
            value = list(position_m)
        case syntax.Variable(path):
            value = f"${{{path}}}"
        case _:
            return False
    return bool(bound.setdefault(pattern.path, value) == value)


def _iter_skills(
    skill: str | Promise,
    arguments: Mapping[str, object],
    catalogue: Catalogue,
    established: Sequence[str],
    mechanisms: Mapping[str, str],
    rejected: dict[str, str],
) -> Iterator[tuple[SkillRuntime, Fields, tuple[str, ...]]]:
    """Skills with their parameters and the reasons for these; those that do not fit go to `rejected`."""
    if isinstance(skill, str):
        if skill in catalogue.skills:
            yield catalogue.skills[skill], dict(arguments), ()
        return
    wanted = parse_predicate(skill.guarantees, template=True)
    for name, runtime in sorted(catalogue.skills.items()):
        found = _fit(wanted, runtime, arguments) if runtime.loop is None else "an agent directs it: name it"
        if isinstance(found, str):
            rejected[name] = found
            continue
        parameters, promise = found
        if missing := _find_unestablished(runtime, parameters, established):
            rejected[name] = f"it must begin with {missing}, which no earlier node brings about"
        elif unfit := _find_unfit(runtime, parameters, mechanisms):
            rejected[name] = unfit
        else:
            bindings = ", ".join(f"{key} = {syntax.format_value(value)}" for key, value in parameters.items())
            yield runtime, parameters, (f"{name} guarantees {promise}, so {wanted.text} with {bindings}",)


def _fit(wanted: Predicate, runtime: SkillRuntime, arguments: Mapping[str, object]) -> tuple[Fields, str] | str:
    """Parameters and the guarantees that were used, or why the skill does not fit."""
    parameters = dict(arguments)
    used: list[str] = []
    parts = wanted.formula.parts if isinstance(wanted.formula, syntax.And) else (wanted.formula,)
    for part in parts:
        if (text := bind_guarantee(part, runtime, parameters)) is None:
            offered = "; ".join(runtime.guarantees) or "nothing"
            return f"it does not guarantee {Predicate(part)}; it guarantees {offered}"
        used.append(text)
    parameters.pop("target", None)
    if missing := [key for key in runtime.needed if key not in parameters]:
        return f"parameter {missing[0]!r} follows neither from the guarantee nor from 'with'"
    if unknown := [key for key in parameters if key not in runtime.parameters]:
        return f"it has no parameter {unknown[0]!r}"
    return parameters, " and ".join(used)


def _find_unestablished(runtime: SkillRuntime, parameters: Mapping[str, object], established: Iterable[str]) -> str:
    """What the skill must hold from the start and nothing before it takes hold of; empty where there is none."""
    before = [None, *map(find_held, established)]
    required = (substitute(text, parameters) for text in runtime.requires)
    missing = (text for text in required if find_held(text) not in before)
    return next((parse_predicate(text, template=True).text for text in missing), "")


def _find_unfit(runtime: SkillRuntime, parameters: Mapping[str, object], mechanisms: Mapping[str, str]) -> str:
    """An object that moves otherwise than the skill presumes; empty where none is known to."""
    for key, parameter in runtime.parameters.items():
        item = parameters.get(key)
        moves = mechanisms.get(item) if isinstance(item, str) else None
        if parameter.mechanism is not None and moves not in (None, parameter.mechanism):
            return f"{key} has to be an object with a {parameter.mechanism}, and {item} has a {moves}"
    return ""


def find_predicates(texts: Iterable[str]) -> set[str]:
    """Names of the predicates in some texts, one for each meaning."""
    formulas = (parse_predicate(text, template=True).formula for text in texts)
    return {normalize(call).name for formula in formulas for call in syntax.iter_calls(formula)}


def begins_with_holding(runtime: SkillRuntime) -> bool:
    """Whether a skill must hold something from the start."""
    return any(find_held(text) is not None for text in runtime.requires)


def find_lacks(runtime: SkillRuntime, target: TargetProfile) -> Iterator[str]:
    """What a skill needs and a target does not offer, in words."""
    needs = runtime.needs
    yield from (f"observation {name}" for name in needs.observations if name not in target.observations)
    yield from (f"action {name}" for name in needs.actions if name not in target.actions)
    yield from (f"capability {name}" for name in needs.capabilities if name not in target.capabilities)


def _describe_nothing(
    skill: str | Promise, target: str, rejected: Mapping[str, str], catalogue: Catalogue, address: str
) -> Problem:
    if isinstance(skill, str) and skill not in catalogue.skills:
        return Problem.unknown("skill", address, skill, catalogue.skills)
    if isinstance(skill, str):
        reasons = "; ".join(f"{name}: {why}" for name, why in rejected.items())
        return Problem("NO_CANDIDATE", address, f"skill {skill!r} on target {target!r}", hint=f"Rejected: {reasons}.")
    wanted = find_predicates([skill.guarantees])
    strangers = {name for name, each in catalogue.skills.items() if not wanted & find_predicates(each.guarantees)}
    found = f"a skill that guarantees {skill.guarantees!r} on target {target!r}"
    if near := [f"{name}: {why}" for name, why in rejected.items() if name not in strangers]:
        return Problem("NO_CANDIDATE", address, found, hint=f"Rejected: {'; '.join(near)}.")
    offered = {text: name for name, each in sorted(catalogue.skills.items()) for text in each.guarantees}
    expected = ", ".join(f"{text} ({name})" for text, name in sorted(offered.items()))
    hint = f"No skill guarantees {skill.guarantees}; write one: {WRITE_SKILL}"
    return Problem("NO_CANDIDATE", address, found, f"one of {expected}", hint)
