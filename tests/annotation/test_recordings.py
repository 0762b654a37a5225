"""Recordings for Rerun, read back with Rerun's own reader, beside those of LeRobot's viewer."""

import sys
import warnings

import cv2
import numpy as np
import pytest
from lerobot_files import CAMERA, build
from segmented import FRONT, STATE, TOP, VECTOR, random_demonstrations

from dpmacro.annotation.recordings import require_rerun, write_recordings
from dpmacro.annotation.stages import Stages
from dpmacro.data.demonstrations import Demonstrations

pytest.importorskip("rerun", reason="Rerun is not here")
HOSTILE = ("pick <b>& $x", 'place "it" / там')
EPISODES = (4, 7, 5)


def stages_of(demonstrations, labels=None, names=HOSTILE):
    n_frames = int(demonstrations.lengths.sum())
    within = np.concatenate([np.arange(length) for length in demonstrations.lengths])
    corrected = np.zeros(n_frames, bool)
    corrected[: demonstrations.lengths[0]] = True
    labels = demonstrations.truth if labels is None else labels
    return Stages(
        labels,
        np.linspace(0, 1, n_frames),
        within < 3,
        corrected,
        names,
        demonstrations.lengths,
        EPISODES[: len(demonstrations.lengths)],
        within / demonstrations.fps,
        float(demonstrations.fps),
    )


@pytest.fixture(scope="module")
def demonstrations():
    return random_demonstrations(keys=(FRONT, TOP, STATE), vector=True)


@pytest.fixture(scope="module")
def written(demonstrations, tmp_path_factory):
    folder = tmp_path_factory.mktemp("rerun") / "all"
    write_recordings(folder, demonstrations, stages_of(demonstrations))
    return folder


def read(path):
    """The only recording of a file."""
    try:
        from rerun.recording import load_recording
    except ImportError:  # before 0.31
        from rerun.dataframe import load_recording
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        return load_recording(path)


def plain(path):
    return path.removeprefix("/").replace("\\", "")


def entities(recording):
    return {plain(column.entity_path) for column in recording.schema().component_columns()}


def rows(recording, entity, component):
    """The frames that have a component, and its values there, in lists of one."""
    if hasattr(recording, "chunks"):
        found = {}
        for chunk in recording.chunks():
            batch = chunk.to_record_batch()
            if plain(chunk.entity_path) == entity and component in batch.schema.names:
                columns = batch.to_pydict()
                found |= dict(zip(columns["frame_index"], columns[component], strict=True))
        return [*found], [*found.values()]
    (name,) = (
        one.name
        for one in recording.schema().component_columns()
        if plain(one.entity_path) == entity and one.component == component
    )
    path = name.removesuffix(f":{component}")
    table = recording.view(index="frame_index", contents=path).select("frame_index", name).read_all()
    kept = [
        (frame, value) for frame, value in zip(*map(list, table.to_pydict().values()), strict=True) if value
    ]
    return [frame for frame, _ in kept], [value for _, value in kept]


def test_a_file_for_every_demonstration_holds_all_its_numbers(written, demonstrations):
    stages = stages_of(demonstrations)
    assert {path.name for path in written.parent.iterdir()} == {"all"}
    assert {path.name for path in written.iterdir()} == {f"noise & more_episode_{k}.rrd" for k in EPISODES}
    recordings = [read(written / f"noise & more_episode_{k}.rrd") for k in EPISODES]
    assert {one.application_id() for one in recordings} == {"noise & more"}, "one blueprint is for all"
    assert len({one.recording_id() for one in recordings}) == 3, "a viewer would join them"
    for recording, part in zip(recordings, stages.trajectories, strict=True):
        for name, values in (
            ("action", demonstrations.actions),
            ("state", demonstrations.observations[STATE]),
            ("macro_action", stages.labels[:, None]),
            ("confidence", stages.confidence[:, None]),
            ("idle", stages.idle[:, None]),
            ("corrected", stages.corrected[:, None]),
        ):
            frames, found = rows(recording, name, "Scalars:scalars")
            assert frames == list(range(part.stop - part.start))
            assert np.allclose(found, values[part].astype(float))
        frames, texts = rows(recording, "subtask", "TextLog:text")
        assert frames == [0, (part.stop - part.start) // 2]
        assert texts == [[stages.names[stages.labels[part.start + frame]]] for frame in frames]
        assert {one.name for one in recording.schema().index_columns()} >= {"frame_index", "timestamp"}


def test_every_camera_has_its_frames(written, demonstrations):
    for place, part in enumerate(demonstrations.trajectories):
        recording = read(written / f"noise & more_episode_{EPISODES[place]}.rrd")
        for key in (FRONT, TOP):
            frames, found = rows(recording, key, "EncodedImage:blob")
            assert frames == list(range(part.stop - part.start))
            for frame, (blob,) in zip(frames, found, strict=True):
                image = cv2.imdecode(np.asarray(bytearray(blob), np.uint8), 1)[..., ::-1]
                stored = demonstrations.observations[key][part.start + frame]
                assert image.shape == stored.shape
                assert np.abs(image.mean((0, 1)) - stored.mean((0, 1))).max() < 8


def test_images_are_bounded_in_number_and_bytes(demonstrations, tmp_path):
    stages, shown = stages_of(demonstrations), {}
    for name, options in (("few", {"frames": 3}), ("cheap", {"budget": 20_000}), ("none", {"budget": 600})):
        write_recordings(tmp_path / name, demonstrations, stages, **options)
        blobs = [
            rows(read(path), key, "EncodedImage:blob")[1]
            for path in sorted((tmp_path / name).iterdir())
            for key in (FRONT, TOP)
            if key in entities(read(path))
        ]
        shown[name] = [len(own) for own in blobs], sum(len(blob) for own in blobs for (blob,) in own)
    assert shown["few"][0] == [3] * 6
    assert 0 < shown["cheap"][1] <= 20_000
    assert shown["none"][1] <= 600


def test_lerobots_viewer_has_the_same_names(tmp_path):
    """What lerobot-dataset-viz shows of a dataset is shown here under the same names."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset
    from lerobot.scripts.lerobot_dataset_viz import visualize_dataset

    root = build(tmp_path / "set")
    dataset = LeRobotDataset("test/set", root=root, episodes=[0])
    path = visualize_dataset(dataset, 0, save=True, output_dir=tmp_path / "theirs")
    demonstrations = Demonstrations.load(root)
    write_recordings(tmp_path / "ours", demonstrations, stages_of(demonstrations, np.arange(11) // 6 % 2))
    theirs, ours = read(path), read(tmp_path / "ours" / "set_episode_4.rrd")
    tops = {name.split("/")[0] for name in entities(theirs)} - {"__properties"}
    assert tops == {"action", "state", CAMERA} and tops <= entities(ours)
    lines = [{one.name for one in recording.schema().index_columns()} for recording in (theirs, ours)]
    assert {"frame_index", "timestamp"} <= lines[0] & lines[1]


def test_classes_and_long_vectors(tmp_path):
    demonstrations = random_demonstrations(keys=(FRONT,))
    write_recordings(tmp_path / "classes", demonstrations, stages_of(demonstrations))
    recording = read(tmp_path / "classes" / "noise & more_episode_4.rrd")
    assert rows(recording, "action", "Scalars:scalars")[1] == [[k] for k in demonstrations.actions[:12]]
    assert "state" not in entities(recording)


@pytest.mark.parametrize("broken", ["there", "stages", "camera"])
def test_what_is_refused_leaves_nothing(broken, demonstrations, tmp_path):
    folder, stages, cameras = tmp_path / "rerun", stages_of(demonstrations), None
    if broken == "there":
        folder.mkdir()
    elif broken == "stages":
        stages = stages.of_episodes(EPISODES[:2])
    else:
        cameras = {"front": lambda frames: iter(())}
    message = {"there": "rerun: exists already", "stages": "stages of 2", "camera": "front has 0 of the 28"}
    with pytest.raises(ValueError, match=message[broken]):
        write_recordings(folder, demonstrations, stages, cameras=cameras)
    assert list(tmp_path.rglob("*")) == ([folder] if broken == "there" else [])


def test_rerun_that_is_not_here_is_one_line_with_a_remedy(monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(ValueError, match=r"^Rerun cannot be imported .*pip install 'rerun-sdk>=") as caught:
        require_rerun()
    assert "\n" not in str(caught.value)


def test_names_of_numbers_are_written(written):
    recording = read(written / "noise & more_episode_4.rrd")
    component = "SeriesLines:names"
    if hasattr(recording, "chunks"):
        batches = [one.to_record_batch() for one in recording.chunks() if plain(one.entity_path) == "action"]
        (found,) = (one.to_pydict()[component] for one in batches if component in one.schema.names)
    else:
        view = recording.view(index="frame_index", contents="/action")
        found = view.select_static(f"/action:{component}").read_all().to_pydict()[f"/action:{component}"]
    assert found == [list(VECTOR)]
