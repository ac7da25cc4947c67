"""A moment that a session does not have is refused before anything is drawn."""

from types import SimpleNamespace

import pytest

from phyagentos.errors import DefinitionError
from phyagentos.operations import export
from phyagentos.pictures.scene import Look


@pytest.mark.parametrize("at_s", [99.0, -1.0, float("nan")])
def test_a_moment_outside_of_the_session_is_refused_with_its_length(at_s, monkeypatch, tmp_path):
    monkeypatch.setattr(export, "find_session", lambda root, session: (root, session))
    monkeypatch.setattr("phyagentos.pictures.playback.read_playback", lambda *_: SimpleNamespace(time_s=[1.0, 4.9]))
    with pytest.raises(DefinitionError, match=r"--at: INVALID_VALUE: found .* s; expected 0 to 3\.90 s, as long as"):
        export.render_sessions(tmp_path, ["g.a"], tmp_path / "a.png", Look(), at_s=at_s, fps=12, speed=1.0)
    assert not list(tmp_path.iterdir())
