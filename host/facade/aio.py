"""raygrid.aio: arrays that stay, from asyncio.

async with raygrid.aio.connect("film") as array:
    picture = await array.render("scenes/room.glb", size=(640, 480))
"""

from __future__ import annotations

from raygrid.host.client.async_client import AsyncService, AsyncSubmitted, connect

__all__ = ["AsyncService", "AsyncSubmitted", "connect"]
