"""A workspace whose SESSIONS.md is published and edited, as the runtime plane does it, without bodies."""

from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.store.edits.edit_intake import EditIntake
from phyagentos.store.renderer import Views
from tests.pens import Pens


class EditStand(Pens):
    def __init__(self, root, clock, *, period_s=0.2) -> None:
        super().__init__(root, clock)
        self.edits = EditIntake(self.workspace, clock, durable=False)
        self.views = Views(self.workspace, self.pens[Side.AGENT].folder, clock, self.edits, period_s=period_s)

    @property
    def file(self):
        return self.workspace.sessions_document

    @property
    def text(self) -> str:
        return self.file.read_text(encoding="utf-8")

    @property
    def rejected(self) -> str:
        path = self.workspace.rejected_document
        return path.read_text(encoding="utf-8") if path.exists() else ""

    @property
    def sessions(self):
        return self.views.ledger.sessions

    def edit(self, old: str, new: str) -> None:
        """Save a change as an editor that renames over."""
        text = self.text
        assert old in text, old
        self.save(text.replace(old, new, 1))

    def save(self, text: str) -> None:
        temporary = self.file.with_name("4913.tmp")
        temporary.write_text(text, encoding="utf-8")
        temporary.replace(self.file)

    def settle(self, turns=3) -> None:
        """Let the renderer notice: swap, take, render."""
        for _ in range(turns):
            self.clock.advance(0.25)
            self.views.refresh()

    def close(self) -> None:
        self.views.close()
        self.edits.close()
        super().close()
