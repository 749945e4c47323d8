"""An array that stays: jobs of several clients, files whole or not at all, and answers while a frame is traced."""

import json
import os
import re
import shutil
import threading

import numpy as np
import pytest
from PIL import Image
from support.cli import RAYGRID, as_process, one_line, warm_kernels
from support.render import SCENES
from support.service import SIZE, Peer, array, name, on, shot_of, sums, up, watch_until
from support.terminal import HIDE, SHOW, Terminal

import raygrid
from raygrid.emulator.topology.process_stat import process_state
from raygrid.host.client.protocol import LONGEST_GREETING, VERSION, pack
from raygrid.host.client.service_files import find
from raygrid.node.errors import ArrayError
from raygrid.node.protocol.framing import LENGTH

__all__ = ["array", "name", "warm_kernels"]

TINY, KINDS = SCENES / "tiny.nff", SCENES / "kinds.nff"
SMALL = ("--size", f"{SIZE[0]}x{SIZE[1]}")
LONG = {"size": (3000, 3000), "samples": 64}  # minutes: no test waits for its end


# ---- frames ----


def test_a_job_s_files_have_the_bits_of_render(array, tmp_path):
    job = array.submit(TINY, output=[tmp_path / "a.npy", tmp_path / "a.png"], stats=tmp_path / "a.json", size=SIZE)
    result = job.wait()
    assert result.files == (str(tmp_path / "a.npy"), str(tmp_path / "a.png"))
    assert (result.job, result.frames, result.skipped) == (job.job, 1, 0)
    assert np.array_equal(np.load(tmp_path / "a.npy"), sums(TINY))
    with Image.open(tmp_path / "a.png") as picture:
        assert picture.size == SIZE
    stats = json.loads((tmp_path / "a.json").read_text())
    assert stats["array"] == [2, 1, 1]
    assert {path.name for path in tmp_path.iterdir()} == {"a.npy", "a.png", "a.json"}


def test_submit_names_the_files_as_it_follows(name, tmp_path):
    shutil.copy(TINY, tmp_path)
    shot = str(shot_of(TINY, 7))
    outcome = on(name, "submit", shot, *SMALL, "--frames", "3-5", "-o", "f_%02d.npy", cwd=tmp_path)
    assert outcome == (0, "f_03.npy\nf_04.npy\nf_05.npy\n", "")
    for frame in (3, 4, 5):
        assert np.array_equal(np.load(tmp_path / f"f_0{frame}.npy"), sums(shot_of(TINY, 7)))
    assert on(name, "submit", "tiny.nff", *SMALL, cwd=tmp_path).out == "tiny.png\n"
    assert on(name, "submit", shot, *SMALL, "--frames", "7", cwd=tmp_path).out == "tiny_0007.png\n"


def test_json_has_a_line_for_each_event(name, tmp_path):
    outcome = on(
        name, "submit", str(shot_of(TINY, 2)), *SMALL, "--frames", "1-2", "-o", str(tmp_path / "%d.png"), "--json"
    )
    events = [json.loads(line) for line in outcome.out.splitlines()]
    assert [event["frame"] for event in events if event["what"] == "frame"] == [1, 2]
    assert events[-1] == {
        "job": events[0]["job"], "what": "end", "state": "done", "error": "", "done": 2, "skipped": 0, "frames": 2
    }  # fmt: skip
    assert (outcome.code, outcome.err) == (0, "")


def test_several_clients_at_once_get_their_own_frames(name, tmp_path):
    settings = [{"size": (40 + 8 * k, 30)} for k in range(3)]
    results = {}

    def work(k):
        with raygrid.connect(name) as array:
            scene = shot_of((TINY, KINDS, TINY)[k], 4)
            results[k] = array.submit(scene, output=tmp_path / f"{k}_%d.npy", frames=(1, 4), **settings[k]).wait()

    threads = [threading.Thread(target=work, args=(k,)) for k in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for k, scene in enumerate((TINY, KINDS, TINY)):
        wanted = sums(shot_of(scene, 4), **settings[k])
        assert len(results[k].files) == 4
        for file in results[k].files:
            assert np.array_equal(np.load(file), wanted)


def test_a_scene_stays_loaded_until_it_changes(array, tmp_path):
    scene = tmp_path / "scene.nff"
    shutil.copy(TINY, scene)
    array.submit(scene, output=tmp_path / "a.npy", size=SIZE).wait()
    floods = array.status()["floods"]
    array.submit(scene, output=tmp_path / "b.npy", size=SIZE).wait()
    array.submit(scene, output=tmp_path / "c.npy", size=SIZE, samples=2, depth=2).wait()
    assert array.status()["floods"] == floods
    text = scene.read_text()
    scene.write_text(text + "\ns 0 0 0 0.3\n")
    array.submit(scene, output=tmp_path / "d.npy", size=SIZE).wait()
    assert array.status()["floods"] == floods + 1
    assert np.array_equal(np.load(tmp_path / "d.npy"), sums(scene))
    assert not np.array_equal(np.load(tmp_path / "d.npy"), np.load(tmp_path / "a.npy"))


def test_resume_skips_what_is_whole_and_of_this_job_only(array, tmp_path):
    files = [tmp_path / f"f_{frame}.png" for frame in range(1, 6)]

    def submit(**settings):
        job = array.submit(
            shot_of(TINY, 5), output=tmp_path / "f_%d.png", frames=(1, 5), resume=True, **({"size": SIZE} | settings)
        )
        return job.wait()

    assert submit().skipped == 0
    before = [file.stat().st_mtime_ns for file in files]
    good = [file.read_bytes() for file in files]
    files[1].write_bytes(good[1][:-20])
    files[2].unlink()
    Image.new("RGB", SIZE).save(files[3])  # a picture of that size, but not ours
    assert submit().skipped == 2
    assert [file.read_bytes() for file in files] == good
    assert [files[k].stat().st_mtime_ns == before[k] for k in range(5)] == [True, False, False, False, True]
    assert submit().skipped == 5
    assert submit(samples=2).skipped == 0


# ---- while a frame is traced ----


def test_status_cancel_and_others_are_answered_while_a_frame_is_traced(array, tmp_path):
    job = array.submit(TINY, output=tmp_path / "long.npy", **LONG)
    watch_until(array, job.job, "progress", phase="trace")
    status = array.status()
    assert status["running"]["job"] == job.job
    assert status["running"]["phase"] in ("load", "trace")
    assert array.jobs(0)[0]["state"] == "running"
    job.cancel()
    with pytest.raises(ArrayError, match=f"job {job.job} was cancelled"):
        job.wait()
    array.submit(TINY, output=tmp_path / "after.npy", size=SIZE).wait()
    assert np.array_equal(np.load(tmp_path / "after.npy"), sums(TINY))
    assert {path.name for path in tmp_path.iterdir()} == {"after.npy"}


def test_a_reset_begins_the_running_frame_again(array, tmp_path):
    settings = {"size": (400, 300), "samples": 4}
    job = array.submit(KINDS, output=tmp_path / "a.npy", **settings)
    watch_until(array, job.job, "progress", phase="trace")
    resets = array.status()["resets"]
    assert len(array.reset()) == 2
    job.wait()
    assert array.status()["resets"] == resets + 1
    assert np.array_equal(np.load(tmp_path / "a.npy"), sums(KINDS, **settings))


def test_a_short_job_does_not_wait_for_the_end_of_a_long_one(array, tmp_path):
    long = array.submit(
        shot_of(TINY, 10_000), output=tmp_path / "long_%d.npy", frames=(1, 10_000), size=SIZE, client="one"
    )
    array.submit(TINY, output=tmp_path / "short.npy", size=SIZE, client="other").wait()
    left = next(job for job in array.jobs() if job["job"] == long.job)
    assert left["state"] == "running"
    assert left["done"] < 10_000


# ---- commands ----


def test_status_says_how_the_array_is(name, array):
    facts = json.loads(on(name, "status", "--json").out)
    record = find(name)
    assert facts["name"] == name
    assert facts["state"] == "ready"
    assert (facts["pid"], facts["array"]) == (record.pid, [2, 1, 1])
    assert [node["node"] for node in facts["nodes"]] == [[0, 0, 0], [1, 0, 0]]
    for node in facts["nodes"]:
        assert os.path.exists(f"/proc/{node['pid']}")
        assert node["state"] in ("running", "waiting")
        assert node["pss"] > 1_000_000
    assert facts["queue"] == {"jobs": 0, "frames": 0}
    text = on(name, "status").out
    assert re.match(rf"{name}: 2x1x1 ready, up for .*, service {record.pid}", text)
    assert re.search(r"^1,0,0 +\d+ +(waiting|running) ", text, re.M)


def test_detached_jobs_are_listed_waited_for_and_cancelled(name, array, tmp_path):
    output = ["-o", str(tmp_path / "a.png")]
    number = on(name, "submit", str(TINY), *SMALL, "--detach", *output).out.strip()
    assert on(name, "wait", number).code == 0
    assert (tmp_path / "a.png").exists()
    long = ["submit", str(TINY), "--size", "3000x3000", "--samples", "64", "--detach", "-o", str(tmp_path / "b.png")]
    running = json.loads(on(name, *long, "--json").out)["job"]
    queued = on(name, *long).out.strip()
    listed = json.loads(on(name, "jobs", "--json").out)
    assert [job["job"] for job in listed][-2:] == [running, int(queued)]
    assert listed[-1] | {"state": "queued", "done": 0, "frames": 1, "scene": str(TINY)} == listed[-1]
    assert on(name, "cancel", queued) == (0, f"{queued}\n", "")
    one_line(on(name, "cancel", queued), 1, rf"raygrid: job {queued} had ended already")
    assert on(name, "cancel", "--all") == (0, f"{running}\n", "")
    one_line(on(name, "wait", queued), 1, rf"raygrid: job {queued} was cancelled")
    assert re.search(
        rf"^{queued} +cancelled +- +0/1 +[\d:-]+ .* - +0 +session \d+ +tiny\.nff", on(name, "jobs").out, re.M
    )


def test_control_c_cancels_the_job(name, array, tmp_path):
    arguments = [RAYGRID, "submit", str(TINY), "--name", name, "--size", "3000x3000", "--samples", "64", "-o", "x.png"]
    with Terminal(arguments, tmp_path) as terminal:
        terminal.wait_for(r"tracing .*packets in flight")
        terminal.press("\x03")
        assert terminal.wait_end() == 130
        assert terminal.screen.endswith("raygrid: stopped")
        assert terminal.text.count(HIDE) == terminal.text.count(SHOW)
    assert array.jobs(1)[-1]["state"] == "cancelled"
    assert list(tmp_path.iterdir()) == []


def test_a_terminal_sees_how_far_the_frames_are(name, array, tmp_path):
    arguments = [
        RAYGRID,
        "submit",
        str(shot_of(TINY, 40)),
        "--name",
        name,
        *SMALL,
        "--frames",
        "1-40",
        "-o",
        "f_%d.png",
    ]
    with Terminal(arguments, tmp_path) as terminal:
        terminal.wait_for(r"job \d+ .*frame \d+: \w+.*, \d+ of 40 done")
        assert terminal.wait_end() == 0
    assert len(list(tmp_path.iterdir())) == 40


# ---- errors ----


def test_a_job_that_cannot_be_done_fails_alone(name, array, tmp_path):
    bad = tmp_path / "bad.nff"
    bad.write_text("s 1 2\n")
    outcome = on(name, "submit", str(bad), "-o", str(tmp_path / "a.png"))
    one_line(outcome, 1, r"raygrid: job \d+ failed: .*bad\.nff.*line 1.*")
    outcome = on(name, "submit", str(TINY), "--size", "3000x3000", "--samples", "1000", "-o", str(tmp_path / "a.png"))
    one_line(outcome, 1, r"raygrid: job \d+ failed: 1000 samples a pixel came, wanted .*")
    array.submit(TINY, output=tmp_path / "good.npy", size=SIZE).wait()
    assert {path.name for path in tmp_path.iterdir()} == {"bad.nff", "good.npy"}


@pytest.mark.parametrize(
    ("arguments", "pattern"),
    [
        (["submit", "none.nff"], r"none\.nff: there is no such file"),
        (["submit", str(TINY), "-o", "none/a.png"], r"none/a\.png: there is no directory .*"),
        (["wait", "999999"], r"the array 'test' has no job 999999"),
        (["cancel", "999999"], r"the array 'test' has no job 999999"),
    ],
)
def test_what_is_wrong_with_a_job_is_said_at_once(name, arguments, pattern, tmp_path):
    one_line(on(name, *arguments, cwd=tmp_path), 1, f"raygrid: {pattern}")


@pytest.mark.parametrize(
    "arguments",
    [
        ["submit"],
        ["submit", str(TINY), "--frames", "5-1"],
        ["submit", str(TINY), "--array", "2x2x2"],
        ["status", "--name", "../x"],
        ["cancel"],
        ["cancel", "1", "--all"],
        ["down", "--kill", "--finish"],
    ],
    ids=" ".join,
)
def test_misuse_has_its_own_exit_code(arguments):
    outcome = as_process(*arguments)
    assert (outcome.code, outcome.out) == (2, "")
    assert outcome.err.count("\n") == 1


def test_a_name_that_runs_cannot_be_launched_again(name):
    pid = find(name).pid
    one_line(
        as_process("up", "--name", name), 1, rf"raygrid: the array 'test' \(2x1x1, process {pid}\) runs already: .*"
    )


def test_a_name_that_does_not_run_is_told_with_those_that_do(name):
    one_line(on("other", "status"), 1, r"raygrid: no array named 'other' runs: .*; those that run: test")
    with pytest.raises(ArrayError, match="those that run: test"):
        raygrid.connect("other")


def test_another_array_runs_beside_it_and_ends_when_its_jobs_are_done(name, array, tmp_path):
    said = up("second")
    assert said["array"] == [2, 1, 1]
    with raygrid.connect("second") as second:
        assert second.pid == said["pid"] != array.pid
        second.submit(shot_of(TINY, 5), output=tmp_path / "a_%d.npy", frames=(1, 5), size=SIZE)
        assert second.down(finish=True) == 0
    assert np.array_equal(np.load(tmp_path / "a_5.npy"), sums(shot_of(TINY, 5)))
    assert process_state(said["pid"]) in ("", "Z")
    one_line(on("second", "down"), 1, "raygrid: no array named 'second' runs: .*")


# ---- uninvited ----


def refusals(array):
    return array.status()["refused"]


GREETING = {"do": "hello", "version": VERSION}


@pytest.mark.parametrize(
    ("said", "why"),
    [
        (pack({**GREETING, "token": "0" * 64}), "token"),
        (pack({**GREETING, "token": ""}), "token"),
        (pack({**GREETING, "token": 7}), "token"),
        (pack({"do": "status"}), "token"),
        (LENGTH.pack(LONGEST_GREETING + 1), "greeting"),
        (b"GET / HTTP/1.1\r\n\r\n", "greeting"),
        (LENGTH.pack(3) + b"\xc1\xc1\xc1", "greeting"),
    ],
    ids=["wrong", "empty", "number", "none", "long", "http", "rubbish"],
)
def test_an_uninvited_peer_is_refused_and_counted(name, array, said, why):
    before = refusals(array)
    with Peer(find(name)) as peer:
        peer.send(said)
        answer = peer.receive()
        assert answer is not None
        assert answer["is"] == "error"
        assert "refused this client" in answer["error"]
        assert peer.receive() is None
    assert refusals(array) == before | {why: before[why] + 1}


def test_the_right_token_with_another_version_is_refused(name, array):
    before = refusals(array)
    with Peer(find(name)) as peer:
        peer.send(pack({"do": "hello", "version": 99, "token": peer.token}))
        assert peer.receive()["is"] == "error"
    assert refusals(array)["token"] == before["token"] + 1


def test_a_client_that_talks_rubbish_is_cut_off_and_the_array_goes_on(name, array, tmp_path):
    before = refusals(array)["request"]
    rng = np.random.default_rng(5)
    rubbish = [rng.bytes(int(size)) for size in rng.integers(1, 200, 200)]
    for body in rubbish:
        with Peer(find(name)) as peer:
            peer.greet()
            peer.send(LENGTH.pack(len(body)) + body)
            assert peer.receive()["is"] == "error"
            assert peer.receive() is None
    assert refusals(array)["request"] == before + len(rubbish)
    array.submit(TINY, output=tmp_path / "a.npy", size=SIZE).wait()
    assert np.array_equal(np.load(tmp_path / "a.npy"), sums(TINY))


def test_files_and_directories_of_the_array_are_for_us_alone(name):
    record = find(name)
    for path in (record.directory, *(os.path.join(record.directory, file) for file in os.listdir(record.directory))):
        assert os.stat(path).st_mode & 0o077 == 0, path
