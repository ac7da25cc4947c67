"""Every kind of Markdown document of a workspace, by file name: how it is checked and read as plain data."""

from collections.abc import Callable
from typing import Any

from phyagentos.errors import DefinitionError, Problem, raise_any
from phyagentos.protocol.capabilities.skill_runtimes import SKILLRUNTIME
from phyagentos.protocol.capabilities.targets import TARGETS
from phyagentos.protocol.documents.document import Block, DocumentFormat, iter_blocks, read_document
from phyagentos.protocol.documents.log import LOG, read_log
from phyagentos.protocol.documents.schema import parse_yaml
from phyagentos.protocol.documents.struct_schema import convert_located
from phyagentos.protocol.sessions.knowledge import KNOWLEDGE
from phyagentos.protocol.sessions.lessons import LESSONS
from phyagentos.protocol.sessions.runtime_signal import RUNTIME_SIGNAL
from phyagentos.protocol.sessions.session import SESSIONS
from phyagentos.protocol.sessions.stop_signals import Signal
from phyagentos.protocol.sessions.tasks import TASK
from phyagentos.protocol.world.environment import ENVIRONMENT
from phyagentos.store.edits.request_form import read_contract
from phyagentos.store.runtime_signal import REQUEST

FORMATS: dict[str, DocumentFormat[Any]] = {
    each.file: each
    for each in (SESSIONS, TASK, SKILLRUNTIME, TARGETS, ENVIRONMENT, LESSONS, KNOWLEDGE, LOG, RUNTIME_SIGNAL)
}


def check_document(text: str, file: str, source: str = "") -> None:
    """Check a document, usually named `file`; raises DefinitionError with every problem at file:line:column."""
    source = source or file
    if file == LOG.file:
        read_log(text, source)
    elif file == SESSIONS.file:
        _check_with_requests(text, SESSIONS, source, _read_draft)
    elif file == RUNTIME_SIGNAL.file:
        _check_with_requests(text, RUNTIME_SIGNAL, source, _read_signal)
    else:
        read_document(text, FORMATS[file], source)


def _check_with_requests(
    text: str, format: DocumentFormat[Any], source: str, read_request: Callable[[Block, str], bool]
) -> None:
    """Check a document to which a person may add blocks of another form: `read_request` is whether it is one."""
    problems: list[Problem] = []
    requests = set()
    for block in iter_blocks(text):
        try:
            if read_request(block, source):
                requests.add(block.name)
        except DefinitionError as error:
            problems += error.problems
            requests.add(block.name)
    try:
        read_document(text, format, source, passed_over=requests)
    except DefinitionError as error:
        problems += error.problems
    raise_any(problems)


def _read_draft(block: Block, source: str) -> bool:
    """A section with a contract and no state is a session that a person asks for."""
    located = parse_yaml(block.yaml, source, block.line)
    is_draft = isinstance(located.data, dict) and "contract" in located.data and "state" not in located.data
    if is_draft:
        read_contract(located, block.name)
    return is_draft


def _read_signal(block: Block, source: str) -> bool:
    """A section with a request has the form of a signal."""
    if block.name == REQUEST:
        convert_located(Signal, parse_yaml(block.yaml, source, block.line))
    return block.name == REQUEST
