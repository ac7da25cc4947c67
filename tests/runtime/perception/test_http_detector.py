"""An open-vocabulary model on a server of its own: a real one, on this machine, for the time of a test."""

import base64
import json
import struct
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import cv2
import numpy as np
import pytest

from phyagentos.errors import DefinitionError, ExecutionError
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.world.scenes import read_scene
from phyagentos.runtime.perception.detection import http
from phyagentos.runtime.perception.detection.detector_registry import open_detector
from phyagentos.runtime.perception.inventory import build_inventory
from phyagentos.runtime.perception.segmentation import NO_COLOR, DetectorSegmenter

RGB = np.zeros((24, 32, 3), np.uint8)
RGB[4:10, 6:14] = (200, 30, 20)
BOX = [6, 4, 8, 6]


@pytest.fixture
def server():
    class Handler(BaseHTTPRequestHandler):
        def do_POST(self):
            httpd.asked.append(json.loads(self.rfile.read(int(self.headers["content-length"]))))
            if httpd.silent:
                httpd.release.wait(10)
                return
            data = httpd.reply if isinstance(httpd.reply, bytes) else json.dumps(httpd.reply).encode()
            self.send_response(httpd.status)
            self.send_header("content-length", str(len(data)))
            self.end_headers()
            self.wfile.write(data)

        def log_message(self, *_):
            pass

    httpd = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    httpd.asked, httpd.reply, httpd.status, httpd.silent = [], {}, 200, False
    httpd.release, httpd.daemon_threads = threading.Event(), True
    thread = threading.Thread(target=httpd.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    yield httpd
    httpd.release.set()
    httpd.shutdown()
    thread.join()
    httpd.server_close()


@pytest.fixture
def detector(server):
    detector = open_detector("http", {"url": f"http://127.0.0.1:{server.server_port}/detect", "timeout_s": 0.3})
    yield detector
    detector.close()


def answer(**changes):
    return {"version": 1, "detections": [{"label": "red cube", "score": 0.9, "box": BOX} | changes]}


def encode_mask(mask):
    return base64.b64encode(cv2.imencode(".png", mask.astype(np.uint8) * 255)[1].tobytes()).decode()


def test_the_server_is_asked_with_a_picture_and_words_and_answers_with_boxes_and_masks(server, detector):
    mask = RGB[..., 0] > 0
    server.reply = answer(mask_png=encode_mask(mask))

    (found,) = detector.detect(RGB, ["red cube", "tray"])

    assert (found.label, found.score, found.box) == ("red cube", 0.9, (6, 4, 8, 6))
    assert np.array_equal(found.mask, mask)
    (asked,) = server.asked
    picture = cv2.imdecode(np.frombuffer(base64.b64decode(asked["image_png"]), np.uint8), cv2.IMREAD_COLOR)
    assert np.array_equal(picture[..., ::-1], RGB)
    assert (asked["version"], asked["labels"]) == (1, ["red cube", "tray"])


def test_the_best_detection_comes_first_and_doubtful_ones_are_left_out(server, detector):
    scores = (0.4, 0.1, 0.8)
    server.reply = {"version": 1, "detections": [answer(score=score)["detections"][0] for score in scores]}

    assert [each.score for each in detector.detect(RGB, ["red cube"])] == [0.8, 0.4]


@pytest.mark.parametrize(
    ("reply", "message"),
    [
        (b"no json", "JSON is malformed"),
        ({"version": 1}, "missing required field `detections`"),
        ({"version": 2, "detections": []}, "version 2"),
        (answer(label="dragon"), "label 'dragon', which was not asked for"),
        (answer(score=1.5), "a score of 1.5"),
        (answer(box=[30, 4, 8, 6]), r"a box \(30, 4, 8, 6\) outside of a picture of 32 x 24 pixels"),
        (answer(box=[6, 4, 8]), "Expected `array` of length 4"),
        (answer(mask_png="!!"), "a mask that is no picture"),
        (answer(mask_png=encode_mask(np.ones((3, 3)))), "a mask that is no picture of the size"),
        (answer(pose=[1, 2]), "unknown field `pose`"),
        (answer(mask_png=base64.b64encode(b"II*\0" + bytes(40)).decode()), "a mask that is no picture of the size"),
    ],
)
def test_half_an_answer_is_none(server, detector, reply, message):
    server.reply = reply
    with pytest.raises(ExecutionError, match=f"MODEL_FAILED: .*{message}"):
        detector.detect(RGB, ["red cube"])


@pytest.mark.parametrize("size", [(2**15, 2**15), (24, 2**20)])
def test_a_mask_is_not_unpacked_before_its_size_is_known(server, detector, monkeypatch, size):
    """A file of some kilobytes may hold a picture of gigabytes; here only its head says so."""
    whole = base64.b64decode(encode_mask(np.ones((24, 32))))
    server.reply = answer(mask_png=base64.b64encode(whole[:16] + struct.pack(">II", *size) + whole[24:]).decode())
    monkeypatch.setattr(cv2, "imdecode", lambda *_: pytest.fail("it was unpacked"))
    with pytest.raises(ExecutionError, match="a mask that is no picture of the size"):
        detector.detect(RGB, ["red cube"])


def test_masks_that_take_more_memory_than_any_answer_are_refused(server, detector, monkeypatch):
    monkeypatch.setattr(http, "MASKS_MAX_PIXELS", RGB[..., 0].size)
    (one,) = answer(mask_png=encode_mask(np.ones((24, 32))))["detections"]
    server.reply = {"version": 1, "detections": [one]}
    assert len(detector.detect(RGB, ["red cube"])) == 1
    server.reply = {"version": 1, "detections": [one, one]}
    with pytest.raises(ExecutionError, match="2 masks of 32 x 24 pixels"):
        detector.detect(RGB, ["red cube"])


def test_an_answer_that_is_larger_than_any_is_not_read_to_its_end(server, detector, monkeypatch):
    monkeypatch.setattr(http, "ANSWER_MAX_BYTES", 100)
    server.reply = bytes(101)
    with pytest.raises(ExecutionError, match=r"MODEL_FAILED: .*more than"):
        detector.detect(RGB, ["red cube"])


def test_a_server_that_says_no_is_quoted(server, detector):
    server.status, server.reply = 503, b"the model is loading"
    with pytest.raises(ExecutionError, match=r"MODEL_FAILED: .*503: the model is loading"):
        detector.detect(RGB, ["red cube"])


def test_a_server_that_is_silent_is_waited_for_no_longer_than_allowed(server, detector):
    server.silent = True
    with pytest.raises(ExecutionError, match=r"MODEL_FAILED: .*has sent nothing for 0\.3 s"):
        detector.detect(RGB, ["red cube"])


def test_pixels_get_the_colour_of_the_object_that_a_detector_finds_there(server, detector):
    inventory = build_inventory(read_scene(Library.open().get_scene("tabletop/cubes_and_trays")))
    server.reply = answer()

    labels = DetectorSegmenter(detector, inventory).label(RGB)

    red = inventory.objects["red_cube"].colors[0]
    assert np.array_equal(labels == red, RGB[..., 0] > 0)
    assert set(np.unique(labels)) == {red, NO_COLOR}
    assert "green tray" in server.asked[0]["labels"]


def test_a_detector_that_nobody_registered_is_named_with_those_that_are():
    with pytest.raises(
        DefinitionError, match=r"UNKNOWN_NAME \(detector\): found 'htpp'; expected http\. Did you mean 'http'\?"
    ):
        open_detector("htpp", {})


def test_settings_of_another_kind_are_refused():
    with pytest.raises(DefinitionError, match="INVALID_VALUE"):
        open_detector("http", {"url": "http://x", "time_out": 3})
