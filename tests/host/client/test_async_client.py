"""An array that stays, from asyncio: the same answers and bits as from threads, any number of coroutines at once."""

import asyncio
import os
import signal

import numpy as np
import pytest
from support.cli import warm_kernels
from support.render import SCENES
from support.service import SIZE, array, name, sums

import raygrid
from raygrid.host.client import async_client
from raygrid.host.client.picture_folder import PictureFolder

__all__ = ["array", "name", "warm_kernels"]

TINY, KINDS, MOBILE = (str(SCENES / name) for name in ("tiny.nff", "kinds.nff", "mobile.toml"))
LONG = {"size": (2000, 2000), "samples": 64}  # minutes: no test waits for its end


@pytest.fixture(autouse=True)
def no_folder_is_left(tmp_path, monkeypatch):
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "temporary"))
    yield
    assert list((tmp_path / "temporary").iterdir()) == []


def test_several_coroutines_have_their_pictures_at_once(name):
    async def main():
        async with raygrid.aio.connect(name) as array:
            assert (array.name, array.shape) == (name, (2, 1, 1))
            assert repr(array) == f"<raygrid.aio.AsyncService {name!r} 2x1x1, process {array.pid}>"
            return await asyncio.gather(*(array.render(path, size=SIZE) for path in (TINY, KINDS, TINY)))

    pictures = asyncio.run(main(), debug=True)
    for picture, path in zip(pictures, (TINY, KINDS, TINY), strict=True):
        assert np.array_equal(picture.sums, sums(path))


def test_a_job_is_followed_and_its_result_is_that_of_threads(name, array, tmp_path):
    async def main():
        async with raygrid.aio.connect(name) as other:
            job = await other.submit(TINY, size=SIZE, output=tmp_path / "a.npy")
            told = [event["what"] async for event in job.events()]
            return told, await job.wait(), [event["what"] async for event in job.events()], await other.jobs()

    told, result, again, jobs = asyncio.run(main())
    assert told[-1] == "end"
    assert again == ["end"]
    assert result == array.wait(result.job)
    assert result.files == (str(tmp_path / "a.npy"),)
    assert jobs == array.jobs()


def test_frames_come_one_after_the_other_and_the_rest_is_cancelled(name, array):
    async def main():
        async with raygrid.aio.connect(name) as other:
            numbers = [frame.stats["frame"] async for frame in other.render_frames(MOBILE, [1, 2, 5], size=SIZE)]
            frames = other.render_frames(MOBILE, size=SIZE)
            await anext(frames)
            await frames.aclose()
            return numbers

    assert asyncio.run(main(), debug=True) == [1, 2, 5]
    assert array.jobs()[-1]["state"] == "cancelled"


def test_a_render_that_is_cancelled_cancels_its_job_and_the_connection_lives(name, array):
    async def main():
        async with raygrid.aio.connect(name) as other:
            begun = asyncio.Event()
            task = asyncio.create_task(other.render(TINY, progress=lambda _: begun.set(), **LONG))
            await asyncio.wait_for(begun.wait(), 60)
            task.cancel()
            with pytest.raises(asyncio.CancelledError):
                await task
            assert await other.cancel(None) == []
            return await other.status()

    assert asyncio.run(main())["name"] == name
    assert array.jobs()[-1]["state"] == "cancelled"


def test_a_render_that_is_cancelled_before_its_job_has_a_number_cancels_it(name, array, monkeypatch):
    """The service is stopped, so that the answer is awaited meanwhile; the connection closes when the job is cancelled."""

    async def main():
        async with raygrid.aio.connect(name) as other:
            os.kill(array.pid, signal.SIGSTOP)
            try:
                asked, send, cancel = asyncio.Event(), other._connection.ask, other.cancel

                def ask(*arguments, **options):
                    asked.set()
                    return send(*arguments, **options)

                async def noted(jobs):
                    cancelled.append(list(jobs))
                    return await cancel(jobs)

                monkeypatch.setattr(other._connection, "ask", ask)
                monkeypatch.setattr(other, "cancel", noted)
                task = asyncio.create_task(other.render(TINY, **LONG))
                async with asyncio.timeout(60):
                    await asked.wait()
                task.cancel()
                with pytest.raises(asyncio.CancelledError):
                    await task
            finally:
                os.kill(array.pid, signal.SIGCONT)

    before, cancelled = array.jobs(), []
    asyncio.run(main())
    last = array.jobs()[-1]
    assert last not in before
    assert cancelled == [[last["job"]]]
    assert last["state"] in ("cancelled", "failed")  # failed: it was begun, and its folder was gone


def test_a_render_that_is_cancelled_while_its_folder_is_made_leaves_none(name, array, monkeypatch):
    async def main():
        making, loop = asyncio.Event(), asyncio.get_running_loop()

        def make(*arguments):
            loop.call_soon_threadsafe(making.set)
            return PictureFolder(*arguments)

        monkeypatch.setattr(async_client, "PictureFolder", make)
        async with raygrid.aio.connect(name) as other:
            task = asyncio.create_task(other.render(TINY, size=SIZE))
            async with asyncio.timeout(60):
                await making.wait()
            task.cancel()
            with pytest.raises(asyncio.CancelledError):
                await task

    before = array.jobs()
    asyncio.run(main(), debug=True)
    assert array.jobs() == before


def test_who_waits_when_it_is_closed_is_told_so(name, array, tmp_path):
    async def main():
        other = await raygrid.aio.connect(name)
        job = await other.submit(TINY, output=tmp_path / "a.png", **LONG)
        begun = asyncio.Event()
        waiting = asyncio.create_task(job.wait(lambda _: begun.set()))
        await asyncio.wait_for(begun.wait(), 60)
        await other.close()
        await other.close()
        for call in (waiting, other.status()):
            with pytest.raises(
                raygrid.ArrayError, match=r"^this connection to the array .* was closed, wanted one that is open"
            ):
                await call

    asyncio.run(main(), debug=True)
    array.cancel(None)


def test_what_goes_wrong_is_one_sentence(name):
    async def main():
        async with raygrid.aio.connect(name) as other:
            with pytest.raises(raygrid.ArrayError, match=r"has no job 999999$"):
                await other.cancel([999999])
            with pytest.raises(raygrid.ArrayError, match=r"^depth came as 99, wanted "):
                await other.render(TINY, depth=99)
            with pytest.raises(TypeError, match="speed"):
                await other.render(TINY, speed=9)
            assert len(await other.reset()) == 2
        with pytest.raises(raygrid.ArrayError, match="no array named 'nobody' runs"):
            await raygrid.aio.connect("nobody")

    asyncio.run(main())
    for timeout in (0, "soon", float("nan")):
        with pytest.raises(raygrid.ArrayError, match=r"timeout came as .*, wanted seconds above 0"):
            raygrid.aio.connect(name, timeout)
