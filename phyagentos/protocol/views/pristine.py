"""Every document as it is in a new workspace: what its renderer writes when there is nothing to tell.

Upstream: the renderers. Downstream: `protocol/`, which holds these texts, and a test that compares.
"""

from phyagentos.protocol.environment import ENVIRONMENT
from phyagentos.protocol.knowledge import KNOWLEDGE, render_knowledge
from phyagentos.protocol.lessons import LESSONS, render_lessons
from phyagentos.protocol.log import LOG
from phyagentos.protocol.registries import render_skills, render_targets
from phyagentos.protocol.runtime_signal import RUNTIME_SIGNAL
from phyagentos.protocol.sessions import SESSIONS
from phyagentos.protocol.skill_runtimes import SKILLRUNTIME
from phyagentos.protocol.store.ledger import Ledger
from phyagentos.protocol.targets import TARGETS
from phyagentos.protocol.tasks import TASK
from phyagentos.protocol.views.environment import render_environment
from phyagentos.protocol.views.log import render_log
from phyagentos.protocol.views.runtime_signal import render_runtime_signal
from phyagentos.protocol.views.sessions import render_sessions
from phyagentos.protocol.views.tasks import render_tasks


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
