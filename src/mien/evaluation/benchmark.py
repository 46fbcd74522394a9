"""Run every tracker on every sequence, each in a separate process.

DIR/landmarks contains the landmarks of the first frames, DIR/tracks/TRACKER and DIR/timing/TRACKER one file per
sequence. A result is kept if its settings are unchanged: code, camera, first landmarks, video and truth, identified by
checksums. Failures are tried again. Speed is measured last, one process at a time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, partial
from hashlib import sha256
from pathlib import Path

import mien
from mien._version import __version__
from mien.errors import MienError, require, warn
from mien.evaluation.datasets import load_dataset
from mien.evaluation.datasets.sequence import Sequence as DataSequence
from mien.evaluation.job import Job
from mien.evaluation.plan import (
    Evaluation,
    Plan,
    command_of,
    evaluation_path,
    label,
    replays,
    result_path,
    split_names,
    timing_path,
)
from mien.evaluation.results import SequenceResult, Timing
from mien.files import checksum, require_writable
from mien.processes import Call, Command, Progress, run_commands
from mien.registry import code_of, file_of

DEFAULT_TIME_LIMIT = 1800.0
"""Seconds that one tracker may take for one sequence."""

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
"""With one thread, parallel processes do not compete for cores, sums are always in the same order, and speeds are those
of one core. MediaPipe ignores this and starts its own threads: `Timing.busy_cores` tells what they use."""

NOT_USED = (
    "batch", "evaluation", "faces", "output", "pipeline", "start", "__main__.py", "cli.py", "demo.py", "live.py",
    "processes.py", "synthetic.py", "terminal.py", "worker.py",
)  # fmt: skip
"""Parts of mien on which results do not depend, apart from `READERS`."""
READERS = [
    ("evaluation", name)
    for name in (
        "datasets", "job.py", "metrics.py", "pose_csv.py", "points12.py", "protocols.py", "run.py", "results.py",
        "worst.py",
    )
]  # fmt: skip
"""The parts of the evaluation that a job runs: all that `job.py` imports of it."""


def run_plan(
    plan: Plan,
    jobs: int = 1,
    time_limit: float = DEFAULT_TIME_LIMIT,
    progress: Progress = lambda done, total, name: None,
    forked: bool = False,
) -> Evaluation:
    """Run the jobs of a plan that have no valid result yet.

    forked: whether processes may be forked, as for `mien.batch.track_all`; timings, and your own trackers, always get
    new processes. Raises MienError if the plan cannot be started; a failed sequence becomes a result.
    """
    _checksum.cache_clear()
    sequences = _select(load_dataset(plan.dataset, plan.root), plan.sequences)
    _require_same_dataset(plan)
    _require_own_files(plan, sequences)
    require_writable(evaluation_path(plan.out))
    evaluation = _evaluation_of(plan, sequences)
    evaluation.save(plan.out)
    timed = partial(_run, time_limit=time_limit, progress=progress)
    run = partial(timed, forked=forked)
    kinds = {s.name: s.kind for s in sequences}

    def save_failure(job: Job, reason: str) -> None:
        kind = kinds[job.sequence]
        SequenceResult(job.label, job.dataset, job.sequence, kind, job.settings, failure=reason).save(Path(job.out))

    without_face = run([j for s in sequences if not _is_done(j := first_frame_job(plan, s))], jobs)
    faceless = {job.sequence: reason for job, reason in without_face}
    tracks = [track_job(plan, t, s) for t in plan.trackers for s in sequences]
    for job in tracks:
        if job.sequence in faceless:
            save_failure(job, faceless[job.sequence])
    ready = [job for job in tracks if job.sequence not in faceless]
    run([job for job in ready if not _is_done(job)], jobs, on_failure=save_failure)
    for job, reason in timed([job for job in timing_jobs(plan, ready) if not _is_done(job)], 1):
        warn(f"{job.label} on {job.sequence} was not timed: {reason}")
    return evaluation


def _evaluation_of(plan: Plan, sequences: Sequence[DataSequence]) -> Evaluation:
    """The description of a plan for these sequences."""
    return Evaluation(
        dataset=plan.dataset,
        protocol=plan.protocol,
        landmarks=plan.landmarks,
        lost_deg=plan.lost_deg,
        trackers=tuple(label(t) for t in plan.trackers),
        sequences=tuple(s.name for s in sequences),
        kinds_of_sequences=tuple(s.kind for s in sequences),
        command=command_of(plan),
    )


def _require_own_files(plan: Plan, sequences: Sequence[DataSequence]) -> None:
    """Raise MienError if a single file is to be replayed for several sequences."""
    for tracker in plan.trackers:
        file = file_of(tracker)
        require(
            not replays(tracker) or file is None or file.is_dir() or len(sequences) == 1,
            f"{tracker} is one file for {len(sequences)} sequences; give a folder with one for each, named after it, "
            "or one of the --sequences",
        )


def first_frame_job(plan: Plan, sequence: DataSequence) -> Job:
    """The job that makes the landmarks of a first frame; their file name contains a checksum of code, video and what
    else they are made of: the focal length, by which detected ones are straightened, or the truth."""
    detected = plan.landmarks == "detected"
    made_of = [str(plan.focal_px)] if detected else [_checksum(file) for file in sequence.truth_files]
    inputs = _digest([code_checksum(), *made_of, _checksum(sequence.video)])[:12]
    file = plan.out / "landmarks" / f"{sequence.name}-{plan.landmarks}-{inputs}.json"
    return Job(
        task="landmarks",
        dataset=plan.dataset,
        root=str(plan.root),
        sequence=sequence.name,
        landmarks=str(file),
        source=plan.landmarks,
        out=str(file),
        focal_px=plan.focal_px,
    )


def track_job(plan: Plan, tracker: str, sequence: DataSequence) -> Job:
    """The job that runs a tracker on a sequence, with the settings that decide whether an old result is still valid."""
    first = first_frame_job(plan, sequence)
    own, file = tracker, file_of(tracker)
    if file and file.is_dir():
        own, file = f"{tracker}/{sequence.name}.csv", file / f"{sequence.name}.csv"
    name = label(tracker)
    settings = {
        "version": __version__,
        "code": code_checksum(),
        "tracker": name,
        "input": _checksum(file) if file and file.is_file() else "",
        "own": _checksum(code) if (code := code_of(tracker)) else "",
        "source": plan.landmarks,
        "landmarks": _checksum(Path(first.out)) if Path(first.out).exists() else "",
        "video": _checksum(sequence.video),
        "truth": _digest([_checksum(f) for f in sequence.truth_files]),
        "focal_px": plan.focal_px,
    }
    out = result_path(plan.out, name, sequence.name)
    return replace(first, task="track", out=str(out), tracker=own, label=name, settings=settings)


def timing_jobs(plan: Plan, tracks: Sequence[Job]) -> list[Job]:
    """The timing jobs of each tracker: the first sequences that it has tracked, as many as the plan asks for."""
    out = []
    for tracker in plan.trackers:
        if replays(tracker):
            continue
        tracked = [j for j in tracks if j.label == label(tracker) and _is_done(j)]
        for job in tracked[: plan.timed]:
            file = timing_path(plan.out, job.label, job.sequence)
            out.append(replace(job, task="time", out=str(file)))
    return out


@cache
def code_checksum() -> str:
    """SHA-256 of the parts of mien on which results depend: the trackers, what reads a sequence and its truth, and what
    finds the landmarks of its first frame."""
    root = Path(mien.__file__).parent
    files = (p for p in sorted(root.rglob("*")) if p.is_file() and p.suffix not in (".pyc", ".nbi", ".nbc"))
    parts = {p: p.relative_to(root).parts for p in files}
    used = [p for p, at in parts.items() if at[0] not in NOT_USED or at[:2] in READERS]
    return _digest([f"{p.relative_to(root)} {_checksum(p)}" for p in used])


def _run(
    jobs: Sequence[Job],
    at_once: int,
    time_limit: float,
    progress: Progress,
    on_failure: Callable[[Job, str], None] = lambda job, reason: None,
    forked: bool = False,
) -> list[tuple[Job, str]]:
    """Run jobs; returns those that failed, each with its reason."""
    commands = [_command(job) for job in jobs]
    failed: list[tuple[Job, str]] = []
    started: list[str] = []
    for job in jobs:
        Path(job.out).parent.mkdir(parents=True, exist_ok=True)
    if commands:
        progress(0, len(jobs), commands[0].name)
    ended = run_commands(commands, at_once, time_limit, started.append, forked)
    for done, one in enumerate(ended, 1):
        progress(done, len(jobs), started[-1])
        job = jobs[one.index]
        if reason := one.reason or ("" if _is_done(job) else "the process ended without a result"):
            failed.append((job, reason))
            on_failure(job, reason)
    return failed


def _command(job: Job) -> Command | Call:
    """The process of a job. Your own tracker gets a new one, in which nothing is imported yet."""
    name = {"landmarks": "first frame", "track": job.label, "time": f"timing {job.label}"}[job.task]
    arguments = (job.to_json(),)
    call = Call(f"{name} · {job.sequence}", "mien.evaluation.job:main", arguments, ONE_THREAD, "mien.worker")
    return call.command if code_of(job.tracker) else call


def _is_done(job: Job) -> bool:
    """Whether there is what a job writes, with its settings."""
    file = Path(job.out)
    if job.task == "landmarks":
        return file.exists()
    try:
        result = Timing.load(file) if job.task == "time" else SequenceResult.load(file)
    except MienError:
        return False
    return not (isinstance(result, SequenceResult) and result.failure) and dict(result.settings) == dict(job.settings)


def _select(sequences: Sequence[DataSequence], names: Sequence[str]) -> list[DataSequence]:
    """The sequences with these names, or all without names; each text may contain several names separated by commas."""
    known = [s.name for s in sequences]
    selected = [name for text in names for name in split_names(text, known.__contains__)]
    unknown = [name for name in selected if name not in known]
    require(not unknown, f"the data set has no sequence {', '.join(unknown)}; it has {', '.join(known)}")
    return [s for s in sequences if not selected or s.name in selected]


def _require_same_dataset(plan: Plan) -> None:
    if evaluation_path(plan.out).exists():
        before = Evaluation.load(plan.out).dataset
        require(
            before == plan.dataset,
            f"{plan.out} contains results of the data set {before}; choose another folder for {plan.dataset}",
        )


@cache
def _checksum(path: Path) -> str:
    """Checksum of a file or folder, computed once per run."""
    return checksum(path)


def _digest(parts: Sequence[str]) -> str:
    return sha256("\n".join(parts).encode()).hexdigest()
