"""The page itself: an address with a token, a frame that all pages share, and the server on 127.0.0.1."""

from __future__ import annotations

import secrets
from collections.abc import Callable, MutableMapping
from dataclasses import dataclass
from typing import Any

from nicegui import app, context, ui
from starlette.requests import HTTPConnection
from starlette.responses import PlainTextResponse

from .bench import HOST, Bench
from .data_pages import fails_page, log_page
from .model_pages import missing_page, output_page, parameters_page
from .tasks import TASKS
from .view import View

PAGES: dict[str, tuple[str, Callable[[View], None]]] = {
    "log": ("Log", log_page),
    "fails": ("Where it fails", fails_page),
    "missing": ("What is missing", missing_page),
    "parameters": ("Parameters", parameters_page),
    "out": ("Out", output_page),
}
# A browser that heeds this asks nobody but the workbench for anything.
_POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval' blob:; "
    "style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; font-src 'self' data:; "
    "connect-src 'self' ws:; frame-ancestors 'none'; form-action 'none'; base-uri 'self'"
)


@dataclass(frozen=True)
class PageSettings:
    """Times of the page, s."""

    look: float = 0.3  # between two looks at what the work has come to: slower looks like standing still
    patience: float = 30.0  # that a window may be away before the server forgets it


SETTINGS = PageSettings()


class TokenGate:
    """Lets requests pass that carry the token of the address, or the cookie that it was exchanged for."""

    def __init__(self, app: Any, token: str, name: str) -> None:
        self._app, self._token, self._name = app, token, name

    async def __call__(self, scope: MutableMapping[str, Any], receive: Any, send: Any) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
        elif self._known(HTTPConnection(scope)):
            await self._app(scope, receive, self._marked(send))
        elif scope["type"] == "websocket":
            await receive()
            await send({"type": "websocket.close", "code": 1008})
        else:
            words = "403: open the address that 'undertow workbench' printed, with its token\n"
            await PlainTextResponse(words, 403)(scope, receive, send)

    def _known(self, asked: HTTPConnection) -> bool:
        given = [*asked.query_params.getlist("token"), asked.cookies.get(self._name, "")]
        return any(secrets.compare_digest(one.encode(), self._token.encode()) for one in given)

    def _marked(self, send: Any) -> Any:
        cookie = f"{self._name}={self._token}; Path=/; HttpOnly; SameSite=Strict"
        extra = [(b"set-cookie", cookie.encode()), (b"content-security-policy", _POLICY.encode())]
        extra.append((b"referrer-policy", b"no-referrer"))

        async def marked(message: dict[str, Any]) -> None:
            if message["type"] == "http.response.start":
                message = {**message, "headers": [*message.get("headers", []), *extra]}
            await send(message)

        return marked


def set_up(bench: Bench, token: str, port: int) -> Callable[[], None]:
    """Put the gate before the application; what is returned draws the page for one window."""
    # Cookies of 127.0.0.1 are shared by all its ports: two workbenches must not overwrite each other's.
    app.add_middleware(TokenGate, token=token, name=f"undertow_{port}")
    return lambda: window(bench)


def window(bench: Bench) -> None:
    """One window on the workbench."""
    asked = context.client.request.query_params.get("page", "log")
    view = View(bench, page=asked if asked in PAGES else "log")
    ui.colors(primary="#0d47a1")
    ui.page_title(f"{bench.vehicle.name} - undertow workbench")
    ui.query(".nicegui-content").classes("p-0 gap-0 w-full")
    _header(view)
    body = ui.column().classes("w-full p-4 gap-3")
    view.draw = lambda: _draw(view, body)
    view.draw()
    ui.timer(SETTINGS.look, view.look)


def _draw(view: View, body: Any) -> None:
    body.clear()
    with body:
        _messages(view.bench)
        PAGES[view.page][1](view)


def _header(view: View) -> None:
    with ui.header().classes("items-center gap-4 py-0 px-4 bg-primary"):
        ui.label(view.bench.vehicle.name).classes("text-base font-bold")
        with ui.tabs().props("dense no-caps") as tabs:
            for name, (title, _) in PAGES.items():
                ui.tab(name, label=title).mark(f"page-{name}")
        tabs.set_value(view.page)
        tabs.on_value_change(lambda e: _show_page(view, str(e.value)))
        ui.space()
        _progress(view)


def _show_page(view: View, page: str) -> None:
    view.page = page
    ui.navigate.history.replace(f"/?page={page}")  # a reload comes back to this page; the cookie stays
    view.draw()


def _progress(view: View) -> None:
    with ui.row().classes("items-center gap-2 no-wrap").mark("progress") as row:
        bar = ui.linear_progress(0.0, show_value=False, size="8px").props("color=amber track-color=blue-3")
        bar.classes("w-40")
        words = ui.label().classes("text-xs whitespace-nowrap overflow-hidden text-ellipsis w-72")
        ui.button("Cancel", on_click=view.bench.cancel).props(
            "dense no-caps outline color=white size=sm padding='2px 10px'"
        )

    def show() -> None:
        work = view.bench.work
        row.set_visibility(work is not None)
        if work is not None:
            bar.set_value(work.done)
            words.set_text(work.words or TASKS[work.task][1])

    view.show_progress = show
    show()


def _messages(bench: Bench) -> None:
    if bench.place.vehicle_changed:
        ui.label(
            f"{bench.session.vehicle} was edited or moved after this session began: 'as given' is the "
            "present file, but earlier models come from the old one. Start a new --session to begin again."
        ).classes("text-amber-900 bg-amber-1 px-3 py-1 rounded w-full")
    if bench.failure:
        ui.label(bench.failure).classes("text-red-900 bg-red-1 px-3 py-1 rounded w-full").mark("failure")
    if bench.said:
        ui.label(bench.said).classes("bg-blue-1 px-3 py-1 rounded w-full").mark("said")


def serve(bench: Bench, port: int, *, show: bool, said: Callable[[str], None]) -> None:
    """Serve the page until Ctrl-C; `said` is told the address."""
    token = secrets.token_urlsafe(24)
    root = set_up(bench, token, port)
    address = f"/?token={token}"
    app.on_startup(lambda: said(f"http://{HOST}:{port}{address}"))
    app.on_shutdown(bench.close)
    ui.run(
        root,
        host=HOST,
        port=port,
        title="undertow workbench",
        reload=False,
        show=address if show else False,
        show_welcome_message=False,
        reconnect_timeout=SETTINGS.patience,
    )
