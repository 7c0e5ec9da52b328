"""The loop that an application's objects live in, asked from the loop that speaks HTTP."""

import asyncio
import functools
from collections.abc import AsyncIterator, Awaitable, Callable
from inspect import isasyncgenfunction
from typing import Any, TypeVar

from fastapi import FastAPI
from fastapi.routing import APIRoute

T = TypeVar("T")
_END = object()


class Home:
    """Carries calls to ``loop``; from within it they are plain calls."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop

    async def call(self, function: Callable[..., Awaitable[T]], *given: Any, **named: Any) -> T:
        """What ``function`` returns or raises there. A caller that is cancelled cancels it."""

        async def called() -> T:
            return await function(*given, **named)

        if asyncio.get_running_loop() is self._loop:
            return await called()
        return await asyncio.wrap_future(asyncio.run_coroutine_threadsafe(called(), self._loop))

    def endpoint(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """An endpoint, or an endless one, that runs there whatever loop it is awaited in."""
        if isasyncgenfunction(function):

            @functools.wraps(function)
            async def followed(**named: Any) -> AsyncIterator[Any]:
                source = function(**named)
                try:
                    while (item := await self.call(anext, source, _END)) is not _END:
                        yield item
                finally:
                    await self.call(source.aclose)

            return followed

        @functools.wraps(function)
        async def called(**named: Any) -> Any:
            return await self.call(function, **named)

        return called


def run_endpoints_at(app: FastAPI, home: Home) -> None:
    """Have the endpoints that are added to ``app`` from now on run at ``home``.

    Requests are parsed, checked and answered by the loop that serves. Only what an endpoint itself does is
    done by the loop that has other duties as well: it is to be little.
    """

    class HomeRoute(APIRoute):
        def __init__(self, path: str, endpoint: Callable[..., Any], **more: Any) -> None:
            super().__init__(path, home.endpoint(endpoint), **more)

    app.router.route_class = HomeRoute
