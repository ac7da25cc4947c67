"""Writes demonstrations as a LeRobotDataset, format v3.0: parquet for numbers, H.264 for pictures, JSON for the form.

Beside what LeRobot asks for, the metadata of each episode names where it is from and its verdict, and
`meta/phyagentos.json` what the whole was made from. https://huggingface.co/docs/lerobot/lerobot-dataset-v3
"""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phyagentos.errors import needs_extra
from phyagentos.export.demonstrations import POSE, Choice, Demonstrations, Episode
from phyagentos.export.video import write_mp4
from phyagentos.protocol.documents.durable_files import require_empty
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.sessions.evidence import write_json

STATE, ACTION, WORLD, IMAGES = "observation.state", "action", "observation.environment_state", "observation.images."
FRAMES_PER_FILE = 50_000  # half an hour at 25 Hz; LeRobot looks a frame up by file and time
FILES_PER_FOLDER = 1000
VIDEO = {"crf": "18", "g": "2", "bf": "0", "threads": "1"}  # x264: near to lossless, quick to enter, repeatable
QUANTILES = (0.01, 0.1, 0.5, 0.9, 0.99)
_PLACE = "chunk-{chunk_index:03d}/file-{file_index:03d}"
_DATA, _MOVIE = f"data/{_PLACE}.parquet", f"videos/{{video_key}}/{_PLACE}.mp4"
_SAMPLED_PICTURES, _SAMPLED_PIXELS = 4, 4  # so many pictures of an episode, and one of so many rows and columns

Table = dict[str, NDArray[Any]]
"""Features by name: (n,) or (n, d)."""


def write_dataset(data: Demonstrations, choice: Choice, folder: Path, version: str) -> None:
    """Write a data set of at least one demonstration into a folder that is missing or empty.

    Raises:
        DefinitionError: `WOULD_OVERWRITE`; `EXTRA_MISSING` without pyarrow or PyAV.
    """
    _check(folder)
    tasks, meta = list(dict.fromkeys(each.task for each in data.episodes)), folder / "meta"
    ends = np.cumsum([len(each.state) for each in data.episodes])
    starts = np.concatenate(([0], ends[:-1]))
    table, files = _tabulate(data, tasks, starts), starts // FRAMES_PER_FILE  # of whole episodes
    pixels: list[Table] = []
    rows: list[dict[str, object]] = []
    for number in np.unique(files):
        here = np.flatnonzero(files == number)
        place = {"chunk_index": int(number) // FILES_PER_FOLDER, "file_index": int(number) % FILES_PER_FOLDER}
        frames = slice(starts[here[0]], ends[here[-1]])
        _write_parquet(folder / _DATA.format(**place), {name: values[frames] for name, values in table.items()})
        films = {IMAGES + name: folder / _MOVIE.format(video_key=IMAGES + name, **place) for name in choice.cameras}
        pixels += _write_films(films, [data.episodes[each] for each in here], data.fps)
        for each in here:
            span_s = tuple(float(at - frames.start) / data.fps for at in (starts[each], ends[each]))
            own = {name: values[starts[each] : ends[each]] for name, values in table.items()}
            rows.append(_describe_episode(data.episodes[each], own, pixels[each], place, span_s))
    _write_parquet(meta / f"episodes/{_PLACE}.parquet".format(chunk_index=0, file_index=0), _join(rows))
    _write_tasks(meta / "tasks.parquet", tasks)
    write_json(meta / "stats.json", _measure(table | {name: np.concatenate(v) for name, v in _join(pixels).items()}))
    write_json(meta / "info.json", _describe_form(data, choice, len(tasks), table))
    origin = {"phyagentos": version, "chosen": choice, "left_out": data.left_out}
    write_json(meta / "phyagentos.json", origin | {"episodes": data.about})


def _check(folder: Path) -> None:
    with needs_extra("export", "paos export lerobot"):
        import av  # noqa: F401
        import pyarrow.parquet  # noqa: F401
    require_empty(folder)


def _tabulate(data: Demonstrations, tasks: list[str], starts: NDArray[np.int64]) -> Table:
    """All frames of all episodes."""
    lengths = [len(each.state) for each in data.episodes]
    index = np.arange(sum(lengths))
    frame = index - np.repeat(starts, lengths)
    worlds = np.repeat([each.world for each in data.episodes], lengths, axis=0)
    return {
        STATE: np.concatenate([each.state for each in data.episodes]),
        ACTION: np.concatenate([each.action for each in data.episodes]),
        **({WORLD: worlds} if worlds.size else {}),
        "timestamp": (frame / data.fps).astype(np.float32),
        "frame_index": frame,
        "episode_index": np.repeat(np.arange(len(lengths)), lengths),
        "index": index,
        "task_index": np.repeat([tasks.index(each.task) for each in data.episodes], lengths),
    }


def _join(rows: Sequence[Mapping[str, object]]) -> dict[str, list[Any]]:
    return {name: [row[name] for row in rows] for name in rows[0]}


def _describe_episode(
    each: Episode, table: Table, pixels: Table, place: Mapping[str, int], span_s: tuple[float, ...]
) -> Fields:
    """A row of `meta/episodes`: where its frames and pictures lie, what it shows, and whose word says that it does."""
    first, length = int(table["index"][0]), len(each.state)
    row: dict[str, object] = {"episode_index": int(table["episode_index"][0]), "tasks": [each.task], "length": length}
    row |= {"dataset_from_index": first, "dataset_to_index": first + length}
    row |= {f"data/{name}": value for name, value in place.items()}
    for key in pixels:
        timed = dict(zip(("from_timestamp", "to_timestamp"), span_s, strict=True))
        row |= {f"videos/{key}/{name}": value for name, value in {**place, **timed}.items()}
    row |= each.origin
    measured = _measure(table | pixels).items()
    row |= {f"stats/{key}/{name}": value for key, numbers in measured for name, value in numbers.items()}
    return row | {"meta/episodes/chunk_index": 0, "meta/episodes/file_index": 0}


def _measure(table: Table) -> dict[str, Fields]:
    """Statistics of each feature; of pictures those of sampled pixels (n, 3), in LeRobot's form (3, 1, 1)."""
    found: dict[str, dict[str, object]] = {}
    for key, values in table.items():
        each = values.astype(np.float64).reshape(len(values), -1)
        numbers = {"min": each.min(0), "max": each.max(0), "mean": each.mean(0), "std": each.std(0)}
        numbers |= {f"q{100 * share:02.0f}": np.quantile(each, share, axis=0) for share in QUANTILES}
        form = (3, 1, 1) if key.startswith(IMAGES) else (-1,)
        found[key] = {name: n.reshape(form).tolist() for name, n in numbers.items()} | {"count": [len(each)]}
    return found


def _describe_form(data: Demonstrations, choice: Choice, n_tasks: int, table: Table) -> Fields:
    """`info.json`."""
    poses = [f"{entity}.{number}" for entity in choice.entities for number in POSE]
    names: dict[str, Sequence[str] | None] = {STATE: data.names, ACTION: data.names, WORLD: poses}
    features: dict[str, object] = {
        name: {"dtype": values.dtype.name, "shape": values.shape[1:] or (1,), "names": names.get(name)}
        for name, values in table.items()
    }
    for camera in choice.cameras:
        shape = height, width, channels = next(data.episodes[0].iter_pictures(camera)).shape
        form = {"height": height, "width": width, "channels": channels, "fps": data.fps}
        form |= {"codec": "h264", "pix_fmt": "yuv420p", "is_depth_map": False}
        info = {f"video.{name}": value for name, value in form.items()} | {"has_audio": False}
        axes = ("height", "width", "channels")
        features[IMAGES + camera] = {"dtype": "video", "shape": shape, "names": axes, "info": info}
    return {
        "codebase_version": "v3.0",
        "robot_type": data.target,
        "total_episodes": len(data.episodes),
        "total_frames": len(table["index"]),
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


def _write_films(films: Mapping[str, Path], episodes: Sequence[Episode], fps: int) -> list[Table]:
    """One film of all episodes for each camera; returns sampled pixels (n, 3), from 0 to 1, of each episode."""
    sampled: list[Table] = [{} for _ in episodes]
    for key, path in films.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        write_mp4(_iter_and_sample(key, episodes, sampled), path, fps, VIDEO)
    return sampled


def _iter_and_sample(key: str, episodes: Sequence[Episode], sampled: Sequence[Table]) -> Iterator[NDArray[Any]]:
    for each, kept in zip(episodes, sampled, strict=True):
        pixels: list[NDArray[Any]] = []
        every = -(-len(each.state) // _SAMPLED_PICTURES)
        for number, rgb in enumerate(each.iter_pictures(key.removeprefix(IMAGES))):
            yield rgb
            if number % every == 0:
                pixels.append(rgb[::_SAMPLED_PIXELS, ::_SAMPLED_PIXELS].reshape(-1, 3))
        kept[key] = np.concatenate(pixels) / 255.0


def _write_parquet(path: Path, columns: Mapping[str, object], metadata: Mapping[str, str] | None = None) -> None:
    import pyarrow as pa
    from pyarrow import parquet

    def convert(values: object) -> Any:
        if isinstance(values, np.ndarray) and values.ndim == 2:
            return pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), values.shape[1])
        return pa.array(values)

    path.parent.mkdir(parents=True, exist_ok=True)
    table = pa.table({name: convert(values) for name, values in columns.items()})
    parquet.write_table(table.replace_schema_metadata(metadata), path, compression="snappy")


def _write_tasks(path: Path, tasks: Iterable[str]) -> None:
    """The tasks by number, in the form that pandas reads as a frame whose index is the task."""
    kinds = {"task": ("unicode", "object"), "task_index": ("int64", "int64")}
    columns = [
        {"name": name, "field_name": name, "pandas_type": kind, "numpy_type": numpy, "metadata": None}
        for name, (kind, numpy) in kinds.items()
    ]
    form = {"index_columns": ["task"], "column_indexes": [], "columns": columns, "pandas_version": "2.0.0"}
    named = list(tasks)
    _write_parquet(path, {"task": named, "task_index": list(range(len(named)))}, {"pandas": json.dumps(form)})
