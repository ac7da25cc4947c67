"""The judge that shows camera frames to a vision-language model: one question for each acceptance criterion.

It sends the frames of perception before and after the session, never a rendering, and only where the settings have a
`vision` block. It fails closed: missing frames, a late answer or one of another form mean unknown.
"""

import base64
import hashlib
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import msgspec

from phyagentos.agent.judging.judges.judge import make_unknown
from phyagentos.errors import DefinitionError, ExecutionError
from phyagentos.network.chat import OpenAiEndpoint
from phyagentos.protocol.sessions.evidence import Bundle
from phyagentos.protocol.sessions.looks import LOOKS, LookRole, read_pictures
from phyagentos.protocol.sessions.verdicts import Criterion
from phyagentos.protocol.world.predicates.library import get_predicate_library
from phyagentos.protocol.world.predicates.predicate import has_metric, parse_predicate
from phyagentos.protocol.world.predicates.syntax import iter_calls
from phyagentos.protocol.world.truth import Truth

KIND = "vision"
REMEMBERED = 64  # answers; the verifier may ask twice about one session
_SYSTEM = (
    "You judge whether a statement about a robot's workspace is true after a task. You are shown what each of its "
    "cameras saw before the task, then what each saw after it. Answer with one JSON object and nothing else: "
    '{"truth": "true" | "false" | "unknown", "because": "<one sentence>"}. '
    "Say unknown when the pictures do not show it."
)


Pictures = tuple[bytes, ...]
"""PNG, one a camera."""


class _Answer(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    truth: Truth
    because: str


@dataclass(frozen=True, slots=True)
class VisionJudge:
    """Judges acceptance on camera frames.

    Attributes:
        max_questions: Criteria of one session; any further one is unknown.
    """

    endpoint: OpenAiEndpoint
    max_questions: int = 8
    _known: "OrderedDict[str, Criterion]" = field(default_factory=OrderedDict, repr=False, compare=False)

    @property
    def name(self) -> str:
        """`vision/2(model at host)`."""
        return f"vision/2({self.endpoint.name})"

    def judge(self, bundle: Bundle) -> Sequence[Criterion]:
        """One criterion for each predicate of `accept` without a metric."""
        texts = [text for text in bundle.session.accept if not has_metric(text)]
        try:
            _, before = read_pictures(bundle.folder, LookRole.START)
            file, after = read_pictures(bundle.folder, LookRole.END)
        except ExecutionError as error:
            return [make_unknown(text, KIND, LOOKS, str(error), failure=error.code) for text in texts]
        return [
            self._ask(text, bundle.session.objective, (before, after), file)
            if number < self.max_questions
            else make_unknown(text, KIND, file, f"only {self.max_questions} criteria are asked about")
            for number, text in enumerate(texts)
        ]

    def _ask(self, text: str, objective: str, pictures: tuple[Pictures, Pictures], file: str) -> Criterion:
        shown = (*pictures[0], b"", *pictures[1])
        key = hashlib.sha256(b"\0".join([text.encode(), objective.encode(), *shown])).hexdigest()
        if key in self._known:
            self._known.move_to_end(key)
            return self._known[key]
        try:
            answer = _read_answer(self.endpoint.complete(_build_messages(text, objective, pictures)).text)
        except ExecutionError as error:  # another time it may answer, so this is not remembered
            return make_unknown(text, KIND, file, str(error), failure=error.code)
        criterion = Criterion(text=text, kind=KIND, truth=answer.truth, evidence=file, because=answer.because[:400])
        self._known[key] = criterion
        if len(self._known) > REMEMBERED:
            self._known.popitem(last=False)
        return criterion


def _build_messages(text: str, objective: str, pictures: tuple[Pictures, Pictures]) -> list[dict[str, Any]]:
    question = f"Task: {objective}\nStatement: {text}\n{_explain(text)}\nIs the statement true after the task?"
    content: list[dict[str, Any]] = [{"type": "text", "text": question}]
    for when, shown in zip(("Before the task:", "After the task:"), pictures, strict=True):
        content.append({"type": "text", "text": when})
        urls = (f"data:image/png;base64,{base64.b64encode(png).decode('ascii')}" for png in shown)
        content += [{"type": "image_url", "image_url": {"url": url}} for url in urls]
    return [{"role": "system", "content": _SYSTEM}, {"role": "user", "content": content}]


def _explain(text: str) -> str:
    """What the predicates of a statement mean, one line each."""
    try:
        calls = list(iter_calls(parse_predicate(text).formula))
    except DefinitionError:
        return ""
    known = (get_predicate_library().find(call.name) for call in calls)
    lines = {f"{found.signature} means: {found.description}" for found in known if found is not None}
    return "\n".join(sorted(lines))


def _read_answer(content: str) -> _Answer:
    try:
        return msgspec.json.decode(content, type=_Answer)
    except (msgspec.MsgspecError, UnicodeError) as error:
        raise ExecutionError("MODEL_MALFORMED", f"not the JSON object that was asked for: {error}") from error
