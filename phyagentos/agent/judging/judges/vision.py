"""The judge that shows camera frames to a vision-language model: one question for each acceptance criterion.

It sends the frames of perception before and after the session, never a rendering, and only where the settings have a
`vision` block. With them goes a context, which is kept in the bundle before it is sent. It fails closed: missing
frames, a late answer or one of another form mean unknown.
"""

import base64
import hashlib
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import msgspec

from phyagentos.agent.context.context import Section, build_context, select
from phyagentos.agent.context.of_workspace import describe_attempts
from phyagentos.agent.judging.judges.judge_registry import make_unknown
from phyagentos.errors import DefinitionError, ExecutionError
from phyagentos.network.chat import OpenAiEndpoint
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.predicates.library import get_predicate_library
from phyagentos.protocol.predicates.predicate import find_formula, find_question, has_metric
from phyagentos.protocol.predicates.syntax import iter_calls
from phyagentos.protocol.sessions.evidence import Bundle
from phyagentos.protocol.sessions.evidence_manifest import keep_shown
from phyagentos.protocol.sessions.looks import LOOKS, LookRole, read_pictures
from phyagentos.protocol.sessions.verdicts import Criterion
from phyagentos.protocol.world.truth import Truth

KIND = "vision"
CONTEXT_TOKENS = 3_000  # of the text beside the pictures
REMEMBERED = 64  # answers; the verifier may ask twice about one session
_SYSTEM = Path(__file__).with_name("vision_instruction.txt").read_text(encoding="utf-8")


Pictures = tuple[bytes, ...]  # PNG, one a camera


class _Answer(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    truth: Truth
    because: str


@dataclass(frozen=True, slots=True)
class VisionJudge:
    """Judges acceptance on camera frames; of one session at most so many criteria, any further one is unknown."""

    endpoint: OpenAiEndpoint
    max_questions: int = 8
    _known: "OrderedDict[str, Criterion]" = field(default_factory=OrderedDict, repr=False, compare=False)

    @property
    def name(self) -> str:
        """`vision/3(model at host)`."""
        return f"vision/3({self.endpoint.name})"

    def judge(self, bundle: Bundle) -> Sequence[Criterion]:
        """One criterion for each predicate of `accept` that neither has a metric nor asks a person."""
        texts = [text for text in bundle.session.accept if not has_metric(text) and not find_question(text)]
        try:
            _, before = read_pictures(bundle.folder, LookRole.START)
            file, after = read_pictures(bundle.folder, LookRole.END)
        except ExecutionError as error:
            return [make_unknown(text, KIND, LOOKS, str(error), failure=error.code) for text in texts]
        return [
            self._ask(text, bundle, (before, after), file)
            if number < self.max_questions
            else make_unknown(text, KIND, file, f"only {self.max_questions} criteria are asked about")
            for number, text in enumerate(texts)
        ]

    def _ask(self, text: str, bundle: Bundle, pictures: tuple[Pictures, Pictures], file: str) -> Criterion:
        try:
            context = _build_context(text, bundle, pictures)
            shown = keep_shown(bundle.folder, context)
        except (DefinitionError, ExecutionError) as error:
            code = error.problems[0].code if isinstance(error, DefinitionError) else error.code
            return make_unknown(text, KIND, file, str(error), failure=code)
        if shown in self._known:
            self._known.move_to_end(shown)
            return self._known[shown]
        try:
            answer = _read_answer(self.endpoint.complete(_build_messages(context, pictures)).text)
        except ExecutionError as error:  # another time it may answer, so this is not remembered
            unknown = make_unknown(text, KIND, file, str(error), failure=error.code)
            return msgspec.structs.replace(unknown, shown=shown)
        because = answer.because[:400]
        criterion = Criterion(text=text, kind=KIND, truth=answer.truth, evidence=file, because=because, shown=shown)
        self._known[shown] = criterion
        if len(self._known) > REMEMBERED:
            self._known.popitem(last=False)
        return criterion


def _build_context(text: str, bundle: Bundle, pictures: tuple[Pictures, Pictures]) -> str:
    """The context of one question; it names the pictures, so no two calls that differ share one."""
    before, after = (tuple(hashlib.sha256(png).hexdigest() for png in shown) for shown in pictures)
    question = {"statement": text, "means": _explain(text), "before": before, "after": after}
    sections = (
        Section("question", question),
        Section("request", {bundle.session.id: select("request", bundle.session)}),
        describe_attempts(bundle.prior[::-1]),
        Section("lessons", {each.id: select("lessons", each) for each in bundle.lessons}),
    )
    return build_context("verify", sections, CONTEXT_TOKENS).text


def _build_messages(context: str, pictures: tuple[Pictures, Pictures]) -> list[Fields]:
    content: list[dict[str, object]] = [{"type": "text", "text": context}]
    for when, shown in zip(("Before the task:", "After the task:"), pictures, strict=True):
        content.append({"type": "text", "text": when})
        urls = (f"data:image/png;base64,{base64.b64encode(png).decode('ascii')}" for png in shown)
        content += [{"type": "image_url", "image_url": {"url": url}} for url in urls]
    return [{"role": "system", "content": _SYSTEM}, {"role": "user", "content": content}]


def _explain(text: str) -> tuple[str, ...]:
    """What the predicates of a statement mean, one line each."""
    formula = find_formula(text)
    known = (get_predicate_library().find(call.name) for call in (iter_calls(formula) if formula is not None else ()))
    return tuple(sorted({f"{found.signature} means: {found.description}" for found in known if found is not None}))


def _read_answer(content: str) -> _Answer:
    try:
        return msgspec.json.decode(content, type=_Answer)
    except (msgspec.MsgspecError, UnicodeError) as error:
        raise ExecutionError("MODEL_FAILED", f"not the JSON object of the schema: {error}") from error
