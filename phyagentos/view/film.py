"""A session as a film of still pictures, drawn from its evidence on request, for a browser that draws no 3D scene."""

import io
from collections import OrderedDict
from concurrent.futures import ThreadPoolExecutor

from fastapi import FastAPI, Response
from fastapi.responses import PlainTextResponse
from PIL import Image

from phyagentos.errors import DefinitionError, ExecutionError
from phyagentos.protocol.sessions.session import SessionId, SessionStatus
from phyagentos.view.documents import Documents
from phyagentos.view.story import MOMENTS, list_moments

_KEPT = 8 * MOMENTS  # pictures, of some 40 kB each
_Key = tuple[SessionId, str, int]


class FilmPictures:
    """Draws and keeps pictures; all in one thread, as graphics belong to the thread that opened them."""

    def __init__(self, documents: Documents) -> None:
        self._documents = documents
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="film")
        self._kept: OrderedDict[_Key, bytes] = OrderedDict()

    def read(self, status: SessionStatus, index: int) -> bytes:
        """The picture of one moment as JPEG; raises IndexError, and as the evidence and the graphics do."""
        key = (status.contract.id, status.updated_at, index)
        at_s = list_moments(self._documents.read_bundle(status), status.execution)[index]
        return self._thread.submit(self._find, key, status, at_s).result()

    def _find(self, key: _Key, status: SessionStatus, at_s: float) -> bytes:
        if key not in self._kept:
            from phyagentos.pictures.playback import read_playback
            from phyagentos.pictures.scene import Look, SceneRenderer

            playback = read_playback(self._documents.workspace, status)
            with SceneRenderer(playback, Look()) as renderer:
                Image.fromarray(renderer.draw(at_s)).save(encoded := io.BytesIO(), "jpeg", quality=85)
            self._kept[key] = encoded.getvalue()
            while len(self._kept) > _KEPT:
                self._kept.popitem(last=False)
        return self._kept[key]


def add_film(app: FastAPI, documents: Documents) -> None:
    """The pictures of the film of any session, by their numbers from 0."""
    pictures = FilmPictures(documents)

    @app.get("/moments/{session}/{index}")
    def show_moment(session: str, index: int) -> Response:
        status = documents.ledger.sessions.get(SessionId(session))
        try:
            if status is not None and 0 <= index < MOMENTS:
                return Response(pictures.read(status, index), media_type="image/jpeg")
        except (DefinitionError, ExecutionError, IndexError) as error:
            return PlainTextResponse(f"this moment cannot be drawn: {error}\n", 404)
        return PlainTextResponse(f"no moment {index} of {session!r}\n", 404)
