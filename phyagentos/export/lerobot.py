"""Writes demonstrations as a LeRobotDataset, format v3.0: parquet for numbers, H.264 for pictures, JSON for the form.

Beside what LeRobot asks for, the metadata of each episode names its session, its bundle and its verdict, and
`meta/phyagentos.json` what the whole was made from. https://huggingface.co/docs/lerobot/lerobot-dataset-v3
"""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phyagentos.errors import DefinitionError
from phyagentos.export.demonstrations import POSE, Choice, Demonstration, Demonstrations
from phyagentos.protocol.sessions.evidence import write_json

STATE, ACTION, WORLD, IMAGES = "observation.state", "action", "observation.environment_state", "observation.images."
FRAMES_PER_FILE = 50_000  # half an hour at 25 Hz; LeRobot looks a frame up by file and time
FILES_PER_FOLDER = 1000
VIDEO = {"crf": "18", "g": "2", "bf": "0", "threads": "1"}  # x264: near to lossless, quick to enter, repeatable
QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}
_PLACE = "chunk-{chunk_index:03d}/file-{file_index:03d}"
_DATA, _MOVIE = f"data/{_PLACE}.parquet", f"videos/{{video_key}}/{_PLACE}.mp4"
_COUNTERS = ("frame_index", "episode_index", "index", "task_index")
_SAMPLED_PICTURES, _SAMPLED_PIXELS = 4, 4  # so many pictures of an episode, and one of so many rows and columns

Table = dict[str, NDArray[Any]]
"""Features by name: (n,) or (n, d)."""


def write_dataset(data: Demonstrations, choice: Choice, folder: Path, version: str) -> None:
    """Write a data set.

    Args:
        data: At least one demonstration.
        choice: What they were chosen by.
        folder: Missing or empty.
        version: Of this software.

    Raises:
        DefinitionError: `WOULD_OVERWRITE`; `EXTRA_MISSING` without pyarrow or PyAV.
    """
    _check_extra()
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        found = "a file" if folder.is_file() else "a folder that is not empty"
        expected = "a folder that is missing or empty"
        raise DefinitionError.of("WOULD_OVERWRITE", str(folder), found, expected, "Choose another name.")
    tasks = tuple(dict.fromkeys(each.task for each in data.episodes))
    rows: list[dict[str, Any]] = []
    tables: list[Table] = []
    colours: dict[str, list[NDArray[Any]]] = {IMAGES + camera: [] for camera in choice.cameras}
    for number, group in enumerate(_split(data.episodes)):
        place = dict(zip(("chunk_index", "file_index"), divmod(number, FILES_PER_FOLDER), strict=True))
        for camera in choice.cameras:
            movie = folder / _MOVIE.format(video_key=IMAGES + camera, **place)
            colours[IMAGES + camera] += _write_movie(movie, group, camera, data.fps)
        first, began = len(tables), sum(len(table["index"]) for table in tables)
        for each in group:
            index = sum(len(table["index"]) for table in tables[first:]) + began
            tables.append(_tabulate(each, data.fps, len(tables), index, tasks.index(each.task)))
            sampled = {key: pixels[len(rows)] for key, pixels in colours.items()}
            rows.append(_describe_episode(each, tables[-1], sampled, place, (index - began) / data.fps))
        _write_parquet(folder / _DATA.format(**place), _join(tables[first:]))
    meta, whole = folder / "meta", _join(tables)
    _write_parquet(meta / f"episodes/{_PLACE.format(chunk_index=0, file_index=0)}.parquet", _transpose(rows))
    _write_tasks(meta / "tasks.parquet", tasks)
    write_json(meta / "stats.json", _describe(whole, {key: np.concatenate(each) for key, each in colours.items()}))
    write_json(meta / "info.json", _describe_form(data, choice, len(tasks), whole))
    write_json(meta / "phyagentos.json", _describe_origin(data, choice, version))


def _check_extra() -> None:
    try:
        import av  # noqa: F401
        import pyarrow.parquet  # noqa: F401
    except ImportError as error:
        hint = "Install it: pip install 'phyagentos[export]'"
        raise DefinitionError.of("EXTRA_MISSING", "paos export", str(error), "the extra `export`", hint) from error


def _split(episodes: Sequence[Demonstration]) -> Iterator[list[Demonstration]]:
    """Whole episodes, as many as fit into a file."""
    group: list[Demonstration] = []
    for each in episodes:
        if group and sum(len(other.state) for other in group) + len(each.state) > FRAMES_PER_FILE:
            yield group
            group = []
        group.append(each)
    yield group


def _tabulate(each: Demonstration, fps: int, episode: int, index: int, task: int) -> Table:
    n = len(each.state)
    world = {WORLD: np.tile(each.world, (n, 1))} if len(each.world) else {}
    frames = np.arange(n)
    counters = (frames, np.full(n, episode), index + frames, np.full(n, task))
    return {STATE: each.state, ACTION: each.action} | world | {
        "timestamp": (frames / fps).astype(np.float32)
    } | dict(zip(_COUNTERS, counters, strict=True))  # fmt: skip


def _join(tables: Sequence[Table]) -> Table:
    return {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}


def _describe_episode(
    each: Demonstration, table: Table, sampled: Mapping[str, NDArray[Any]], place: Mapping[str, int], from_s: float
) -> dict[str, Any]:
    """A row of `meta/episodes`: where its rows and pictures lie, what it shows, and whose word says that it does."""
    index, length = int(table["index"][0]), len(each.state)
    to_s = from_s + length / max(1, round(1 / float(table["timestamp"][1]))) if length > 1 else from_s
    row: dict[str, Any] = {"episode_index": int(table["episode_index"][0]), "tasks": [each.task], "length": length}
    row |= {f"data/{name}": value for name, value in place.items()}
    row |= {"dataset_from_index": index, "dataset_to_index": index + length}
    for key in sampled:
        row |= {f"videos/{key}/{name}": value for name, value in place.items()}
        row |= {f"videos/{key}/from_timestamp": from_s, f"videos/{key}/to_timestamp": to_s}
    row |= {"session_id": each.session, "bundle": str(each.bundle), "skill": each.skill, "seed": each.seed}
    row |= {"verdict": each.verdict.verdict.value, "verdict_reason": each.verdict.reason}
    row |= {"sensing": each.verdict.sensing, "verifier": each.verdict.verifier}
    row |= {
        f"stats/{key}/{name}": value
        for key, numbers in _describe(table, sampled).items()
        for name, value in numbers.items()
    }
    return row | {"meta/episodes/chunk_index": 0, "meta/episodes/file_index": 0}


def _describe(table: Table, colours: Mapping[str, NDArray[Any]]) -> dict[str, dict[str, Any]]:
    """Statistics of each feature; of pictures those of sampled pixels (n, 3), in LeRobot's form (3, 1, 1)."""
    found = {name: _measure(values.reshape(len(values), -1)) for name, values in table.items()}
    for key, pixels in colours.items():
        numbers = _measure(pixels)
        found[key] = {name: [[[x]] for x in each] if name != "count" else each for name, each in numbers.items()}
    return found


def _measure(values: NDArray[Any]) -> dict[str, list[Any]]:
    values = values.astype(np.float64)
    numbers = {"min": values.min(0), "max": values.max(0), "mean": values.mean(0), "std": values.std(0)}
    numbers |= {name: np.quantile(values, share, axis=0) for name, share in QUANTILES.items()}
    return {name: each.tolist() for name, each in numbers.items()} | {"count": [len(values)]}


def _describe_form(data: Demonstrations, choice: Choice, n_tasks: int, whole: Table) -> dict[str, Any]:
    """`info.json`."""
    poses = [f"{entity}.{number}" for entity in choice.entities for number in POSE]
    names: dict[str, Sequence[str] | None] = {STATE: data.names, ACTION: data.names, WORLD: poses}
    features: dict[str, Any] = {
        name: {"dtype": values.dtype.name, "shape": values.shape[1:] or (1,), "names": names.get(name)}
        for name, values in whole.items()
    }
    for camera in choice.cameras:
        height, width, channels = next(data.episodes[0].iter_pictures(camera)).shape
        form = {"height": height, "width": width, "channels": channels, "fps": data.fps}
        form |= {"codec": "h264", "pix_fmt": "yuv420p", "is_depth_map": False}
        features[IMAGES + camera] = {
            "dtype": "video",
            "shape": (height, width, channels),
            "names": ("height", "width", "channels"),
            "info": {f"video.{name}": value for name, value in form.items()} | {"has_audio": False},
        }
    return {
        "codebase_version": "v3.0",
        "robot_type": data.target,
        "total_episodes": len(data.episodes),
        "total_frames": len(whole["index"]),
        "total_tasks": n_tasks,
        "chunks_size": FILES_PER_FOLDER,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": data.fps,
        "splits": {"train": f"0:{len(data.episodes)}"},
        "data_path": _DATA,
        "video_path": _MOVIE if choice.cameras else None,
        "features": features,
    }


def _describe_origin(data: Demonstrations, choice: Choice, version: str) -> dict[str, Any]:
    return {
        "phyagentos": version,
        "episodes": "sessions whose verdict is success, on evidence",
        STATE: "measured: joints [rad] and opening of the gripper [m]",
        ACTION: "commanded: the set-points in force one frame later",
        WORLD: "poses [m, quaternion] as believed before the first command, by the sensing of the episode",
        IMAGES: "recorded during the session by its own cameras, noise included: the latest picture at each frame",
        "chosen": choice,
        "left_out": data.left_out,
    }


def _write_movie(path: Path, episodes: Iterable[Demonstration], camera: str, fps: int) -> list[NDArray[Any]]:
    """One film of all episodes; returns sampled pixels (n, 3) of each, from 0 to 1."""
    import av

    path.parent.mkdir(parents=True, exist_ok=True)
    sampled: list[NDArray[Any]] = []
    with av.open(path, "w") as container:
        stream = container.add_stream("libx264", rate=fps, options=VIDEO)
        stream.pix_fmt = "yuv420p"
        for each in episodes:
            pixels: list[NDArray[Any]] = []
            every = -(-len(each.state) // _SAMPLED_PICTURES)
            for number, rgb in enumerate(each.iter_pictures(camera)):
                if not stream.codec_context.is_open:
                    stream.height, stream.width = rgb.shape[:2]
                container.mux(stream.encode(av.VideoFrame.from_ndarray(rgb, format="rgb24")))
                if number % every == 0:
                    pixels.append(rgb[::_SAMPLED_PIXELS, ::_SAMPLED_PIXELS].reshape(-1, 3))
            sampled.append(np.concatenate(pixels) / 255.0)
        container.mux(stream.encode())
    return sampled


def _transpose(rows: Sequence[Mapping[str, Any]]) -> dict[str, list[Any]]:
    return {name: [row[name] for row in rows] for name in rows[0]}


def _write_parquet(path: Path, columns: Mapping[str, Any], metadata: Mapping[str, str] | None = None) -> None:
    import pyarrow as pa
    from pyarrow import parquet

    def convert(values: Any) -> Any:
        if isinstance(values, np.ndarray) and values.ndim == 2:
            return pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), values.shape[1])
        return pa.array(values)

    path.parent.mkdir(parents=True, exist_ok=True)
    table = pa.table({name: convert(values) for name, values in columns.items()})
    parquet.write_table(table.replace_schema_metadata(metadata), path, compression="snappy")


def _write_tasks(path: Path, tasks: Sequence[str]) -> None:
    """The tasks by number, in the form that pandas reads as a frame whose index is the task."""
    kinds = {"task": ("unicode", "object"), "task_index": ("int64", "int64")}
    columns = [
        {"name": name, "field_name": name, "pandas_type": kind, "numpy_type": numpy, "metadata": None}
        for name, (kind, numpy) in kinds.items()
    ]
    form = {"index_columns": ["task"], "column_indexes": [], "columns": columns, "pandas_version": "2.0.0"}
    _write_parquet(path, {"task": list(tasks), "task_index": list(range(len(tasks)))}, {"pandas": json.dumps(form)})
