"""The same rigs for ``async`` programs: calls run on a thread of the rig's own, the event loop goes on."""

import asyncio
import contextlib
import functools
from collections.abc import AsyncIterator, Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Generic, ParamSpec, TypeVar

from longreach import rigs
from protocol.errors import LongreachError
from vision_pc.application.results import JudgedLook

RigT = TypeVar("RigT", bound=rigs.DrivenRig)
T = TypeVar("T")
P = ParamSpec("P")


class AsyncRig(Generic[RigT]):
    """A rig whose calls are awaited, one after the other. A call that is cancelled stops the arm first.

    ``rig`` is the rig itself, whose truth may be read between calls.
    """

    def __init__(self, rig: RigT, thread: ThreadPoolExecutor) -> None:
        self.rig = rig
        self._thread = thread

    async def enable(self) -> None:
        """Let the arm move."""
        await self._call(self.rig.enable)

    async def disable(self) -> None:
        """Let the arm no longer move."""
        await self._call(self.rig.disable)

    async def stop(self) -> None:
        """Stop the arm; a running program is ended first by cancelling its call."""
        await self._call(self.rig.stop)

    async def reset(self) -> None:
        """Clear a latched fault."""
        await self._call(self.rig.reset)

    async def look(self) -> JudgedLook:
        """As ``DrivenRig.look``."""
        return await self._call(self.rig.look)

    async def run(self, program: str, /, **request: Any) -> Any:
        """As ``DrivenRig.run``."""
        return await self._call(functools.partial(self.rig.run, program, **request))

    async def picture(self) -> bytes:
        """The newest picture with what was found in it, PNG."""
        return await self._call(self.rig.picture)

    async def _call(self, work: Callable[[], T]) -> T:
        done = asyncio.get_running_loop().run_in_executor(self._thread, work)
        try:
            return await asyncio.shield(done)
        except asyncio.CancelledError:
            self.rig.cancel()
            with contextlib.suppress(LongreachError):
                await done
            raise


def _twin(make: Callable[P, RigT]) -> Callable[P, contextlib.AbstractAsyncContextManager[AsyncRig[RigT]]]:
    """``make`` as an async context, with the rig made and closed on its own thread."""

    @contextlib.asynccontextmanager
    async def opened(*args: P.args, **kwargs: P.kwargs) -> AsyncIterator[AsyncRig[RigT]]:
        with ThreadPoolExecutor(1, "longreach-rig") as thread:
            loop = asyncio.get_running_loop()
            rig = await loop.run_in_executor(thread, functools.partial(make, *args, **kwargs))
            try:
                yield AsyncRig(rig, thread)
            finally:
                await loop.run_in_executor(thread, rig.close)

    return opened


lockstep = _twin(rigs.lockstep)
connect = _twin(rigs.connect)
