"""The command line: parse, call, print.

Exit status: 0 for success; 2 for bad input, with one sentence on stderr; 130 if stopped by Ctrl-C or a signal, after
writing the frames tracked so far. Heavy modules are imported where they are used, so that `mien --help` is fast.
"""

from __future__ import annotations

import atexit
import errno
import gc
import os
import signal
import sys
import warnings
from collections.abc import Callable
from datetime import datetime
from io import TextIOWrapper
from pathlib import Path
from types import FrameType
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from mien._version import __version__
from mien.errors import MienError, MienWarning, interruption, require
from mien.terminal import frames_bar, jobs_bar, print_error, print_error_once, print_scores, print_written, show_warning

# Read when NumPy is first imported. Tracking multiplies thousands of small matrices, for which BLAS threads cost more
# time than they save, especially on a busy machine; to track several videos faster, use several processes.
for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

BAD_INPUT, INTERRUPTED = 2, 130


class _Group(TyperGroup):
    """The command group, and the one place where errors become a sentence and an exit status."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        return super().parse_args(ctx, [_expanded(argument) for argument in args])

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except MienError as error:
            print_error(f"mien: {error}")
            raise typer.Exit(BAD_INPUT) from error
        except OSError as error:
            if error.errno == errno.EPIPE:
                raise
            print_error(f"mien: {_refused(error)}")
            raise typer.Exit(BAD_INPUT) from error
        except (KeyboardInterrupt, SystemError, RuntimeError) as error:
            if not isinstance(interruption(error), KeyboardInterrupt):
                raise
            print_error("mien: interrupted")
            raise typer.Exit(INTERRUPTED) from error


def _expanded(argument: str) -> str:
    """An argument `--name=~/file` with the home folder in place of `~`, which shells leave as it is within a word."""
    name, _, value = argument.partition("=")
    return f"{name}={os.path.expanduser(value)}" if name.startswith("--") and value.startswith("~") else argument


def _refused(error: OSError) -> str:
    """What the system has refused, as a sentence."""
    why = error.strerror or error
    if error.errno in (errno.EAGAIN, errno.ENOMEM):
        return f"memory or processes are short ({why}); close other programs, or raise the limits of this one"
    return f"{error.filename or 'a file'} cannot be read or written ({why})"


app = typer.Typer(
    cls=_Group,
    help="Track the 3D pose and expression of a face in a video, with calibrated uncertainty.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

Video = Annotated[
    str, typer.Argument(metavar="VIDEO", help="A video file, a folder of images, or the number of a camera.")
]
LandmarkFile = Annotated[
    Path | None,
    typer.Option(help="Landmarks of the first frame: .json, iBUG-68 .pts, OpenFace .csv; detected if not given."),
]
CameraFile = Annotated[Path | None, typer.Option(help='JSON {"focal_px": .., "cx": .., "cy": ..}, or a calibration.')]
Focal = Annotated[float | None, typer.Option(help="Focal length in pixels.", metavar="PX")]
Fov = Annotated[
    float | None, typer.Option(help="Horizontal field of view; otherwise 60 along the longer side.", metavar="DEG")
]
Start = Annotated[float | None, typer.Option(help="Start at this time.", metavar="SECONDS")]
End = Annotated[float | None, typer.Option(help="Stop before this time.", metavar="SECONDS")]
Fps = Annotated[
    float | None, typer.Option(help="Frames per second of a folder of images; 25 if not given.", metavar="RATE")
]
AtOnce = Annotated[
    bool, typer.Option("--at-once", help="Learn the face from the first frame that shows it, not from the best one.")
]
Face = Annotated[
    tuple[float, float] | None,
    typer.Option(metavar="X Y", help="A point on the face to track, in pixels; the largest face if not given."),
]
Faces = Annotated[
    int,
    typer.Option(
        min=1, metavar="N", help="Track up to N faces, the others into NAME.face1.csv, NAME.face2.csv, and so on."
    ),
]
Preset = Annotated[str, typer.Option(help="The tracker; realtime:FILE reads its settings from a JSON file.")]
Passes = Annotated[
    int, typer.Option(min=1, max=2, help="2: track a file twice, the second time with the face shape learned so far.")
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but warnings and errors.")]


def main() -> None:
    """Run the command line."""
    # Imports and kernel compilation create many long-lived objects: collecting garbage among them took a tenth of the
    # start-up time, and at the end of a short video another fifth; tracking creates no garbage cycles.
    gc.set_threshold(100_000)
    atexit.register(gc.freeze)
    _handle_signals(_interrupt)
    _open_standard_streams()
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):  # a name that the terminal cannot show must not end a run
            stream.reconfigure(errors="backslashreplace")
    app()


def _handle_signals(handler: Callable[[int, FrameType | None], Any]) -> None:
    """Handle Ctrl-C, and what else asks a process to end, alike; nohup has SIGHUP ignored."""
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, handler)


def _interrupt(number: int, frame: FrameType | None) -> None:
    """Interrupt what runs, so that the frames tracked so far are saved. A second signal, as of an impatient user or of
    a program that passes on what the terminal has sent already, does not interrupt that; a third does."""
    _handle_signals(_insist)
    raise KeyboardInterrupt


def _insist(number: int, frame: FrameType | None) -> None:
    _handle_signals(signal.default_int_handler)
    os.write(2, b"mien: stopping, and writing what there is; once more to stop without that\n")


def _open_standard_streams() -> None:
    """Open what a parent process has closed of standard input, output and error: their numbers would be given to the
    next files that are opened, into which native code then writes its messages."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)


@app.callback(invoke_without_command=True)
def _common(version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False) -> None:
    warnings.showwarning = show_warning
    warnings.simplefilter("always", MienWarning)
    print_error_once.cache_clear()
    if version:
        typer.echo(__version__)
        raise typer.Exit


@app.command()
def demo(
    out: Annotated[Path, typer.Option(help="Output folder.")] = Path("mien-demo"),
) -> None:
    """Render a short sequence with known motion, track it, and print the error against the ground truth."""
    from mien.demo import run_demo

    run_demo(out)


@app.command()
def track(
    video: Video,
    output: Annotated[
        str | None,
        typer.Option(
            "-o",
            "--output",
            metavar="PATH",
            help="The table; by default VIDEO's name.csv in this folder, of a camera with the date and the time.",
        ),
    ] = None,
    preset: Preset = "realtime",
    landmarks: LandmarkFile = None,
    camera: CameraFile = None,
    focal: Focal = None,
    fov: Fov = None,
    overlay: Annotated[Path | None, typer.Option(help="Video with mesh, landmarks and axes: .mp4.")] = None,
    plot: Annotated[Path | None, typer.Option(help="Angles and animation over time: .png, .pdf or .svg.")] = None,
    gltf: Annotated[
        Path | None, typer.Option(help="The moving head for Blender, Unity, three.js and others: .glb.")
    ] = None,
    show: Annotated[
        bool, typer.Option("--show", help="Show the overlay in a window while tracking; Esc stops.")
    ] = False,
    start: Start = None,
    end: End = None,
    fps: Fps = None,
    at_once: AtOnce = False,
    face: Face = None,
    faces: Faces = 1,
    passes: Passes = 1,
    quiet: Quiet = False,
) -> None:
    """Track the face of VIDEO; write its pose and expression as CSV, Parquet, and JSON with the settings."""
    from mien.faces import track_faces
    from mien.output.destination import Destination, require_new, require_no_other_video
    from mien.pipeline.track import track as track_video
    from mien.video.source import is_camera_number

    table = _output_path(output, _stem(video) + ".csv")
    if is_camera_number(video):
        require_new(Destination(table, overlay).paths())
    elif output is None or table != Path(output):  # nobody chose this name
        require_no_other_video(table, Path(video))
    given: dict[str, Any] = {"preset": preset, "camera": camera, "focal_px": focal, "fov_deg": fov}
    given |= {"start": start, "end": end, "fps": fps, "at_once": at_once, "passes": passes}
    given |= {"save": table, "overlay": overlay, "plot": plot, "gltf": gltf}
    for_one = {"--landmarks": landmarks, "--face": face, "--show": show or None}
    unwanted = [name for name, value in for_one.items() if value is not None]
    require(faces == 1 or not unwanted, f"{', '.join(unwanted)}: for one face only; omit it, or omit --faces")
    with frames_bar(quiet) as progress:
        if faces == 1:
            tracks = [track_video(video, landmarks=landmarks, face=face, show=show, progress=progress, **given)]
        else:
            tracks = track_faces(video, faces, progress=progress, **given)
    if not quiet:
        for face_id, result in enumerate(tracks):
            which = "the face" if faces == 1 else f"face {face_id}"
            typer.echo(f"{len(result)} frame{'s' * (len(result) != 1)}, {which} lost in {result.lost}")
        files = Destination(table, overlay, plot, gltf)
        print_written([path for face_id in range(len(tracks)) for path in files.of_face(face_id).paths()])


@app.command()
def batch(
    paths: Annotated[list[Path], typer.Argument(metavar="PATHS", help="Videos, and folders that contain videos.")],
    out: Annotated[Path, typer.Option("-o", "--output", metavar="DIR", help="Folder for the tables.")],
    jobs: Annotated[
        int | None, typer.Option(min=1, help="Number of videos at a time; by default one per processor.")
    ] = None,
    preset: Preset = "realtime",
    camera: CameraFile = None,
    focal: Focal = None,
    fov: Fov = None,
    overlay: Annotated[bool, typer.Option("--overlay", help="Write an overlay video beside each table.")] = False,
    plot: Annotated[bool, typer.Option("--plot", help="Write a plot beside each table.")] = False,
    gltf: Annotated[bool, typer.Option("--gltf", help="Write the moving head beside each table.")] = False,
    start: Start = None,
    end: End = None,
    fps: Fps = None,
    at_once: AtOnce = False,
    faces: Faces = 1,
    passes: Passes = 1,
    again: Annotated[bool, typer.Option("--again", help="Track videos again that are already done.")] = False,
    quiet: Quiet = False,
) -> None:
    """Track many videos, several at a time, continue where an earlier run stopped, and write a summary."""
    from mien.batch import BatchOptions, track_all
    from mien.output.summary import FAILED, KEPT, SUMMARY, TRACKED

    options = BatchOptions(
        preset, passes, faces, camera, focal, fov, start, end, fps, at_once, overlay, plot, gltf, again
    )
    with jobs_bar("looking for videos", quiet) as progress:
        rows = track_all(paths, out, options, jobs, progress, forked=True)
    count = {state: sum(row.state == state for row in rows) for state in (TRACKED, KEPT, FAILED)}
    if not quiet:
        kept = f", {count[KEPT]} already done" if count[KEPT] else ""
        typer.echo(f"{count[TRACKED]} of {len(rows)} videos tracked{kept}")
        typer.echo(f"wrote {out / SUMMARY}")
    for row in rows:
        if row.state == FAILED:
            print_error(f"mien: {row.video}: {row.note}")
    if count[FAILED]:
        raise MienError(f"{count[FAILED]} of {len(rows)} videos could not be tracked; {out / SUMMARY} lists them all")


@app.command()
def landmarks(
    video: Video,
    output: Annotated[
        str | None,
        typer.Option(
            "-o",
            "--output",
            metavar="PATH",
            help="The landmarks; by default VIDEO's name.landmarks.json in this folder.",
        ),
    ] = None,
    plot: Annotated[Path | None, typer.Option(help="The picture; by default beside the landmarks.")] = None,
    landmarks: LandmarkFile = None,
    camera: CameraFile = None,
    focal: Focal = None,
    fov: Fov = None,
    start: Start = None,
    fps: Fps = None,
    at_once: AtOnce = False,
    face: Face = None,
    quiet: Quiet = False,
) -> None:
    """Find the face in the first frame; write its landmarks, and a picture of the fitted mesh.

    If the picture is wrong, correct the file, check it with --landmarks, and pass it to mien track.
    """
    from mien.pipeline.landmarks import write_first_frame

    found = _output_path(output, _stem(video) + ".landmarks.json")
    fit, written = write_first_frame(
        video,
        found,
        plot,
        landmarks=landmarks,
        camera=camera,
        focal_px=focal,
        fov_deg=fov,
        start=start,
        fps=fps,
        at_once=at_once,
        face=face,
    )
    if not quiet:
        typer.echo(f"the fitted mesh is {fit.residual_px:.2f} pixels (root mean square) from the landmarks")
        print_written(written)


@app.command()
def evaluate(
    dataset: Annotated[str, typer.Argument(metavar="DATASET", help="buft, talking-face, rendered or video.")],
    path: Annotated[Path, typer.Argument(metavar="PATH", help="Where the data set is.")],
    out: Annotated[Path, typer.Option("-o", "--output", metavar="DIR", help="Folder for the results.")],
    trackers: Annotated[
        str, typer.Option(metavar="NAMES", help="Separated by commas, or all; openface:PATH reads output of OpenFace.")
    ] = "realtime,paper,mediapipe",
    protocol: Annotated[str, typer.Option(help="paper, rebased or sensor.")] = "rebased",
    jobs: Annotated[int, typer.Option(min=1, help="Number of sequences at a time.")] = 1,
    landmarks: Annotated[str, typer.Option(help="Of the first frame: detected, or truth.")] = "detected",
    focal: Focal = None,
    lost: Annotated[
        float | None,
        typer.Option(
            metavar="DEG", help="Error beyond which a frame counts as lost (protocol paper); 30 if not given."
        ),
    ] = None,
    time_limit: Annotated[
        float | None, typer.Option(metavar="SECONDS", help="For one sequence; 1800 if not given.")
    ] = None,
    sequences: Annotated[str, typer.Option(metavar="NAMES", help="Only these, separated by commas.")] = "",
    timed: Annotated[int, typer.Option(min=0, help="Number of sequences on which speed is measured.")] = 1,
    quiet: Quiet = False,
) -> None:
    """Run trackers on a data set, continue where an earlier run stopped, and write the report."""
    from mien.evaluation import commands

    limits = {"lost_deg": lost, "time_limit": time_limit}
    with jobs_bar("reading the data set", quiet) as progress:
        scores, written = commands.evaluate(
            dataset,
            path,
            out,
            trackers=(trackers,),
            protocol=protocol,
            jobs=jobs,
            first_landmarks=landmarks,
            focal_px=focal,
            sequences=(sequences,) if sequences else (),
            timed=timed,
            progress=progress,
            forked=True,
            **{name: value for name, value in limits.items() if value is not None},
        )
    if not quiet:
        print_scores(scores)
        print_written([written])
    commands.require_a_result(scores)
    for score in scores.scores:
        if quiet and score.failure:  # else there is a table of them
            print_error(f"mien: {score.result.sequence}: no result of {score.result.tracker}: {score.failure}")


@app.command()
def report(
    directory: Annotated[Path, typer.Argument(metavar="DIR", help="A results folder of mien evaluate.")],
    form: Annotated[str, typer.Option("--format", help="markdown, latex, csv or html.")] = "markdown",
    protocol: Annotated[str | None, typer.Option(help="By default that of the evaluation.")] = None,
) -> None:
    """Write the tables of an evaluation again, without running anything."""
    from mien.evaluation import commands

    print_written([commands.report(directory, form, protocol)])


def _stem(video: str) -> str:
    """The name for the results of a video: the stem of the file, the name of the folder, or of a camera, whose
    recordings cannot be made again, a new one each time: `camera-0-2024-02-29-18-05-09`."""
    from mien.video.source import is_camera_number

    if is_camera_number(video):
        return f"camera-{video}-{datetime.now():%Y-%m-%d-%H-%M-%S}"
    path = Path(video)
    return path.resolve().name if path.is_dir() else path.stem


def _output_path(output: str | None, name: str) -> Path:
    """The given output path; in a given folder, which need not exist if it ends with a slash, or in the current one
    without a path, the file has this name."""
    require(output != "", "-o is empty; give the name of a file, or of a folder")
    if output is None or output.endswith(("/", os.sep)) or Path(output).is_dir():
        return Path(output or "", name)
    return Path(output)
