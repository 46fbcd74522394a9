"""What is read of a file, and what is none."""

from __future__ import annotations

import itertools
import re
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from av.stream import Disposition

from mien.errors import MienError, MienWarning
from mien.video import open_video
from videos import frames_of, gradient, write_video


def test_damage_in_the_middle_does_not_end_the_video(tmp_path: Path) -> None:
    images = [gradient(i) for i in range(20)]
    path = write_video(tmp_path / "hole.avi", images, codec="mjpeg", pix_fmt="yuvj420p")
    content = bytearray(path.read_bytes())
    starts = [i for i in range(len(content)) if content.startswith(b"00dc", i)]
    content[starts[10] + 8 : starts[11]] = bytes(starts[11] - starts[10] - 8)
    path.write_bytes(content)
    with pytest.warns(MienWarning, match="truncated or damaged: 19 of 20"):
        frames = list(open_video(path))
    np.testing.assert_allclose([f.time for f in frames[-2:]], [18 / 25, 19 / 25])


@pytest.mark.parametrize(("name", "codec"), [("x.mp4", "libx264"), ("x.avi", "mpeg4"), ("x.mkv", "mpeg2video")])
def test_damage_that_the_decoder_conceals_is_told_once(name: str, codec: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    images = [rng.integers(0, 255, (48, 64, 3), np.uint8) for _ in range(40)]
    path = write_video(tmp_path / name, images, codec=codec, pix_fmt="yuv420p")
    assert len(frames_of(path)) == 40
    with av.open(str(path)) as container:
        packets = [packet for packet in container.demux(video=0) if packet.size][10:]
    content = bytearray(path.read_bytes())
    for packet in packets:
        middle = packet.pos + packet.size // 2
        content[middle : middle + 8] = rng.bytes(8)
    path.write_bytes(content)
    with pytest.warns(MienWarning) as told:
        assert len(list(open_video(path))) == 40
    assert len(told) == 1
    assert re.search(rf"{name} is damaged, first at about [01]\.\d\d s; .* copy the file again", str(told[0].message))


def test_nothing_decodes(tmp_path: Path) -> None:
    path = write_video(tmp_path / "header.avi", [gradient(i) for i in range(5)])
    content = path.read_bytes()
    path.write_bytes(content[: content.index(b"movi") + 4])
    with pytest.raises(MienError, match=r"header.avi: no frame .* empty, damaged, or of a kind .*; convert it"):
        list(open_video(path))


def test_streams_that_begin_later_are_passed_over(tmp_path: Path) -> None:
    """As further sound of a broadcast. FFmpeg does not see them when it opens the file: it looks through 5 MB."""
    stuffing = (b"\x47\x1f\xff\x10" + bytes(184)) * 30000

    def part(first: int, streams: int) -> bytes:
        path = tmp_path / "part.ts"
        with av.open(str(path), "w") as container:
            added = [container.add_stream("mpeg2video", rate=25) for _ in range(streams)]
            for stream in added:
                stream.height, stream.width, stream.pix_fmt = 48, 64, "yuv420p"
            for index, stream in itertools.product(range(first, first + 50), added):
                frame = av.VideoFrame.from_ndarray(gradient(index), format="rgb24")
                frame.pts, frame.time_base = index, Fraction(1, 25)
                container.mux(stream.encode(frame))
            for stream in added:
                container.mux(stream.encode())
        return path.read_bytes()

    whole = tmp_path / "whole.ts"
    whole.write_bytes(stuffing.join([part(0, 1), part(50, 9), part(100, 1)]))
    assert len(frames_of(whole)) == 150
    assert open_video(whole).in_order


def test_a_codec_that_nobody_knows_is_told(tmp_path: Path) -> None:
    path = write_video(tmp_path / "x.avi", [gradient(0)])
    path.write_bytes(path.read_bytes().replace(b"FFV1", b"zzzz"))
    with pytest.raises(MienError, match=r"x.avi: the video is damaged, or of a kind .* not supported; convert it"):
        open_video(path)


@pytest.mark.parametrize("content", [b"hello\n" * 100, bytes(range(256)) * 40])
@pytest.mark.parametrize("name", ["x.mp4", "x.txt", "x"])
def test_not_a_video(tmp_path: Path, content: bytes, name: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(MienError, match=r"/x.* (is not a video|cannot be read as a video)"):
        open_video(tmp_path / name)


@pytest.mark.parametrize("name", ["x.mp4", "x.txt", "x"])
def test_an_empty_file_is_called_empty(tmp_path: Path, name: str) -> None:
    (tmp_path / name).touch()
    with pytest.raises(MienError, match=r"/x.* is empty; copy or record the video again"):
        open_video(tmp_path / name)


def test_of_several_streams_the_one_is_read_that_players_show(tmp_path: Path) -> None:
    path = tmp_path / "two.mkv"
    with av.open(str(path), "w") as container:
        streams = [container.add_stream("ffv1", 25) for _ in range(2)]
        for stream, image in zip(streams, (gradient(0, 32, 24), gradient(0)), strict=True):
            stream.height, stream.width, stream.pix_fmt = *image.shape[:2], "bgr0"
        streams[0].disposition, streams[1].disposition = 0, Disposition.default.value  # PyAV 15 takes numbers only
        for stream, image in zip(streams, (gradient(0, 32, 24), gradient(0)), strict=True):
            for picture in (av.VideoFrame.from_ndarray(image, format="rgb24"), None):
                container.mux(stream.encode(picture))
    np.testing.assert_array_equal(frames_of(path)[0].pixels, gradient(0))


def test_the_cover_of_a_sound_file_is_no_video(video: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened = av.open

    def with_cover(*args: Any, **options: Any) -> Any:
        container = opened(*args, **options)
        container.streams.video[0].disposition = Disposition.attached_pic.value
        return container

    monkeypatch.setattr(av, "open", with_cover)
    with pytest.raises(MienError, match=r"plain\.mkv is not a video"):
        open_video(video)


def test_a_name_with_a_colon_is_no_protocol(video: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    video.rename(tmp_path / "2024-05-01T12:30:00.mkv")
    assert len(frames_of(Path("2024-05-01T12:30:00.mkv"))) == 10
