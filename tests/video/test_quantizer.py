"""How coarsely a video was compressed, on some that were compressed as told."""

from __future__ import annotations

import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import av
import numpy as np
import pytest

from mien.frame import Frame
from mien.video import quantizer
from mien.video.quantizer import _logged, quantizer_step
from videos import frames_of, gradient, portrait_images, write_video


def _step(path: Path, frame: int = 0) -> float | None:
    return frames_of(path)[frame].quantizer_step


@pytest.mark.parametrize(("pix_fmt", "before"), [("yuv420p", 0), ("yuv420p10le", 12)])
@pytest.mark.parametrize("level", [16, 28, 40])
def test_h264_doubles_its_step_every_six_levels(level: int, pix_fmt: str, before: int, tmp_path: Path) -> None:
    """before: how many levels two more bits have before those of 8. x264 makes key frames finer by three levels, and
    others coarser by up to two."""
    how = {"qp": str(level + before), "aq-mode": "0"}
    path = write_video(tmp_path / "x.mp4", portrait_images(8), codec="libx264", pix_fmt=pix_fmt, options=how)
    usual = 2 ** ((level - 4) / 6)
    assert _step(path) == pytest.approx(usual, rel=0.15)
    assert _step(path, 7) == _step(path)  # decoded from the same key frame


def test_it_changes_with_the_video(tmp_path: Path) -> None:
    how = {"x264-params": "zones=0,5,q=20/6,11,q=38:keyint=6:scenecut=0:aq-mode=0:mbtree=0"}
    path = write_video(tmp_path / "x.mp4", portrait_images(12), codec="libx264", pix_fmt="yuv420p", options=how)
    fine, coarse = _step(path, 2), _step(path, 9)
    assert fine == _step(path, 5)
    assert coarse == _step(path, 6)
    assert fine is not None
    assert coarse is not None
    assert coarse > 5 * fine


@pytest.mark.parametrize("late_ms", [0, 2000, 100_000])
def test_a_file_may_start_late(late_ms: int, tmp_path: Path) -> None:
    """Its time stamps do not count from there."""
    how = {"x264-params": "zones=0,49,q=20/50,99,q=38:keyint=25:scenecut=0:aq-mode=0:mbtree=0"}
    images, times = (gradient(k) for k in range(100)), range(late_ms, late_ms + 4000, 40)
    path = write_video(tmp_path / "x.ts", images, codec="libx264", pix_fmt="yuv420p", times_ms=times, options=how)
    fine, coarse = _step(path, 20), _step(path, 70)
    assert fine is not None
    assert coarse is not None
    assert fine < 0.3 * coarse
    assert fine == pytest.approx(2 ** ((20 - 4) / 6), rel=0.5)


def test_a_key_frame_that_seeking_misses_is_found(tmp_path: Path) -> None:
    """In a transport stream it leads to the next one, and here there is none."""
    path = write_video(tmp_path / "x.ts", portrait_images(4), codec="mpeg2video", pix_fmt="yuv420p")
    assert _step(path) == _step(path, 3) is not None


@pytest.mark.parametrize(("codec", "suffix"), [("mpeg4", ".avi"), ("mpeg2video", ".mkv"), ("mpeg1video", ".mkv")])
def test_mpeg_states_its_scale(codec: str, suffix: str, tmp_path: Path) -> None:
    for scale in (2, 12):
        how = {"qmin": str(scale), "qmax": str(scale)}
        images = portrait_images(3)
        path = write_video(tmp_path / f"{scale}{suffix}", images, codec=codec, pix_fmt="yuv420p", options=how)
        assert _step(path) == pytest.approx(2 * scale)


def test_vp9_is_read_as_well(tmp_path: Path) -> None:
    found = []
    for level in (10, 50):
        how, images = {"crf": str(level), "b": "0"}, portrait_images(3)
        path = write_video(tmp_path / f"{level}.webm", images, codec="libvpx-vp9", pix_fmt="yuv420p", options=how)
        found.append(_step(path))
    fine, coarse = found
    assert fine is not None
    assert coarse is not None
    assert 0.5 < fine < 0.5 * coarse < 30


@pytest.mark.parametrize("pix_fmt", ["yuv420p", "yuv420p10le"])
def test_the_headers_of_hevc_state_its_levels(pix_fmt: str, tmp_path: Path) -> None:
    """Its step doubles every six levels, whatever its bits. In Matroska, since now and then FFmpeg fails to write the
    first packet of x265 into an MP4."""
    for level in (22, 34):
        how = {"x265-params": f"qp={level}:aq-mode=0:ipratio=1:pbratio=1:log-level=none"}
        path = write_video(tmp_path / "x.mkv", portrait_images(8), codec="libx265", pix_fmt=pix_fmt, options=how)
        assert _step(path, 7) == _step(path) == pytest.approx(2 ** ((level - 4) / 6))


@pytest.mark.parametrize(("codec", "how"), [("libvpx", {"b": "9M"}), ("libsvtav1", {"preset": "10"})])
def test_the_headers_of_vp8_and_av1_state_their_quantizers(codec: str, how: dict[str, str], tmp_path: Path) -> None:
    if codec not in av.codecs_available:
        pytest.skip(f"this FFmpeg cannot encode with {codec}")
    found = []
    for level in (15, 50):
        images, limits = portrait_images(8), {"qmin": str(level), "qmax": str(level)}
        options = how | (limits if codec == "libvpx" else {"crf": str(level)})
        path = write_video(tmp_path / f"{level}.mkv", images, codec=codec, pix_fmt="yuv420p", options=options)
        found.append(_step(path))
    fine, coarse = found
    assert fine is not None
    assert coarse is not None
    assert 0.5 < fine < 0.5 * coarse < 60


def test_an_image_in_several_slices_counts_once(tmp_path: Path) -> None:
    found = []
    for slices in (1, 4):
        how = {"x265-params": f"slices={slices}:qp=30:ipratio=2:bframes=0:log-level=none"}
        images = [np.tile(image, (2, 1, 1)) for image in portrait_images(8)]
        path = write_video(tmp_path / "x.mkv", images, codec="libx265", pix_fmt="yuv420p", options=how)
        found.append(_step(path))
    assert found[0] == found[1] is not None


def test_an_image_of_hevc_has_the_parameter_set_that_it_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As from encoders that keep several: 26 + 4 + 2 is the first's level."""
    path = write_video(tmp_path / "x.mkv", portrait_images(2), codec="libx265", pix_fmt="yuv420p")
    sets = [("pps_pic_parameter_set_id", 0), ("init_qp_minus26", 4), ("pps_pic_parameter_set_id", 1)]
    image = [("init_qp_minus26", -10), ("slice_pic_parameter_set_id", 0), ("slice_qp_delta", 2)]
    monkeypatch.setattr(quantizer, "_header_fields", lambda *_: iter(sets + image))
    assert _step(path) == pytest.approx(2 ** ((32 - 4) / 6))


def test_headers_are_read_in_several_threads(tmp_path: Path) -> None:
    path = write_video(tmp_path / "x.mkv", portrait_images(8), codec="libx265", pix_fmt="yuv420p")
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)
    try:
        with ThreadPoolExecutor(4) as threads:
            found = set(threads.map(quantizer_step, [path] * 40, [0.0] * 40))
    finally:
        sys.setswitchinterval(interval)
        level = av.logging.get_level()
        av.logging.set_level(None)
    assert level is None
    assert found == {_step(path)}


@pytest.mark.parametrize(("level", "passed_on"), [(None, 0), (av.logging.ERROR, 1)])
def test_what_other_threads_log_while_headers_are_read(
    level: int | None, passed_on: int, caplog: pytest.LogCaptureFixture
) -> None:
    """As those that decode a damaged file meanwhile: it is printed only if the program wants it."""
    other = threading.Thread(target=av.logging.log, args=(av.logging.ERROR, "hevc", f"damaged {passed_on}"))
    av.logging.set_level(level)
    try:
        with _logged() as lines:
            other.start()
            other.join()
        assert not lines
        assert len(caplog.records) == passed_on
    finally:
        av.logging.set_level(None)


def test_reading_headers_leaves_the_log_as_it_was(tmp_path: Path) -> None:
    path = write_video(tmp_path / "x.mkv", portrait_images(2), codec="libx265", pix_fmt="yuv420p")
    for level in (None, av.logging.ERROR):
        av.logging.set_level(level)
        try:
            assert _step(path) is not None
            assert av.logging.get_level() == level
        finally:
            av.logging.set_level(None)


@pytest.mark.parametrize(("codec", "pix_fmt", "name"), [("ffv1", "bgr0", "x.mkv"), ("mjpeg", "yuvj420p", "x.avi")])
def test_nothing_is_made_up_where_a_stream_does_not_say(codec: str, pix_fmt: str, name: str, tmp_path: Path) -> None:
    path = write_video(tmp_path / name, portrait_images(3), codec=codec, pix_fmt=pix_fmt)
    assert _step(path) is None
    assert Frame(gradient(0)).quantizer_step is None


def test_a_file_that_is_gone_says_nothing(tmp_path: Path) -> None:
    assert quantizer_step(tmp_path / "gone.mp4", 0.0) is None
