"""What docs/editing.md shows works as it stands there."""

import os
import re
import subprocess
from pathlib import Path

TEXT = (Path(__file__).resolve().parents[2] / "docs" / "editing.md").read_text(encoding="utf-8")


def test_the_five_lines_of_shell_submit_a_session(stand):
    script = re.search(r"<!-- example: inbox -->\n```sh\n(.*?)```", TEXT, re.DOTALL)[1]
    assert len(script.splitlines()) == 5
    environment = os.environ | {"W": str(stand.workspace.root)}
    subprocess.run(["sh", "-eu", "-c", script], check=True, env=environment, timeout=60)
    stand.settle()

    assert stand.sessions["wave-1"].state == "pending"
    assert stand.sessions["wave-1"].contract.scene.seed == 7


def test_the_section_submits_a_session(stand):
    section = re.search(r"```markdown\n(## wave-1\n.*?)```", TEXT, re.DOTALL)[1]
    stand.save(stand.text + section)
    stand.settle()

    assert stand.rejected == ""
    assert stand.sessions["wave-1"].contract.skill == "pick_and_place"
