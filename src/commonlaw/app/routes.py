"""What the page may ask of the server."""

import asyncio
import re
from collections.abc import Awaitable, Callable
from contextlib import AbstractAsyncContextManager, nullcontext
from datetime import datetime
from functools import partial, wraps
from hashlib import sha256
from io import BytesIO
from pkgutil import get_data
from typing import Any

import msgspec
import pandas as pd
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect, Request
from starlette.responses import Response
from starlette.routing import Route

from commonlaw.app.access import TooLargeError, TooSlowError
from commonlaw.app.equations import Asked, solved
from commonlaw.app.figures import curves, figure_file, one_draws
from commonlaw.app.preview import Budget, Sample, preview, sample_table, simulated, suggested
from commonlaw.app.question import Columns, Question, message, named, settings_form, text_in_page
from commonlaw.app.result import Found, Groups, compared, compared_groups
from commonlaw.app.saved import Named, SavedSessions
from commonlaw.app.sessions import Search, Sessions
from commonlaw.app.working import prepare
from commonlaw.diagnostics import meaning, notes, sentences
from commonlaw.errors import CommonlawError
from commonlaw.law import Law, to_json, to_latex, to_script
from commonlaw.law.law import shares_terms
from commonlaw.law.script import Source
from commonlaw.law.tables import coefficient_rows, to_frame
from commonlaw.report import law_report, to_page
from commonlaw.runtime.packages import optional_import
from commonlaw.runtime.reading import read_json

_SCRIPTS = (
    "app",
    "basics",
    "compare",
    "curves",
    "edits",
    "equations",
    "figures",
    "law",
    "measurements",
    "next",
    "own",
    "panels",
    "plots",
    "question",
    "sessions",
    "take",
    "uplot",
)

ASSETS = {
    "": ("index.html", "text/html"),
    **{f"{name}.js": (f"{name}.js", "text/javascript") for name in _SCRIPTS},
    "app.css": ("app.css", "text/css"),
    "uplot.css": ("uplot.css", "text/css"),
}
"""All files that are served, by their address: no other can be named."""

_AT_ONCE = 4
"""Requests that take time and memory, tables that are sent among them; others wait for their turn."""

_NUMBER = re.compile("[0-9]{1,6}")

Endpoint = Callable[[Request], Awaitable[Response]]


class _Recognised(msgspec.Struct, forbid_unknown_fields=True):
    table: str
    columns: Columns = Columns()


class _DataSet(msgspec.Struct, forbid_unknown_fields=True):
    name: str


class _OtherTerms(msgspec.Struct, forbid_unknown_fields=True):
    terms: list[list[str]]
    """Names of terms, for each equation."""


class _Rival(msgspec.Struct, forbid_unknown_fields=True):
    """Another search, whose law is compared with a candidate of this one."""

    search: str
    candidate: int = 0


def application(sessions: Sessions) -> Starlette:
    """Return what answers."""
    routes = [Route(f"/{name}", _asset(*each)) for name, each in ASSETS.items()]
    few = asyncio.Semaphore(_AT_ONCE)
    for path, method, answer in (
        ("/first", "GET", _first),
        ("/messages/{code}", "GET", _message),
        ("/tables", "POST", _add_table),
        ("/datasets", "POST", _add_data_set),
        ("/sessions", "GET", _saved),
        ("/sessions", "POST", _save),
        ("/sessions/{key}", "POST", _open),
        ("/sessions/{key}", "DELETE", _delete),
        ("/sessions/{key}/undo", "POST", _undo),
        ("/sessions/{key}/restored", "POST", _restore),
        ("/previews", "POST", _preview),
        ("/equations", "POST", _equations),
        ("/settings", "GET", _settings),
        ("/searches", "GET", _laws),
        ("/searches", "POST", _search),
        ("/searches/{name}", "GET", _state),
        ("/searches/{name}", "DELETE", _cancel),
        ("/searches/{name}/question", "GET", _question),
        ("/searches/{name}/found", "GET", _found),
        ("/searches/{name}/terms", "POST", _fit_terms),
        ("/searches/{name}/terms", "GET", _fit_state),
        ("/searches/{name}/terms", "DELETE", _cancel_fit),
        ("/searches/{name}/forecasts", "POST", _forecast),
        ("/searches/{name}/experiments", "POST", _experiments),
        ("/searches/{name}/comparison", "POST", _comparison),
        ("/searches/{name}/groups", "POST", _groups),
        ("/searches/{name}/figures/{file}", "GET", _figure_file),
        ("/searches/{name}/{file}", "GET", _file),
    ):
        routes.append(Route(path, _mended(answer, nullcontext() if answer in _LIGHT else few), methods=[method]))
    made = Starlette(routes=routes)
    made.state.sessions, made.state.saved = sessions, SavedSessions()
    return made


def _asset(name: str, kind: str) -> Endpoint:
    content = get_data("commonlaw.app", f"page/{name}")

    async def answer(_: Request) -> Response:
        return Response(content, media_type=kind)

    return answer


def _mended(
    answer: Callable[[Sessions, Request], Awaitable[Response]], turn: AbstractAsyncContextManager[None]
) -> Endpoint:
    """Return an endpoint that says what a user can mend, and answers when it is its turn."""

    @wraps(answer)
    async def answering(request: Request) -> Response:
        try:
            async with turn:
                return await answer(request.app.state.sessions, request)
        except CommonlawError as error:
            return _json({"error": message(error)}, 422)
        except TooLargeError:
            return _json({"error": "the file is too large for the app: use the command commonlaw discover"}, 413)
        except TooSlowError:
            return _json({"error": "the file came to a stop on its way: open it again"}, 408)
        except ClientDisconnect:  # nobody hears this
            return Response(status_code=408)

    return answering


async def _first(sessions: Sessions, _: Request) -> Response:
    """Tell where a new page goes on: with the table and the search of the last one."""
    return _json({"table": None, "search": None} | sessions.latest)


async def _message(_: Sessions, request: Request) -> Response:
    """Explain a message by its code."""
    code = request.path_params["code"]
    if code not in {*sentences(), *notes()}:
        raise CommonlawError("message-unknown", name=code[:80], hint="")
    return Response(meaning(code), media_type="text/plain")


async def _add_table(sessions: Sessions, request: Request) -> Response:
    table = named(request.query_params.get("name", "table"), await request.body())
    await run_in_threadpool(table.cells)
    return _json({"table": sessions.open_table(table)})


async def _add_data_set(sessions: Sessions, request: Request) -> Response:
    asked = read_json(await request.body(), _DataSet)
    return _json({"table": sessions.open_table(await run_in_threadpool(sample_table, asked.name))})


async def _preview(sessions: Sessions, request: Request) -> Response:
    asked = read_json(await request.body(), _Recognised)
    await run_in_threadpool(prepare)  # A search will be next
    return _json(await run_in_threadpool(preview, sessions.tables.get(asked.table), asked.columns))


async def _equations(sessions: Sessions, request: Request) -> Response:
    asked = read_json(await request.body(), Asked)
    table = sessions.tables.get(asked.table)
    return _json(await run_in_threadpool(solved, table, asked.columns, asked.equations, asked.moved))


async def _settings(_: Sessions, __: Request) -> Response:
    return _json(settings_form())


async def _search(sessions: Sessions, request: Request) -> Response:
    question = read_json(await request.body(), Question)
    return _json({"search": await run_in_threadpool(sessions.search, question)})


async def _state(sessions: Sessions, request: Request) -> Response:
    search = sessions.searches.get(request.path_params["name"])
    return _json(await run_in_threadpool(search.state))


async def _question(sessions: Sessions, request: Request) -> Response:
    return _json(sessions.searches.get(request.path_params["name"]).question)


async def _found(sessions: Sessions, request: Request) -> Response:
    search = sessions.searches.get(request.path_params["name"])
    found = await run_in_threadpool(lambda: search.found.shown)
    given = search.question.equations
    return _json({"found": found, "asked": search.question, "written": given.written if given else ""})


async def _cancel(sessions: Sessions, request: Request) -> Response:
    search = sessions.searches.get(request.path_params["name"])
    await run_in_threadpool(search.cancel)
    return _json({})


async def _fit_terms(sessions: Sessions, request: Request) -> Response:
    asked = read_json(await request.body(), _OtherTerms)
    await run_in_threadpool(sessions.fit_terms, request.path_params["name"], asked.terms)
    return _json({})


async def _fit_state(sessions: Sessions, request: Request) -> Response:
    search = sessions.searches.get(request.path_params["name"])
    return _json(await run_in_threadpool(search.fit_state))


async def _cancel_fit(sessions: Sessions, request: Request) -> Response:
    search = sessions.searches.get(request.path_params["name"])
    await run_in_threadpool(search.cancel_fit)
    return _json({})


async def _forecast(sessions: Sessions, request: Request) -> Response:
    found = sessions.searches.get(request.path_params["name"]).found
    asked = read_json(await request.body(), Sample)
    return _json(await run_in_threadpool(simulated, found, asked))


async def _experiments(sessions: Sessions, request: Request) -> Response:
    found = sessions.searches.get(request.path_params["name"]).found
    asked = read_json(await request.body(), Budget)
    return _json(await run_in_threadpool(suggested, found, asked))


async def _saved(_: Sessions, request: Request) -> Response:
    """List the sessions on disk."""
    return _json(await run_in_threadpool(request.app.state.saved.listed))


async def _save(sessions: Sessions, request: Request) -> Response:
    asked = read_json(await request.body(), Named)
    return _json(await run_in_threadpool(request.app.state.saved.save, asked, sessions))


async def _open(sessions: Sessions, request: Request) -> Response:
    return _json(await run_in_threadpool(request.app.state.saved.resume, request.path_params["key"], sessions))


async def _undo(sessions: Sessions, request: Request) -> Response:
    return _json(await run_in_threadpool(request.app.state.saved.undo, request.path_params["key"], sessions))


async def _delete(_: Sessions, request: Request) -> Response:
    await run_in_threadpool(request.app.state.saved.delete, request.path_params["key"])
    return _json({})


async def _restore(_: Sessions, request: Request) -> Response:
    await run_in_threadpool(request.app.state.saved.restore, request.path_params["key"])
    return _json({})


async def _laws(sessions: Sessions, _: Request) -> Response:
    """List the laws that were found."""
    return _json(sessions.laws())


async def _comparison(sessions: Sessions, request: Request) -> Response:
    asked = read_json(await request.body(), _Rival)
    one, other = (sessions.searches.get(name).found for name in (request.path_params["name"], asked.search))
    return _json(await run_in_threadpool(lambda: compared(one.of_candidate(asked.candidate), other)))


async def _groups(sessions: Sessions, request: Request) -> Response:
    found = sessions.searches.get(request.path_params["name"]).found
    asked = read_json(await request.body(), Groups)
    return _json(await run_in_threadpool(compared_groups, found, asked))


async def _file(sessions: Sessions, request: Request) -> Response:
    search = sessions.searches.get(request.path_params["name"])
    name, candidate = request.path_params["file"], request.query_params.get("candidate", "")
    if name not in _MAKERS:
        raise CommonlawError("download-name", name=name, files=_MAKERS)
    content = await run_in_threadpool(_made, search, name, candidate, request.query_params.get("title", "")[:120])
    headers = {"content-disposition": f'attachment; filename="{name}"'}
    return Response(content, media_type="application/octet-stream", headers=headers)


async def _figure_file(sessions: Sessions, request: Request) -> Response:
    """Return a picture of a candidate, which the page shows, too; or its program."""
    search, asked, name = (
        sessions.searches.get(request.path_params["name"]),
        request.query_params,
        request.path_params["file"],
    )
    index = _number_in(asked.get("candidate", "0"))
    found, source = search.found, search.question.source(search.table)
    content = await run_in_threadpool(
        lambda: figure_file(
            name, found.of_candidate(index), source, index > 0, asked.get("object", ""), asked.get("parameter", "")
        )
    )
    kind = {"svg": "image/svg+xml", "png": "image/png"}.get(name.rpartition(".")[2], "text/x-python")
    return Response(content, media_type=kind, headers={"content-disposition": f'attachment; filename="{name}"'})


def _made(search: Search, name: str, candidate: str, title: str) -> str | bytes:
    """Return a file of a candidate; if none is named, of the law."""
    index = 0 if not candidate else _number_in(candidate)
    # Only for the law, the first candidate, there is a program that finds it in the table
    found, source = search.found.of_candidate(index), None if index else search.question.source(search.table)
    if name == "report.html":
        table = search.table
        checksum = sha256(table.content).hexdigest() if table.content else ""
        parts = (table.name, datetime.now().astimezone().strftime("%Y-%m-%d"), checksum and f"SHA-256 {checksum}")
        return _report(found, source, title, ", ".join(filter(None, parts)))
    return _MAKERS[name](found, source)


def _number_in(text: str) -> int:
    """Return the number of a candidate in an address."""
    if not _NUMBER.fullmatch(text):
        raise CommonlawError("candidate-name", text=text[:20])
    return int(text)


def _script(found: Found, source: Source | None) -> str:
    if source is None:
        raise CommonlawError("candidate-program")
    return to_script(found.law, source)


def _report(found: Found, source: Source | None, title: str = "", about: str = "") -> str:
    fitted = [each.candidate for each in found.candidates] if len(found.candidates) > 1 else []
    rivals = sorted(fitted, key=lambda each: each.size)
    with one_draws:
        made = law_report(
            found.findings, table=source or "", words=text_in_page, rivals=rivals, title=title, about=about
        )
        return to_page(made).decode()


def _figure(name: str, found: Found, source: Source | None) -> bytes:
    return figure_file(name, found, source or Source())


def _wide(law: Law) -> pd.DataFrame:
    return to_frame(law, errors=law.uncertainty.covariance is not None)


def _workbook(found: Found, _: Source | None) -> bytes:
    """Return the coefficients as a workbook: a row for each object, and a sheet with a row for each coefficient."""
    optional_import("openpyxl", "a workbook", "excel")
    content, law = BytesIO(), found.law
    with pd.ExcelWriter(content, engine="openpyxl") as book:
        if shares_terms(law):
            _wide(law).to_excel(book, sheet_name="objects")
        coefficient_rows(law).to_excel(book, sheet_name="coefficients", index=False)
    return content.getvalue()


def _curves(kind: str, found: Found, _: Source | None) -> str:
    return str(curves(found, getattr(found.findings, kind)).to_frame().to_csv(index=False))


_LIGHT = (_first, _message, _laws, _equations, _settings, _question, _state, _found, _cancel, _fit_state, _cancel_fit)
"""What is answered at once, whatever else goes on."""

_MAKERS: dict[str, Callable[[Found, Source | None], str | bytes]] = {
    "law.json": lambda found, _: to_json(found.law),
    "law.py": _script,
    "law.tex": lambda found, _: to_latex(found.law, found.law.objects[0]),
    "coefficients.tsv": lambda found, _: _wide(found.law).to_csv(sep="\t", lineterminator="\n"),
    "coefficients.xlsx": _workbook,
    "coefficients.csv": lambda found, _: coefficient_rows(found.law).to_csv(index=False, lineterminator="\n"),
    "report.html": _report,
    "law.svg": partial(_figure, "law.svg"),
    "law.png": partial(_figure, "law.png"),
    "fit.csv": partial(_curves, "fit"),
    "forecasts.csv": partial(_curves, "forecast"),
}


def _json(value: Any, status: int = 200) -> Response:
    return Response(msgspec.json.encode(value), status, media_type="application/json")
