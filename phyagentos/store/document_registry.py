"""Every kind of Markdown document of a workspace, by file name: how it is checked and read as plain data."""

from typing import Any

from phyagentos.errors import DefinitionError, Problem
from phyagentos.protocol.capabilities.skill_runtimes import SKILLRUNTIME
from phyagentos.protocol.capabilities.targets import TARGETS
from phyagentos.protocol.documents.document import DocumentFormat, iter_blocks, read_document
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
    if file == LOG.file:
        read_log(text, source)
    elif file == SESSIONS.file:
        _check_sessions(text, source or file)
    elif file == RUNTIME_SIGNAL.file:
        _check_runtime_signal(text, source or file)
    else:
        read_document(text, FORMATS[file], source)


def _check_sessions(text: str, source: str) -> None:
    """A section with a contract and no state is a session that a person asks for; it has a form of its own."""
    problems: list[Problem] = []
    drafts = set()
    for block in iter_blocks(text):
        try:
            located = parse_yaml(block.yaml, source, block.line)
            if isinstance(located.data, dict) and "contract" in located.data and "state" not in located.data:
                drafts.add(block.name)
                read_contract(located, block.name)
        except DefinitionError as error:
            problems += error.problems if block.name in drafts else ()
    try:
        read_document(text, SESSIONS, source, passed_over=drafts)
    except DefinitionError as error:
        problems += error.problems
    if problems:
        raise DefinitionError(problems)


def _check_runtime_signal(text: str, source: str) -> None:
    """A section with a request is what a person asks for; it has the form of a signal."""
    problems: list[Problem] = []
    for block in iter_blocks(text):
        try:
            if block.name == REQUEST:
                convert_located(Signal, parse_yaml(block.yaml, source, block.line))
        except DefinitionError as error:
            problems += error.problems
    try:
        read_document(text, RUNTIME_SIGNAL, source, passed_over={REQUEST})
    except DefinitionError as error:
        problems += error.problems
    if problems:
        raise DefinitionError(problems)
