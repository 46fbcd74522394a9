"""Many videos, tracked by processes that copy a table, and once by the real ones."""

from __future__ import annotations

import csv
import json
import os
import shutil
import subprocess
import sys
import time
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from mien._version import __version__
from mien.batch import BatchOptions, find_videos, run, track_all
from mien.batch import videos as find
from mien.cli import app
from mien.errors import MienError, MienWarning
from mien.geometry.rotation import FACING
from mien.output import destination, track_files
from mien.output.overlay_video import OverlayWriter
from mien.output.summary import Row, Summary
from mien.output.track import Track
from mien.output.track_files import ENDINGS
from mien.processes import Command
from mien.start.footage import requested_options
from mien.tracking.state import Estimate, Status
from videos import portrait_images, write_video

COPY = "import shutil, sys; [shutil.copy(sys.argv[1] + e, sys.argv[2] + e) for e in sys.argv[3:]]"
ALAS = "print('noise'); raise SystemExit('mien: alas')"
WARNED = f"""
import json, pathlib; {COPY}
settings = pathlib.Path(sys.argv[2] + ".json")
settings.write_text(json.dumps(json.loads(settings.read_text()) | {{"warnings": ["the face is turned"]}}))
"""
SLOW = "import os, pathlib, sys, time; pathlib.Path(sys.argv[2] + '.pid').write_text(str(os.getpid())); time.sleep(600)"
FINISHES = f"""
import os, pathlib, signal, sys, time

def finish(*_):
    {COPY}
    os._exit(0)

signal.signal(signal.SIGTERM, finish)
pathlib.Path(sys.argv[2] + ".pid").write_text(str(os.getpid()))
time.sleep(600)
"""
FIND = "import sys; from pathlib import Path; from mien import batch; batch.find_videos([Path(sys.argv[1])], Path('o'))"
AFTER_SLOW = """
import pathlib, sys, time
folder = pathlib.Path(sys.argv[2]).parent / "sub"
while len([p for p in folder.glob("*.pid") if p.read_text()]) < 2:
    time.sleep(0.01)
"""

CAMERA = '{"focal_px": 500, "cx": 160, "cy": 120}'
ASKED = {name: None for name in ("camera", "focal_px", "fov_deg", "start", "end", "fps", "face")} | {"at_once": False}


@pytest.fixture
def videos(tmp_path: Path) -> Path:
    folder = tmp_path / "videos"
    for name in ("a.mp4", "sub/b.avi", "sub/c.MOV"):
        file = folder / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(b"")
        os.utime(file, (0, 0))
    return folder


@pytest.fixture
def code(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> dict[str, str]:
    """What the process of a video does, by the video's name; if nothing is said, write a track of three frames."""
    R, t = FACING, np.array([0.0, 0.0, 9.0])
    states = ((Status.LOST, 0.0), (Status.INITIALIZED, 1.0), (Status.TRACKED, 0.3))
    estimates = [
        Estimate(k, 0.5 * k, status, *((None, None) if status is Status.LOST else (R, t)), confidence=sure)
        for k, (status, sure) in enumerate(states)
    ]
    metadata = {
        "mien": __version__, "complete": True, "preset": "realtime", "passes": 1, "asked": ASKED,
        "video": {"bytes": 0, "sha256": sha256(b"").hexdigest(), "width": 320, "height": 240},
    }  # fmt: skip
    Track.from_estimates(estimates, metadata).save(tmp_path / "done.csv")
    said: dict[str, str] = {}

    def command(row: Row, options: BatchOptions) -> Command:
        source, target = str(tmp_path / "done"), str(row.table.with_suffix(""))
        row.table.parent.mkdir(parents=True, exist_ok=True)  # as the real one does
        program = said.get(row.video.name, COPY)
        return Command(row.video.name, (sys.executable, "-c", program, source, target, *ENDINGS))

    monkeypatch.setattr(run, "_command", command)
    return said


def _summary(out: Path) -> list[dict[str, str]]:
    with (out / "summary.csv").open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def _done_with(folder: Path, options: BatchOptions) -> None:
    """Let the track that is copied come from these options."""
    done = Track.read(folder / "done.csv")
    asked = requested_options(options, options.at_once)
    metadata = {**done.metadata, "preset": options.preset, "asked": asked, **options._contents(done.metadata["video"])}
    Track(done.table, metadata).save(folder / "done.csv")


def _states(rows: list[Row]) -> list[str]:
    return [row.state for row in rows]


def test_tables_stand_as_the_videos_do(videos: Path, tmp_path: Path) -> None:
    out = videos / "tables"
    for hidden in (videos / ".trash" / "x.mp4", videos / "._a.mp4", out / "a.overlay.mp4", videos / "notes.txt"):
        hidden.parent.mkdir(exist_ok=True)
        hidden.write_bytes(b"")
    found = find_videos([videos, tmp_path / "videos" / "a.mp4"], out)
    assert found == [
        (videos / "a.mp4", out / "a.csv"),
        (videos / "sub/b.avi", out / "sub/b.csv"),
        (videos / "sub/c.MOV", out / "sub/c.csv"),
    ]


def test_folders_of_images_that_are_not_named_are_warned_of(
    videos: Path, tmp_path: Path, recwarn: pytest.WarningsRecorder
) -> None:
    """But not of plots and of pictures beside videos."""
    for name in ("seq1/1", "seq1/2", "sub/1", "sub/2", "alone/1", "plots/a", "plots/b", "out/1", "out/2"):
        (videos / name).parent.mkdir(exist_ok=True)
        (videos / f"{name}.png").write_bytes(b"")
    for name in ("plots/a", "plots/b"):
        (videos / f"{name}.csv").write_bytes(b"")
    out = videos / "out"
    assert len(find_videos([videos], out)) == 3
    shutil.copytree(videos / "seq1", videos / "seq2" / "images")
    assert len(find_videos([videos], out)) == 3
    assert len(find_videos([videos, videos / "seq1", videos / "seq2" / "images"], out)) == 5
    assert [str(warning.message) for warning in recwarn] == [
        f"{videos}/seq1 holds images; name the folder to track it",
        f"{videos}/seq1 holds images, as 1 more below {videos} do; name the folder to track it",
    ]


def test_videos_that_differ_by_their_ending_have_tables_of_their_own(videos: Path, tmp_path: Path) -> None:
    (videos / "a.mkv").write_bytes(b"")
    (videos / "sub" / "C.mp4").write_bytes(b"")  # c.csv and C.csv are one file on some systems
    found = find_videos([videos], tmp_path / "out")
    assert [table.name for _, table in found] == ["a.mkv.csv", "a.mp4.csv", "C.mp4.csv", "b.csv", "c.MOV.csv"]


def test_no_table_takes_the_place_of_another(tmp_path: Path) -> None:
    for name in ("pair.mp4", "pair.face1.mp4", "alone.face1.mp4", "summary.mp4", "sub/summary.mp4"):
        (tmp_path / "in" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "in" / name).write_bytes(b"")
    out = tmp_path / "out"
    tables = {str(table.relative_to(out)) for _, table in find_videos([tmp_path / "in"], out)}
    assert tables == {"pair.csv", "pair.face1.mp4.csv", "alone.face1.csv", "summary.mp4.csv", "sub/summary.csv"}
    (tmp_path / ".face1.mp4").write_bytes(b"")  # hidden, but named
    assert find_videos([tmp_path / ".face1.mp4"], out) == [(tmp_path / ".face1.mp4", out / ".face1.csv")]


@pytest.mark.parametrize(
    ("named", "expected"),
    [
        (["s1/a.mp4", "s2/a.mp4"], ["s1/a.csv", "s2/a.csv"]),
        (["s1", "s2"], ["s1/a.csv", "b.csv", "s2/a.csv"]),
        (["s2/a.mp4", "a.mp4", "s1/b.mp4"], ["s2/a.csv", "a.csv", "b.csv"]),
        (["s1/x/a.mp4", "s2/x/a.mp4"], ["s1/x/a.csv", "s2/x/a.csv"]),
        ([".", "s1/x/a.mp4"], ["a.csv", "s1/a.csv", "s1/b.csv", "s1/x/a.csv", "s2/a.csv", "s2/x/a.csv"]),
        (["s1/x/a.mp4", "s1/a.mp4", "s1/b.mp4"], ["x/a.csv", "a.csv", "b.csv"]),
        (["s1/b.mp4", "s2/a.mp4"], ["b.csv", "a.csv"]),
        (["s1/frames", "s2/frames", "s1/a.mp4"], ["s1/frames.csv", "s2/frames.csv", "a.csv"]),
        (["s1/x", "s1/frames"], ["a.csv", "frames.csv"]),
    ],
)
def test_videos_of_one_name_have_tables_in_the_folders_in_which_they_differ(
    named: list[str], expected: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As if the folder that holds them were named; others have theirs where they always are."""
    folder, out = tmp_path / "in", tmp_path / "out"
    videos = ("a.mp4", "s1/a.mp4", "s1/b.mp4", "s1/x/a.mp4", "s2/a.mp4", "s2/x/a.mp4")
    for name in (*videos, "s1/frames/1.png", "s2/frames/1.png"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(b"")
    if named == ["s1", "s2"]:
        shutil.rmtree(folder / "s1" / "x")
        shutil.rmtree(folder / "s2" / "x")
    monkeypatch.chdir(folder)
    for paths in ([Path(name) for name in named], [folder / name for name in named]):
        assert [table.relative_to(out).as_posix() for _, table in find_videos(paths, out)] == expected


def test_a_table_in_the_place_of_another_goes_further_apart(tmp_path: Path) -> None:
    paths = [tmp_path / name for name in ("all", "s1/a.mp4", "s2/a.mp4")]
    for name in ("all/s1/a.mp4", "s1/a.mp4", "s2/a.mp4"):
        (tmp_path / name).parent.mkdir(parents=True)
        (tmp_path / name).write_bytes(b"")
    tables = [table.relative_to(tmp_path / "out").as_posix() for _, table in find_videos(paths, tmp_path / "out")]
    assert tables == ["all/s1/a.csv", "s1/a.csv", "s2/a.csv"]


def test_all_videos_that_share_tables_go_apart_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """So that what it takes does not grow with the square of their number."""
    for name in (f"{folder}/{k}.mp4" for folder in ("s1", "s2") for k in range(20)):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(b"")
    looks, tables_of = list[Any](), find._tables
    monkeypatch.setattr(find, "_tables", lambda places: looks.append(places) or tables_of(places))
    found = find_videos([tmp_path / "s1", tmp_path / "s2"], tmp_path / "out")
    assert {table.relative_to(tmp_path / "out") for _, table in found} == {
        Path(folder, f"{k}.csv") for folder in ("s1", "s2") for k in range(20)
    }
    assert len(looks) == 2


def test_a_folder_of_images_that_is_named_is_a_video(code: dict[str, str], tmp_path: Path) -> None:
    """Beside videos, and deeper down, images are no video: plots are images too."""
    folder, out = tmp_path / "take.1", tmp_path / "out"
    (folder / "deeper").mkdir(parents=True)
    for image in ("1.png", "deeper/plot.png"):
        (folder / image).write_bytes(b"")
    assert find_videos([folder], out) == [(folder, out / "take.1.csv")]
    assert _states(track_all([folder], out)) == ["tracked"]
    options = BatchOptions(fps=10)
    assert _states(track_all([folder], out, options)) == ["tracked"]  # the track in place is of another rate
    assert options.arguments(folder) == [*BatchOptions().arguments(folder), "--fps", "10"]
    assert options.arguments(folder / "a.mp4") == BatchOptions().arguments(folder)  # it has times of its own
    (folder / "deeper" / "a.mp4").write_bytes(b"")
    assert find_videos([folder], out) == [(folder / "deeper" / "a.mp4", out / "deeper" / "a.csv")]


def test_odd_names_do_not_end_a_batch(videos: Path, code: dict[str, str], tmp_path: Path) -> None:
    """A name that is not UTF-8, a link to itself, and a folder that is named like a video."""
    strange = videos / os.fsdecode(b"lat\xe9in.mp4")
    try:
        strange.write_bytes(b"")
    except OSError:
        pytest.skip("this file system takes no such names")
    (videos / "loop.mp4").symlink_to("loop.mp4")
    (videos / "takes.mp4").mkdir()
    out = tmp_path / "out"
    found = {row.video.name for row in track_all([videos], out)}
    assert {"a.mp4", strange.name, "loop.mp4"} <= found
    assert "takes.mp4" not in found
    assert "lat\\udce9in.mp4" in (out / "summary.csv").read_text(encoding="utf-8")
    (videos / "loop.mp4").unlink()
    assert {row.state for row in track_all([videos], out)} == {"kept"}


def test_overlays_of_tables_are_no_videos(videos: Path, tmp_path: Path) -> None:
    for name in ("a.overlay.mp4", "a.csv", "film.overlay.mp4"):
        (videos / name).write_bytes(b"")
    names = {video.name for video, _ in find_videos([videos], tmp_path / "out")}
    assert names == {"a.mp4", "film.overlay.mp4", "b.avi", "c.MOV"}


def test_a_folder_that_cannot_be_read_is_named(videos: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scan = os.scandir

    def refuse(path: str) -> Any:
        if Path(path).name == "sub":
            raise PermissionError(13, "Permission denied", str(path))
        return scan(path)

    monkeypatch.setattr(os, "scandir", refuse)
    with pytest.warns(MienWarning, match=r"sub cannot be read \(permission denied\)"):
        assert [video.name for video, _ in find_videos([videos], tmp_path / "out")] == ["a.mp4"]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no pipes with a name")
def test_a_pipe_is_no_video(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.mp4")
    with pytest.raises(MienError, match=r"pipe.mp4: no such file or folder; .* a pipe"):
        find_videos([tmp_path / "pipe.mp4"], tmp_path / "out")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no pipes with a name")
def test_a_pipe_among_videos_is_not_waited_for(videos: Path, tmp_path: Path) -> None:
    os.mkfifo(videos / "pipe.mp4")
    subprocess.run([sys.executable, "-c", FIND, videos], cwd=tmp_path, check=True, timeout=60)


def test_what_cannot_be_begun(videos: Path, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "odd").mkdir()
    for name in ("a.avi", "a.mp4", "a.mp4.mkv"):
        (tmp_path / "odd" / name).write_bytes(b"")
    for paths, out, message in (
        ([tmp_path / "none"], tmp_path / "out", "none: no such file or folder"),
        ([tmp_path / "empty"], tmp_path / "out", "no video found; mien looks for .*.avi"),
        ([videos], videos, "holds the videos; choose another folder"),
        ([tmp_path / "odd"], tmp_path / "out", r"a.mp4 and .*a.mp4.mkv would share the table .*a.mp4.csv; rename one"),
    ):
        with pytest.raises(MienError, match=message):
            find_videos(paths, out)
    with pytest.raises(MienError, match="unknown tracker 'papper'"):
        track_all([videos], tmp_path / "out", BatchOptions(preset="papper"))
    for options, message in (
        (BatchOptions(end=float("nan")), "end is nan"),
        (BatchOptions(fps=0), "fps is 0"),
        (BatchOptions(focal_px=500, fov_deg=60), "in more than one way"),
        (BatchOptions(start=2, end=1), "must come before the end"),
        (BatchOptions(faces=0), "0 faces to track"),
        (BatchOptions(passes=3), "passes is 3; give 1 or 2"),
        (BatchOptions(passes=2, preset="morency-2008"), "morency-2008 learns nothing that a second pass could use"),
        (
            BatchOptions(gltf=True, preset="morency-2008"),
            "morency-2008 fits no face model and has no head for --gltf; omit",
        ),
    ):
        with pytest.raises(MienError, match=message):
            track_all([videos], tmp_path / "out", options)
    with pytest.raises(MienError, match="0 videos at a time"):
        track_all([videos], tmp_path / "out", jobs=0)
    assert not (tmp_path / "out" / "summary.csv").exists()


def test_a_video_that_is_named_twice_is_one(videos: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    one = [(videos / "a.mp4", out / "a.csv")]
    assert find_videos([videos / "a.mp4", videos / "sub" / ".." / "a.mp4"], out) == one
    assert len(find_videos([videos / "sub", videos], out)) == len(find_videos([videos], out))


def test_overlays_are_known_by_what_they_state(videos: Path, tmp_path: Path) -> None:
    with OverlayWriter(videos / "seen.mp4") as writer:
        writer.write(np.zeros((48, 64, 3), np.uint8), 0.0)
    assert not [video for video, _ in find_videos([videos], tmp_path / "out") if video.name == "seen.mp4"]


def test_every_video_is_a_row(videos: Path, code: dict[str, str], tmp_path: Path) -> None:
    code.update({"b.avi": ALAS, "c.MOV": WARNED})
    heard: list[tuple[int, int]] = []
    out = tmp_path / "out"
    rows = track_all([videos], out, jobs=2, progress=lambda done, total, name: heard.append((done, total)))
    assert _states(rows) == ["tracked", "failed", "tracked"]
    assert heard == [(0, 3), (1, 3), (2, 3), (3, 3)]
    first, second, third = _summary(out)
    expected = {"frames": "3", "duration": "1.0", "lost": "1", "unsure": "1", "begun": "0.5", "note": ""}
    assert first["confidence"] == "0.65"  # the mean of 1 and 0.3
    assert expected.items() <= first.items()
    assert (second["state"], second["frames"], second["note"]) == ("failed", "", "alas")
    assert third["note"] == "the face is turned"


def test_every_face_of_a_video_is_a_row(videos: Path, code: dict[str, str], tmp_path: Path) -> None:
    code["a.mp4"] = f"{COPY}; [shutil.copy(sys.argv[1] + e, sys.argv[2] + '.face1' + e) for e in sys.argv[3:]]"
    done, out, options = tmp_path / "done.json", tmp_path / "out", BatchOptions(faces=2)
    done.write_text(json.dumps({**json.loads(done.read_text()), "faces": 2, "faces_wanted": 2}))
    assert _states(track_all([videos / "a.mp4"], out, options)) == ["tracked"]
    rows = _summary(out)
    assert [(Path(row["table"]).name, row["face_id"], row["faces"]) for row in rows] == [
        ("a.csv", "0", "2"), ("a.face1.csv", "1", "2"),
    ]  # fmt: skip
    assert [row["lost"] for row in rows] == ["1", "1"]
    assert _states(track_all([videos / "a.mp4"], out, options)) == ["kept"]
    assert len(_summary(out)) == 2
    (out / "a.face1.csv").write_bytes(b"")
    assert _states(track_all([videos / "a.mp4"], out, options)) == ["tracked"]
    (out / "a.face1.parquet").unlink()
    assert _states(track_all([videos / "a.mp4"], out, options)) == ["tracked"]
    assert _states(track_all([videos / "a.mp4"], out)) == ["tracked"]  # of which one face is wanted now


@pytest.mark.parametrize(
    ("end", "reason"),
    [
        ("import os; os.abort()", "the process crashed (SIGABRT)"),
        ("import os, signal; os.kill(os.getpid(), signal.SIGKILL)", "the process crashed (SIGKILL)"),
        ("raise RuntimeError('alas')", "RuntimeError: alas"),
        ("raise SystemExit('mien: alas')", "alas"),
    ],
)
def test_a_failure_has_its_reason_whatever_was_warned_of(
    end: str, reason: str, videos: Path, code: dict[str, str], tmp_path: Path
) -> None:
    code["a.mp4"] = f"import sys; print('mien: the face is turned', file=sys.stderr, flush=True); {end}"
    assert track_all([videos / "a.mp4"], tmp_path / "out")[0].note == f"{reason}; the face is turned"


@pytest.mark.parametrize("between", [": ", " "])
def test_a_note_does_not_repeat_the_name_of_its_video(
    between: str, videos: Path, code: dict[str, str], tmp_path: Path
) -> None:
    video, done = videos / "a.mp4", tmp_path / "done.json"
    known = json.loads(done.read_text())
    known |= {"warnings": [f"{video}{between}alas"], "video": known["video"] | {"name": str(video)}}
    done.write_text(json.dumps(known))
    assert track_all([video], tmp_path / "out")[0].note == "alas"
    code["a.mp4"] = f"import sys; print({f'mien: {video}{between}alas'!r}, file=sys.stderr); sys.exit(2)"
    assert track_all([video], tmp_path / "out", BatchOptions(again=True))[0].note == (
        "alas; a.csv is from an earlier run"
    )


def test_what_is_done_is_kept(videos: Path, code: dict[str, str], tmp_path: Path) -> None:
    out = tmp_path / "out"
    code["b.avi"] = ALAS
    track_all([videos], out)
    del code["b.avi"]
    rows = track_all([videos], out)
    assert _states(rows) == ["kept", "tracked", "kept"]
    assert (rows[0].frames, rows[0].lost, rows[0].begun) == (3, 1, 0.5)
    assert _states(track_all([videos], out, BatchOptions(again=True))) == ["tracked"] * 3


def test_a_face_that_was_chosen_by_hand_is_kept(videos: Path, code: dict[str, str], tmp_path: Path) -> None:
    out = tmp_path / "out"
    track_all([videos / "a.mp4"], out)
    settings = out / "a.json"
    known = json.loads(settings.read_text())
    settings.write_text(json.dumps({**known, "asked": {**known["asked"], "face": [230.0, 300.0]}}))
    assert _states(track_all([videos / "a.mp4"], out)) == ["kept"]


def test_of_a_table_that_is_kept_little_is_read(
    videos: Path, code: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not its CSV, unless that was edited, and of one that was made with other options nothing at all: a run that goes
    on does not take minutes before it begins. It says how far it is."""
    out, read, heard = tmp_path / "out", list[str](), list[int]()
    track_all([videos], out)
    for ending in ("csv", "parquet"):
        whole = getattr(track_files, f"_read_{ending}")
        monkeypatch.setattr(
            track_files, f"_read_{ending}", lambda path, only, whole=whole: read.append(path.name) or whole(path, only)
        )
    rows = track_all([videos], out, progress=lambda done, total, name: heard.append(done))
    assert (_states(rows), heard) == (["kept"] * 3, [1, 2, 3, 3])
    assert read == ["a.parquet", "b.parquet", "c.parquet"]
    lines = (out / "a.csv").read_text().splitlines()
    (out / "a.csv").write_text("\n".join(lines[:-1]))
    _touch(out / "a.csv")
    row = track_all([videos / "a.mp4"], out)[0]
    assert (row.state, row.frames, read[3:]) == ("kept", 2, ["a.csv"])
    assert run._kept_rows(Row(videos / "a.mp4", out / "a.csv"), BatchOptions(end=2)) is None
    assert len(read) == 4


def _written_over(video: Path, metadata: Path) -> None:
    """Let a video that has been tracked be the same file with other content of the same length."""
    known = json.loads(metadata.read_text())
    tracked = known["video"] | {"inode": video.stat().st_ino, "sha256": sha256(b"what it was").hexdigest()}
    metadata.write_text(json.dumps(known | {"video": tracked}))
    _touch(video)


def _touch(file: Path) -> None:
    """Let a file be newer than everything else."""
    os.utime(file, (time.time() + 10, time.time() + 10))


def test_a_video_with_a_newer_time_and_the_same_content_is_kept(
    videos: Path, code: dict[str, str], tmp_path: Path
) -> None:
    """As after a folder was copied, or fetched from a server once more."""
    track_all([videos], tmp_path / "out")
    for video in videos.rglob("*.*"):
        _touch(video)
    assert _states(track_all([videos], tmp_path / "out")) == ["kept"] * 3


def test_a_video_that_an_older_one_has_replaced_is_done_again(
    videos: Path, code: dict[str, str], tmp_path: Path
) -> None:
    """As by `cp -p`, which keeps its time."""
    track_all([videos], tmp_path / "out")
    _written_over(videos / "a.mp4", tmp_path / "out" / "a.json")
    os.utime(videos / "a.mp4", (0, 0))
    assert _states(track_all([videos / "a.mp4"], tmp_path / "out")) == ["tracked"]


def test_what_is_not_as_asked_is_done_again(videos: Path, code: dict[str, str], tmp_path: Path) -> None:
    out = tmp_path / "out"
    track_all([videos], out)
    _written_over(videos / "a.mp4", out / "a.json")
    half = out / "sub" / "b.json"
    half.write_text(json.dumps({**json.loads(half.read_text()), "complete": False}))
    (out / "sub" / "c.parquet").unlink()
    assert _states(track_all([videos], out)) == ["tracked"] * 3
    half.write_text(json.dumps({**json.loads(half.read_text()), "mien": "0.0.1"}))
    assert _states(track_all([videos / "sub"], out / "sub")) == ["tracked", "kept"]
    (videos / "a.mp4").write_bytes(b"another video")
    os.utime(videos / "a.mp4", (0, 0))
    assert _states(track_all([videos / "a.mp4"], out)) == ["tracked"]
    assert _states(track_all([videos / "sub"], out / "sub")) == ["kept"] * 2
    camera = tmp_path / "camera.json"
    camera.write_text(CAMERA)
    os.utime(camera, (0, 0))
    other = (
        BatchOptions(preset="paper"),
        BatchOptions(passes=2),
        BatchOptions(overlay=True),
        BatchOptions(plot=True),
        BatchOptions(gltf=True),
        BatchOptions(camera=camera),
    )
    for options in (
        *other,
        BatchOptions(focal_px=500),
        BatchOptions(fov_deg=30),
        BatchOptions(start=1),
        BatchOptions(end=2),
        BatchOptions(at_once=True),
    ):
        assert _states(track_all([videos / "sub"], out / "sub", options)) == ["tracked"] * 2


def test_videos_that_exchange_their_names_are_tracked_again(videos: Path, code: dict[str, str], tmp_path: Path) -> None:
    """They have the same size, and are older than their tables."""
    out, sub, place = tmp_path / "out", videos / "sub", videos / "place.mp4"
    track_all([videos], out)
    for video in (videos / "a.mp4", sub / "b.avi", sub / "c.MOV"):
        file = (out / video.relative_to(videos)).with_suffix(".json")
        known = {"bytes": 0, "sha256": video.name, "inode": video.stat().st_ino}
        file.write_text(json.dumps({**json.loads(file.read_text()), "video": known}))
    (sub / "b.avi").rename(place)
    (sub / "c.MOV").rename(sub / "b.avi")
    place.rename(sub / "c.MOV")
    assert _states(track_all([videos], out)) == ["kept", "tracked", "tracked"]


def test_a_video_that_has_moved_is_kept(videos: Path, code: dict[str, str], tmp_path: Path) -> None:
    out = tmp_path / "out"
    track_all([videos], out)
    shutil.copytree(videos, tmp_path / "copy")
    assert _states(track_all([tmp_path / "copy"], out)) == ["kept"] * 3


def test_the_table_of_another_video_is_not_replaced(videos: Path, code: dict[str, str], tmp_path: Path) -> None:
    """As of the same camera's video of another day, in a folder of its own."""
    out = tmp_path / "out"
    track_all([videos], out)
    shutil.copytree(videos, tmp_path / "other")
    (tmp_path / "other" / "a.mp4").write_bytes((videos / "a.mp4").read_bytes() + b"0")
    before = (out / "a.csv").read_bytes()
    with pytest.raises(MienError, match=r"a\.csv is the table of .*a\.mp4, by .*; choose another folder with -o"):
        track_all([tmp_path / "other"], out)
    assert (out / "a.csv").read_bytes() == before
    (out / "a.csv").unlink()
    assert _states(track_all([tmp_path / "other"], out)) == ["tracked", "kept", "kept"]


def test_tables_of_videos_that_are_named_alike_from_elsewhere_are_not_replaced(
    videos: Path, code: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for day in ("monday", "tuesday"):
        shutil.copytree(videos, tmp_path / day / "videos")
    (tmp_path / "tuesday" / "videos" / "a.mp4").write_bytes(b"another")
    monkeypatch.chdir(tmp_path / "monday")
    track_all([Path("videos")], Path("../out"))
    monkeypatch.chdir(tmp_path / "tuesday")
    with pytest.raises(MienError, match=r"a\.csv is the table of .*monday.videos.a\.mp4"):
        track_all([Path("videos")], Path("../out"))


def test_a_video_that_can_no_longer_be_read_is_tried_again(
    videos: Path, code: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def checksum(path: Path) -> str:
        raise PermissionError(path)

    out = tmp_path / "out"
    track_all([videos], out)
    monkeypatch.setattr(destination, "checksum", checksum)
    assert _states(track_all([videos], out)) == ["tracked"] * 3


def test_files_of_an_earlier_run_are_noted(videos: Path, code: dict[str, str], tmp_path: Path) -> None:
    out = tmp_path / "out"
    track_all([videos], out)
    (out / "a.png").write_bytes(b"")
    code["b.avi"] = ALAS
    rows = track_all([videos], out, BatchOptions(again=True))
    assert [row.note for row in rows] == ["a.png is from an earlier run", "alas; b.csv is from an earlier run", ""]


def test_each_folder_is_entered_once_also_by_links(videos: Path, tmp_path: Path) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "d.mp4").write_bytes(b"")
    for name, target in (("far", elsewhere), ("far2", elsewhere), ("again", videos / "sub"), ("up", tmp_path)):
        (videos / name).symlink_to(target)
    (elsewhere / "back").symlink_to(videos)
    deeper = elsewhere / "deeper"
    deeper.mkdir()
    (deeper / "e.mp4").write_bytes(b"")
    (deeper / "up").symlink_to(elsewhere)
    (videos / "deeper").symlink_to(deeper)
    (videos / ".store").mkdir()
    (videos / ".store" / "f.mp4").write_bytes(b"")
    (videos / "shown").symlink_to(videos / ".store")
    pairs = find_videos([videos], tmp_path / "out")
    found = {str(video.resolve().relative_to(tmp_path)): table for video, table in pairs}
    assert len(pairs) == len(found) == 6
    assert found["videos/a.mp4"] == tmp_path / "out" / "a.csv"
    assert found["videos/sub/b.avi"] == tmp_path / "out" / "sub" / "b.csv"
    assert found["videos/.store/f.mp4"] == tmp_path / "out" / "shown" / "f.csv"
    assert {"elsewhere/d.mp4", "elsewhere/deeper/e.mp4", "videos/sub/c.MOV"} < set(found)


def test_a_link_to_a_video_does_not_move_its_table(videos: Path, tmp_path: Path) -> None:
    before = find_videos([videos], tmp_path / "out")
    (videos / "0_best.mp4").symlink_to(videos / "sub" / "b.avi")
    assert find_videos([videos], tmp_path / "out") == before


@pytest.mark.parametrize(
    ("file", "content", "changed", "options"),
    [
        (
            "own.json",
            '{"adaptation": {"view_rate": 0}}',
            '{"adaptation": {"view_rate": 0.5}}',
            BatchOptions(preset="realtime:own.json"),
        ),
        ("camera.json", CAMERA, CAMERA.replace("500", "600"), BatchOptions(camera=Path("camera.json"))),
        ("camera.json", '{"focal_px": 500}', '{"focal_px": 600}', BatchOptions(camera=Path("camera.json"))),
    ],
)
def test_what_the_files_of_settings_and_camera_say_counts_and_not_when_they_were_written(
    file: str, content: str, changed: str, options: BatchOptions,
    videos: Path, code: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    own, out = tmp_path / file, tmp_path / "out"
    own.write_text(content)
    _done_with(tmp_path, options)
    track_all([videos], out, options)
    _touch(own)
    assert _states(track_all([videos], out, options)) == ["kept"] * 3
    own.write_text(changed)
    os.utime(own, (0, 0))  # as of a file that was moved here
    assert _states(track_all([videos], out, replace(options))) == ["tracked"] * 3


def test_a_tracker_of_your_own_that_has_changed_is_used(
    videos: Path, code: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    own, out = tmp_path / "changing_tracker.py", tmp_path / "out"
    own.write_text("class Own:\n    initialize = track = None.__init__\n")
    options = BatchOptions(preset="changing_tracker:Own")
    _done_with(tmp_path, options)
    track_all([videos], out, options)
    assert _states(track_all([videos], out, options)) == ["kept"] * 3
    _touch(own)
    assert _states(track_all([videos], out, options)) == ["tracked"] * 3


def test_what_was_noted_of_a_video_is_kept_with_it(videos: Path, code: dict[str, str], tmp_path: Path) -> None:
    code["a.mp4"] = WARNED
    out = tmp_path / "out"
    for state in ("tracked", "kept"):
        row = track_all([videos / "a.mp4"], out)[0]
        assert (row.state, row.note) == (state, "the face is turned")
    (out / "summary.csv").unlink()
    assert track_all([videos / "a.mp4"], out)[0].note == "the face is turned"
    del code["a.mp4"]
    assert track_all([videos / "a.mp4"], out, BatchOptions(again=True))[0].note == ""


def test_what_was_noted_is_kept_however_the_videos_are_named(
    videos: Path, code: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    code["b.avi"] = WARNED
    out = tmp_path / "out"
    track_all([videos], out)
    monkeypatch.chdir(videos)
    assert [row.note for row in track_all([Path(".")], Path("../out"))] == ["", "the face is turned", ""]
    monkeypatch.chdir(tmp_path)
    assert [row.note for row in track_all([Path("videos")], Path("out"))] == ["", "the face is turned", ""]
    out.rename(tmp_path / "moved")
    assert [row.note for row in track_all([videos], tmp_path / "moved")] == ["", "the face is turned", ""]


def test_the_summary_keeps_what_a_run_over_some_of_the_videos_was_not_asked_for(
    videos: Path, code: dict[str, str], tmp_path: Path
) -> None:
    code.update({"b.avi": WARNED, "c.MOV": ALAS})
    out = tmp_path / "out"
    track_all([videos], out)
    first, *others = _summary(out)
    assert _states(track_all([videos / "a.mp4"], out)) == ["kept"]
    assert _summary(out) == [first | {"state": "kept"}, *others]
    (videos / "sub" / "c.MOV").unlink()  # and it has no table
    track_all([videos / "a.mp4"], out)
    assert _summary(out) == [first | {"state": "kept"}, others[0]]
    assert [row.note for row in track_all([videos], out)] == ["", "the face is turned"]


@pytest.mark.parametrize("options", [BatchOptions(), BatchOptions(again=True)])
def test_what_users_add_to_the_summary_stays(
    options: BatchOptions, videos: Path, code: dict[str, str], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    track_all([videos], out)
    before = _summary(out)
    with (out / "summary.csv").open("w", encoding="utf-8", newline="") as stream:
        writer = csv.DictWriter(stream, ["condition", *before[0], "group"])
        writer.writeheader()
        writer.writerows(row | {"condition": f"c{k}", "group": "1,2"} for k, row in enumerate(before))
    (videos / "d.mp4").write_bytes(b"")
    for paths in ([videos / "a.mp4"], [videos]):
        track_all(paths, out, options)
    added = [(Path(row["video"]).name, row["condition"], row["group"]) for row in _summary(out)]
    assert added == [("a.mp4", "c0", "1,2"), ("d.mp4", "", ""), ("b.avi", "c1", "1,2"), ("c.MOV", "c2", "1,2")]


def test_a_video_whose_table_has_another_name_is_one_row_with_what_users_have_added(
    videos: Path, code: dict[str, str], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    track_all([videos / "sub"], out)
    text = (out / "summary.csv").read_text(encoding="utf-8")
    lines = [f"{line},{cell}" for line, cell in zip(text.splitlines(), ("condition", "x", "y"), strict=True)]
    (out / "summary.csv").write_text("\n".join(lines), encoding="utf-8")
    (videos / "sub" / "b.mp4").write_bytes(b"")  # converted from the other
    with pytest.warns(
        MienWarning, match=r"out.b\.csv is left from an earlier run; the table of .*b\.avi is now b\.avi\.csv"
    ):
        track_all([videos / "sub"], out)
    added = [(Path(row["video"]).name, row["table"], row["condition"]) for row in _summary(out)]
    assert added == [("b.avi", "b.avi.csv", "x"), ("b.mp4", "b.mp4.csv", ""), ("c.MOV", "c.csv", "y")]
    (videos / "sub" / "b.mp4").unlink()
    with pytest.warns(MienWarning, match=r"is now b\.csv"):
        track_all([videos / "sub"], out)
    assert [row["condition"] for row in _summary(out)][:2] == ["x", "y"]


def test_a_summary_that_a_spreadsheet_has_saved_is_read(videos: Path, code: dict[str, str], tmp_path: Path) -> None:
    code["a.mp4"] = WARNED
    summary = tmp_path / "out" / "summary.csv"
    track_all([videos], summary.parent)
    summary.write_text(summary.read_text().replace(",", ";"), encoding="utf-8-sig")
    assert track_all([videos], summary.parent)[0].note == "the face is turned"


def test_the_row_of_a_video_that_is_named_like_a_first_face_stays(tmp_path: Path) -> None:
    summary = tmp_path / "summary.csv"
    for name in ("a", "a.face0"):
        Summary.read(summary).write([[Row(tmp_path / f"{name}.mp4", tmp_path / f"{name}.csv")]])
        (tmp_path / f"{name}.csv").touch()
    Summary.read(summary).write([[Row(tmp_path / "a.mp4", tmp_path / "a.csv")]])
    assert [row["table"] for row in _summary(tmp_path)] == ["a.csv", "a.face0.csv"]


def test_a_summary_that_can_be_read_only_in_part_is_not_replaced(tmp_path: Path) -> None:
    """As a spreadsheet saves it in another encoding; it is read in pieces, of which the first can be."""
    faces = "".join(f"/v/{k}.mp4,{k}.csv,tracked,0,a\n" for k in range(10_000))
    for note, message in (
        ("caf\xe9", "is not in UTF-8, .*; save it once more, as CSV UTF-8"),
        ("a" * 200_000, "exists and is not a summary by mien batch"),
    ):
        text = f"video,table,state,face_id,note\n{faces}/v/x.mp4,x.csv,tracked,0,{note}\n"
        (tmp_path / "summary.csv").write_bytes(text.encode("cp1252"))
        with pytest.raises(MienError, match=message):
            Summary.read(tmp_path / "summary.csv")


@pytest.mark.parametrize(("names", "cells", "several"), [("note,", ",mine,", "'note'"), (",", ",a,b", "''")])
def test_columns_of_one_name_are_refused_before_one_is_lost(
    names: str, cells: str, several: str, tmp_path: Path
) -> None:
    (tmp_path / "summary.csv").write_text(f"video,table,state,face_id,note,{names}\n/v/a.mp4,a.csv,tracked,0,{cells}\n")
    with pytest.raises(MienError, match=f"has several columns {several}; give each a name of its own"):
        Summary.read(tmp_path / "summary.csv")


@pytest.mark.parametrize("content", [b"name,age\nMia,7\n", b"frame,timestamp\n", b"\xff\x00"])
def test_the_summary_of_others_is_not_replaced(
    content: bytes, videos: Path, code: dict[str, str], tmp_path: Path
) -> None:
    summary = tmp_path / "out" / "summary.csv"
    summary.parent.mkdir()
    summary.write_bytes(content)
    with pytest.raises(MienError, match=r"out.summary\.csv exists and is not a summary by mien batch; choose another"):
        track_all([videos], summary.parent)
    assert summary.read_bytes() == content
    summary.write_bytes(b"")  # as of `mktemp`
    assert _states(track_all([videos], summary.parent)) == ["tracked"] * 3


def test_what_was_noted_outlives_a_run_that_is_killed(videos: Path, code: dict[str, str], tmp_path: Path) -> None:
    code["a.mp4"] = WARNED
    out, left = tmp_path / "out", tmp_path / "left"

    def look(done: int, total: int, name: str) -> None:
        if done == 1:  # what a run that is killed now leaves behind
            shutil.copytree(out, left, ignore=shutil.ignore_patterns("*.lock"))  # this process lives

    track_all([videos], out, jobs=1, progress=look)
    assert [(row["state"], row["note"]) for row in _summary(left)][:1] == [("tracked", "the face is turned")]
    rows = track_all([videos], left)
    assert [(row.state, row.note) for row in rows] == [("kept", "the face is turned"), ("tracked", ""), ("tracked", "")]


def test_a_video_that_outlives_a_run_that_is_killed_has_its_warnings(
    videos: Path, code: dict[str, str], tmp_path: Path
) -> None:
    code["a.mp4"] = WARNED
    out, left = tmp_path / "out", tmp_path / "left"

    def look(done: int, total: int, name: str) -> None:
        if done == 0:  # what a run leaves behind that is killed now
            shutil.copytree(out, left, ignore=shutil.ignore_patterns("*.lock"))  # this process lives

    track_all([videos], out, jobs=1, progress=look)
    for ending in ENDINGS:
        shutil.copy(out / f"a{ending}", left)
    for _ in range(2):
        first = track_all([videos], left)[0]
        assert (first.state, first.note) == ("kept", "the face is turned")


def test_a_video_with_a_long_name_is_tracked(videos: Path, code: dict[str, str], tmp_path: Path) -> None:
    """Its overlay's name would be longer than file systems allow."""
    (videos / f"{245 * 'n'}.mp4").write_bytes(b"")
    for state in ("tracked", "kept"):
        assert _states(track_all([videos], tmp_path / "out")) == [state] * 4


def test_a_video_whose_name_is_too_long_for_a_table_is_a_row(
    videos: Path, code: dict[str, str], tmp_path: Path
) -> None:
    for ending in ("mp4", "avi"):  # the names of their tables include it
        (videos / f"{251 * 'n'}.{ending}").write_bytes(b"")
    assert _states(track_all([videos], tmp_path / "out")) == ["tracked", "failed", "failed", "tracked", "tracked"]


def test_a_damaged_table_is_made_again(videos: Path, code: dict[str, str], tmp_path: Path) -> None:
    out = tmp_path / "out"
    track_all([videos], out)
    lines = (out / "a.csv").read_text().splitlines()
    (out / "a.csv").write_text("\n".join(f"{line},{line.split(',')[0]}" for line in lines))  # the first column again
    (out / "sub" / "b.json").write_text("{")
    (out / "sub" / "c.json").write_text("[]")
    assert _states(track_all([videos], out)) == ["tracked"] * 3


@pytest.mark.parametrize("changed", [{"video": "b.mp4"}, {"video": {}}, {"faces": "2"}, {"faces": None}, {"faces": 0}])
def test_a_table_whose_settings_are_not_understood_is_made_again(
    videos: Path, code: dict[str, str], tmp_path: Path, changed: dict[str, Any]
) -> None:
    out = tmp_path / "out"
    track_all([videos], out)
    settings = out / "a.json"
    settings.write_text(json.dumps(json.loads(settings.read_text()) | changed))
    assert _states(track_all([videos], out)) == ["tracked", "kept", "kept"]
    assert _states(track_all([videos], out)) == ["kept"] * 3


def _stop_after_the_first(videos: Path, out: Path) -> None:
    """Ctrl-C when the first of three videos that are tracked at a time is done."""

    def stop(done: int, total: int, name: str) -> None:
        if done:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        track_all([videos], out, jobs=3, progress=stop)


def test_stopped_it_says_what_is_done(videos: Path, code: dict[str, str], tmp_path: Path) -> None:
    code.update({"a.mp4": AFTER_SLOW + COPY, "b.avi": SLOW, "c.MOV": SLOW})
    out = tmp_path / "out"
    with pytest.warns(MienWarning, match="stopped; 1 of 3 videos are done"):
        _stop_after_the_first(videos, out)
    assert [row["state"] for row in _summary(out)] == ["tracked", "not yet", "not yet"]
    running = [int(file.read_text()) for file in (out / "sub").glob("*.pid")]
    assert len(running) == 2
    for pid in running:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)


def test_stopped_it_counts_what_was_finished_meanwhile(videos: Path, code: dict[str, str], tmp_path: Path) -> None:
    code.update({"a.mp4": AFTER_SLOW + COPY, "b.avi": FINISHES, "c.MOV": SLOW})
    out = tmp_path / "out"
    with pytest.warns(MienWarning, match="stopped; 2 of 3 videos are done"):
        _stop_after_the_first(videos, out)
    assert [row["state"] for row in _summary(out)] == ["tracked", "kept", "not yet"]


def test_writing_the_summary_takes_a_small_share_of_the_time(
    videos: Path, code: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However many videos it lists: here writing takes as long as tracking a video."""
    for k in range(9):
        (videos / f"{k}.mp4").write_bytes(b"")
    clock, writes, write = [0.0], list[float](), Summary.write

    def one_second(summary: Summary, found: Any) -> None:
        clock[0] += 1.0
        writes.append(clock[0])
        write(summary, found)

    def another(done: int, total: int, name: str) -> None:
        clock[0] += 1.0

    monkeypatch.setattr(run, "monotonic", lambda: clock[0])
    monkeypatch.setattr(Summary, "write", one_second)
    out = tmp_path / "out"
    track_all([videos], out, jobs=1, progress=another)
    assert len(writes) == 3  # before the first video, after it, and in the end
    assert [row["state"] for row in _summary(out)] == ["tracked"] * 12


def test_stopped_before_it_is_tracked_again_a_video_keeps_what_was_noted(
    videos: Path, code: dict[str, str], tmp_path: Path
) -> None:
    """Also if its process has finished nevertheless, which then had no warnings."""
    code.update({"a.mp4": WARNED, "b.avi": WARNED, "c.MOV": WARNED})
    out, last = tmp_path / "out", tmp_path / "out" / "sub" / "b.parquet"
    track_all([videos], out)
    code["b.avi"] = f"{COPY}; {SLOW}"

    for reached, state, note in ((0, "not yet", "the face is turned"), (1, "kept", "")):
        before = last.stat().st_mtime_ns

        def stop(done: int, total: int, name: str, reached: int = reached, before: int = before) -> None:
            while done and last.stat().st_mtime_ns == before:
                time.sleep(0.01)
            if done == reached:
                raise KeyboardInterrupt

        with pytest.warns(MienWarning, match="the same command tracks all of them"), pytest.raises(KeyboardInterrupt):
            track_all([videos], out, BatchOptions(again=True), jobs=2, progress=stop)
        assert [row["state"] for row in _summary(out)][1:] == [state, "not yet"]
        rows = track_all([videos], out)
        assert _states(rows) == ["kept"] * 3
        assert rows[1].note == note
        assert rows[0].note == rows[2].note == "the face is turned"


def test_two_runs_do_not_write_into_one_folder(videos: Path, code: dict[str, str], tmp_path: Path) -> None:
    """The second is refused, and leaves what the first has written."""
    out, noted = tmp_path / "out", list[bytes]()

    def meanwhile(done: int, total: int, name: str) -> None:
        noted.append((out / "summary.csv").read_bytes())
        with pytest.raises(MienError, match="out is in use by another mien batch"):
            track_all([videos / "a.mp4"], out)
        assert (out / "summary.csv").read_bytes() == noted[-1]

    track_all([videos], out, jobs=1, progress=meanwhile)
    assert len(noted) == 4
    assert _states(track_all([videos], out)) == ["kept"] * 3
    assert not list(out.glob(".*"))


def test_the_whole_of_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    videos, out = tmp_path / "videos", tmp_path / "out"
    videos.mkdir()
    monkeypatch.chdir(videos)
    write_video(videos / "-face.mkv", portrait_images())
    (videos / "broken.mp4").write_bytes(b"no video")
    camera, own = tmp_path / "camera.json", tmp_path / "own.json"
    camera.write_text(CAMERA)
    own.write_text('{"adaptation": {"view_rate": 0}}')
    asked = ["batch", ".", "-o", str(out), "--camera", str(camera), "--preset", f"realtime:{own}"]
    asked += ["--end", "10", "--at-once", "--overlay", "--plot", "--gltf"]
    result = CliRunner().invoke(app, asked)
    assert result.exit_code == 2
    assert "1 of 2 videos tracked" in result.output
    assert "mien: broken.mp4: cannot be read as a video" in result.output
    assert "1 of 2 videos could not be tracked" in result.output
    made = sorted(p.name for p in out.iterdir())
    endings = (".csv", ".glb", ".json", ".overlay.mp4", ".parquet", ".png")
    assert made == [*(f"-face{ending}" for ending in endings), "summary.csv"]
    assert json.loads((out / "-face.json").read_text())["camera"]["focal_px"] == 500
    (videos / "broken.mp4").unlink()
    again = CliRunner().invoke(app, asked)
    assert again.exit_code == 0
    assert "0 of 1 videos tracked, 1 already done" in again.output


def test_pictures_of_an_earlier_track_are_made_again(tmp_path: Path) -> None:
    video, out = write_video(tmp_path / "face.mkv", portrait_images()), tmp_path / "out"
    drawn = BatchOptions(at_once=True, overlay=True, plot=True, gltf=True)
    later = replace(drawn, start=0.04)
    alone = replace(later, overlay=False, plot=False, gltf=False)
    for options, state in (
        (drawn, "tracked"), (alone, "tracked"), (later, "tracked"), (later, "kept"), (alone, "kept"), (later, "kept"),
    ):  # fmt: skip
        assert _states(track_all([video], out, options)) == [state]
    known = json.loads((out / "face.json").read_text())
    assert (known["overlay"], known["plot"], known["gltf"]) == ("face.overlay.mp4", "face.png", "face.glb")
    head = out / "face.glb"
    begun = head.stat().st_mtime_ns
    head.unlink()  # as where a run was interrupted before it was written
    assert _states(track_all([video], out, later)) == ["tracked"]
    assert head.stat().st_mtime_ns > begun
