"""One run at a time: who is kept out, and who is not."""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from mien.errors import MienError
from mien.output.sole_use import sole_use

HOLDS = """
import sys, time
from pathlib import Path
from mien.output.sole_use import sole_use
with sole_use(Path(sys.argv[1])):
    print("claimed", flush=True)
    time.sleep(600)
"""
LINUX = pytest.mark.skipif(sys.platform != "linux", reason="the system does not say when a process began")


def _claim(folder: Path, **changed: Any) -> Path:
    """The claim of this process, but for what is changed."""
    with sole_use(folder):
        (own,) = folder.iterdir()
        content = json.loads(own.read_text())
    own.write_text(json.dumps(content | changed))
    return own


def test_a_folder_is_claimed_for_a_block_and_no_longer(tmp_path: Path) -> None:
    out = tmp_path / "new" / "out"
    with sole_use(out):
        with pytest.raises(MienError, match="is in use by another mien batch") as refused, sole_use(out):
            pass
        for named in (str(out), f"process {os.getpid()} on {platform.node()}", "choose another folder with -o"):
            assert named in str(refused.value)
        with sole_use(tmp_path):
            pass
    with pytest.raises(ZeroDivisionError), sole_use(out):
        raise ZeroDivisionError
    with sole_use(out):
        pass
    assert not list(out.iterdir())


def test_a_process_that_was_killed_keeps_nobody_out(tmp_path: Path) -> None:
    with subprocess.Popen([sys.executable, "-c", HOLDS, str(tmp_path)], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline().strip() == b"claimed"
        with pytest.raises(MienError, match=f"process {process.pid} on"), sole_use(tmp_path):
            pass
        process.kill()
    assert len(list(tmp_path.iterdir())) == 1
    with sole_use(tmp_path):
        pass
    assert not list(tmp_path.iterdir())


@LINUX
@pytest.mark.parametrize("identity", ["another-start 1", ""])
def test_a_later_process_of_the_same_number_is_another(tmp_path: Path, identity: str) -> None:
    """Where it is known when both began."""
    claim = _claim(tmp_path, identity=identity)
    if identity:
        with sole_use(tmp_path):
            assert not claim.exists()
    else:
        with pytest.raises(MienError, match="is in use"), sole_use(tmp_path):
            pass


@pytest.mark.skipif(os.name == "nt", reason="what is not open can be deleted there")
def test_a_claim_from_another_machine_is_to_be_deleted_by_hand(tmp_path: Path) -> None:
    claim = _claim(tmp_path, machine="elsewhere")
    with pytest.raises(MienError, match="on elsewhere") as refused, sole_use(tmp_path):
        pass
    assert f"delete {claim})" in str(refused.value)
    claim.unlink()
    with sole_use(tmp_path):
        pass


@pytest.mark.parametrize("content", ["", "[1]", '{"process": 1}'])
def test_a_damaged_claim_keeps_nobody_out(tmp_path: Path, content: str) -> None:
    _claim(tmp_path).write_text(content)
    with sole_use(tmp_path):
        pass
