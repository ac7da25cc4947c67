"""Every document as it is in a new workspace: what its renderer writes when nothing is recorded."""

from phyagentos.protocol.capabilities.registries import render_skills, render_targets
from phyagentos.protocol.capabilities.skill_runtimes import SKILLRUNTIME
from phyagentos.protocol.capabilities.targets import TARGETS
from phyagentos.protocol.documents.log import LOG
from phyagentos.protocol.sessions.knowledge import KNOWLEDGE, render_knowledge
from phyagentos.protocol.sessions.lessons import LESSONS, render_lessons
from phyagentos.protocol.sessions.runtime_signal import RUNTIME_SIGNAL
from phyagentos.protocol.sessions.session import SESSIONS
from phyagentos.protocol.sessions.tasks import TASK
from phyagentos.protocol.world.environment import ENVIRONMENT
from phyagentos.store.ledger import Ledger
from phyagentos.store.views.environment import render_environment
from phyagentos.store.views.log import render_log
from phyagentos.store.views.runtime_signal import render_runtime_signal
from phyagentos.store.views.sessions import render_sessions
from phyagentos.store.views.tasks import render_tasks


def render_pristine() -> dict[str, str]:
    """Text of each document by file name."""
    nothing = Ledger()
    return {
        SESSIONS.file: render_sessions(nothing),
        TASK.file: render_tasks(nothing),
        SKILLRUNTIME.file: render_skills(()),
        TARGETS.file: render_targets(()),
        ENVIRONMENT.file: render_environment(None),
        LESSONS.file: render_lessons(()),
        KNOWLEDGE.file: render_knowledge(()),
        LOG.file: render_log((), nothing.seq),
        RUNTIME_SIGNAL.file: render_runtime_signal(None),
    }
