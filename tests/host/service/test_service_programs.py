"""An array that stays runs programs for the jobs that bring them, if it was launched to take them, and only then."""

import shutil

import numpy as np
import pytest
from support.cli import as_process, one_line, warm_kernels
from support.render import SCENES
from support.service import end, lasting, on, up

import raygrid
from raygrid.emulator.driver.memory_array import MemoryArray
from raygrid.host.render.frame import render_job
from raygrid.host.render.job import Settings, make_job
from raygrid.host.render.program_file import read_program
from raygrid.host.scene.load import load_scene
from raygrid.node.errors import ArrayError

__all__ = ["warm_kernels"]
pytestmark = pytest.mark.timeout(900)  # compiling takes long

SCENE, MARBLE = SCENES / "marble.toml", SCENES / "programs" / "marble.py"
SMALL = {"size": (32, 24), "samples": 1}


@pytest.fixture(scope="module")
def refusing(warm_kernels, tmp_path_factory):
    """An array that takes no programs."""
    with lasting(tmp_path_factory.mktemp("state")) as name:
        yield name


@pytest.fixture
def taking(refusing):
    """One beside it that takes them."""
    up("taking", "--allow-programs", "--patience", "600")
    yield "taking"
    end("taking")


def in_memory(program):
    array = MemoryArray((1, 1, 1), programs=True)
    array.driver.patience = 600.0
    array.driver.ready()
    settings = Settings(**SMALL, program=None if program is None else read_program(program))
    return render_job(array.driver, make_job(load_scene(SCENE), (1, 1, 1), settings)).sums


def test_jobs_have_their_own_programs(taking, tmp_path):
    program = tmp_path / "marble.py"
    shutil.copy(MARBLE, program)
    options = ("--size", "32x24", "--samples", "1")
    outcome = on(taking, "submit", str(SCENE), *options, "--program", "marble.py", "-o", "a.npy", cwd=tmp_path)
    assert outcome == (0, "a.npy\n", "")
    assert np.array_equal(np.load(tmp_path / "a.npy"), in_memory(MARBLE))
    with raygrid.connect(taking) as array:
        array.submit(SCENE, output=tmp_path / "b.npy", **SMALL).wait()
        assert np.array_equal(np.load(tmp_path / "b.npy"), in_memory(None))

        def again(name):
            return array.submit(SCENE, output=tmp_path / name, program=program, resume=True, **SMALL).wait().skipped

        assert (again("a.npy"), again("b.npy")) == (1, 0)  # b.npy was made without the program
        assert (tmp_path / "a.npy").read_bytes() == (tmp_path / "b.npy").read_bytes()
        program.write_text("import os\n")
        with pytest.raises(ArrayError, match=r"marble.py: the program marble, line 1: it imports os"):
            again("a.npy")
        array.submit(SCENE, output=tmp_path / "c.npy", **SMALL).wait()  # it goes on
        with pytest.raises(ArrayError, match="there is no such file"):
            array.submit(SCENE, output=tmp_path / "c.npy", program=tmp_path / "none.py", **SMALL).wait()


def test_an_array_that_takes_no_programs_says_so(refusing, tmp_path):
    said = r"raygrid: .*marble.py: a program is code .*, wanted an array of raygrid up --allow-programs"
    one_line(on(refusing, "submit", str(SCENE), "--program", str(MARBLE), "--detach"), 1, said)
    with raygrid.connect(refusing) as array:
        assert array.jobs() == []  # refused when it came, not when its turn came


def test_a_job_of_the_journal_meets_an_array_that_takes_no_programs(taking, tmp_path):
    with raygrid.connect(taking) as array:
        long = array.submit(SCENE, output=tmp_path / "long.png", size=(3000, 3000), samples=64, client="one").job
        job = array.submit(SCENE, output=tmp_path / "f.npy", program=MARBLE, client="one", **SMALL).job
    assert as_process("down", "--name", taking).code == 0
    up(taking)
    with raygrid.connect(taking) as array:
        array.cancel([long])
        with pytest.raises(ArrayError, match=rf"job {job} failed: .* wanted an array of raygrid up --allow-programs"):
            array.wait(job)
    assert list(tmp_path.iterdir()) == []
