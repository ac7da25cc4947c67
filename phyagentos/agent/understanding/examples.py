"""Sentences that are understood over a scene, for a person whose request was not."""

from collections.abc import Iterator
from itertools import product

from phyagentos.agent.understanding.discourse import Slot
from phyagentos.agent.understanding.embedded import EmbeddedUnderstander
from phyagentos.agent.understanding.understanding import Understood
from phyagentos.agent.understanding.vocabulary import NO_TOPS, SceneObject, Vocabulary, read_lexicon

_TRIED = 12  # templates and objects are read by the understander, which takes a tenth of a second


def list_examples(vocabulary: Vocabulary, request: str = "", most: int = 2) -> tuple[str, ...]:
    """Requests that are understood here, the ones most like `request` first, each of another kind where possible."""
    words = {*request.lower().split()}
    texts = [text for template in read_lexicon()["examples"] for text in _iter_filled(template, vocabulary)]
    ordered = sorted(texts, key=lambda text: -len(words & {*text.split()}))
    firsts = {text.split()[0]: text for text in reversed(ordered)}.values()
    tried = list(dict.fromkeys([*sorted(firsts, key=ordered.index), *ordered]))[:_TRIED]
    understander = EmbeddedUnderstander()
    understood = (text for text in tried if isinstance(understander.understand(text, vocabulary, {}), Understood))
    return tuple(text for _, text in zip(range(most), understood, strict=False))


def _iter_filled(template: str, vocabulary: Vocabulary) -> Iterator[str]:
    """A template about each object that fits it."""
    slots = [
        slot for slot in ("moved", "vessel", "top", "opens", "press", "loose", "region") if f"{{{slot}}}" in template
    ]
    fitting = [[each for each in vocabulary.objects.values() if _fits(each, slot)] for slot in slots]
    for bodies in product(*fitting):
        names = {slot: body.name.replace("_", " ") for slot, body in zip(slots, bodies, strict=True)}
        if len({*names.values()}) == len(names):
            yield template.format(**names)


def _fits(body: SceneObject, slot: str) -> bool:
    match slot:
        case "vessel":
            return body.has_interior and not body.movable and body.kind != "region"
        case "top":
            is_flat = not (body.movable or body.has_interior or body.part_of or body.opens)
            return is_flat and body.kind not in NO_TOPS
        case "press":
            return body.opens == "slide" and not body.has_interior
        case "opens":
            return bool(body.opens) and (body.opens != "slide" or body.has_interior)
        case "region":
            return body.kind == "region"
        case Slot.MOVED:
            return body.movable and not body.has_interior and body.kind != "ball"
    return Slot(slot).takes(body)
