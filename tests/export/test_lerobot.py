"""The writer of LeRobot data sets: what pyarrow and PyAV read back is what was shown."""

import io
import json
import zipfile

import numpy as np
import pytest
from PIL import Image

from phyagentos.errors import DefinitionError
from phyagentos.export.demonstrations import Choice, Demonstration, Demonstrations
from phyagentos.export.lerobot import write_dataset
from phyagentos.protocol.sessions.recording import RECORDING, RecordedPicture
from phyagentos.protocol.sessions.verdicts import Attempt, Verdict

HOW = "needs the extra `export`: pip install '.[export]'"
parquet = pytest.importorskip("pyarrow.parquet", reason=HOW)
av = pytest.importorskip("av", reason=HOW)

CHOICE = Choice(cameras=("front",), entities=("cube",), fps=25)
GREY = (40, 200)


def make_episode(folder, number, length):
    """A session of `length` steps whose one camera showed two pictures, dark before light."""
    folder.mkdir()
    with zipfile.ZipFile(folder / RECORDING, "w") as file:
        for name, grey in zip(("a.png", "b.png"), GREY, strict=True):
            data = io.BytesIO()
            Image.new("RGB", (32, 16), (grey, grey, grey)).save(data, "png")
            file.writestr(name, data.getvalue())
    dark, light = (RecordedPicture(camera="front", shown_s=0.0, time_s=0.0, rgb=name) for name in ("a.png", "b.png"))
    half = length // 2
    return Demonstration(
        session=f"goal-{number}.node",
        bundle=folder,
        skill="pick",
        task=f"task {number % 2}",
        seed=number,
        verdict=Attempt(verdict=Verdict.SUCCESS, criteria=(), reason="all true", sensing="perceived"),
        state=np.full((length, 2), number, np.float32),
        action=np.arange(2 * length, dtype=np.float32).reshape(length, 2),
        world=np.arange(7, dtype=np.float32),
        pictures={"front": (dark,) * half + (light,) * (length - half)},
    )


@pytest.fixture
def data(tmp_path):
    episodes = tuple(make_episode(tmp_path / f"e{number}", number, length) for number, length in enumerate((6, 8, 4)))
    return Demonstrations(target="arm", names=("j1", "gripper"), fps=25, episodes=episodes, left_out={})


def test_rows_episodes_and_tasks_are_read_back_as_they_were(tmp_path, data):
    write_dataset(data, CHOICE, tmp_path / "set", "1")

    meta = tmp_path / "set" / "meta"
    rows = parquet.read_table(tmp_path / "set/data/chunk-000/file-000.parquet").to_pydict()
    assert rows["index"] == list(range(18))
    assert rows["episode_index"] == [0] * 6 + [1] * 8 + [2] * 4
    assert rows["task_index"] == [0] * 6 + [1] * 8 + [0] * 4
    assert rows["frame_index"][6:9] == [0, 1, 2]
    assert rows["action"][:2] == [[0.0, 1.0], [2.0, 3.0]]
    episodes = parquet.read_table(meta / "episodes/chunk-000/file-000.parquet").to_pydict()
    assert episodes["session_id"] == [f"goal-{number}.node" for number in range(3)]
    assert episodes["verdict"] == ["success"] * 3
    assert episodes["dataset_to_index"] == [6, 14, 18]
    assert np.allclose(episodes["videos/observation.images.front/from_timestamp"], (0.0, 0.24, 0.56))
    assert np.allclose(episodes["videos/observation.images.front/to_timestamp"], (0.24, 0.56, 0.72))
    info = json.loads((meta / "info.json").read_bytes())
    assert (info["total_episodes"], info["total_frames"], info["total_tasks"]) == (3, 18, 2)
    assert info["features"]["observation.images.front"]["shape"] == [16, 32, 3]
    assert info["features"]["observation.environment_state"]["shape"] == [7]
    stats = json.loads((meta / "stats.json").read_bytes())
    assert np.allclose(stats["observation.state"]["max"], 2.0)
    assert np.shape(stats["observation.images.front"]["mean"]) == (3, 1, 1)


def test_the_film_shows_the_latest_picture_at_each_frame(tmp_path, data):
    write_dataset(data, CHOICE, tmp_path / "set", "1")

    with av.open(tmp_path / "set/videos/observation.images.front/chunk-000/file-000.mp4") as film:
        seen = [frame.to_ndarray(format="rgb24").mean() for frame in film.decode(video=0)]
    expected = [grey for length in (6, 8, 4) for grey in np.repeat(GREY, length // 2)]
    assert np.allclose(seen, expected, atol=6)


def test_the_same_demonstrations_make_the_same_bytes(tmp_path, data):
    for name in ("one", "two"):
        write_dataset(data, CHOICE, tmp_path / name, "1")

    files = [path.relative_to(tmp_path / "one") for path in (tmp_path / "one").rglob("*") if path.is_file()]
    assert len(files) == 7
    assert all((tmp_path / "one" / each).read_bytes() == (tmp_path / "two" / each).read_bytes() for each in files)


def test_a_folder_that_holds_something_is_not_overwritten(tmp_path, data):
    (tmp_path / "set").mkdir()
    (tmp_path / "set" / "mine").touch()

    with pytest.raises(DefinitionError, match=r"WOULD_OVERWRITE.*not empty"):
        write_dataset(data, CHOICE, tmp_path / "set", "1")
