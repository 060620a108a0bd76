"""What the page may ask of the server."""

import asyncio
import re
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from datetime import datetime
from hashlib import sha256
from importlib.resources import files
from io import BytesIO
from pathlib import Path
from pkgutil import get_data
from typing import Any, NamedTuple

import msgspec
import pandas as pd
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect, Request
from starlette.responses import Response
from starlette.routing import Route

from commonlaw.app.access import TooLargeError, TooSlowError
from commonlaw.app.equations import Asked, solved
from commonlaw.app.preview import Budget, Sample, preview, sample_table, simulated, suggested
from commonlaw.app.question import Columns, Question, check_lengths, fault, message, named, settings_form, text_in_page
from commonlaw.app.result import Found, Groups, compared, compared_groups, curves, figure_file, one_draws
from commonlaw.app.sessions import Named, SavedSessions, Search, Sessions
from commonlaw.app.working import prepare
from commonlaw.diagnostics import meaning, notes, sentences
from commonlaw.errors import CommonlawError
from commonlaw.law import Law, to_json, to_latex, to_script
from commonlaw.law.law import shares_terms
from commonlaw.law.script import Source
from commonlaw.law.tables import coefficient_rows, to_frame
from commonlaw.runtime.files import read_json
from commonlaw.runtime.packages import optional_import

_TYPES = {".html": "text/html", ".js": "text/javascript", ".css": "text/css"}
_NAMES = [file.name for file in files("commonlaw.app").joinpath("page").iterdir()]
ASSETS = {name: get_data("commonlaw.app", f"page/{name}") or b"" for name in _NAMES if Path(name).suffix in _TYPES}
"""All files that are served, by their name: no other can be named."""


class _Recognised(msgspec.Struct, forbid_unknown_fields=True):
    table: str
    columns: Columns = {}


class _DataSet(msgspec.Struct, forbid_unknown_fields=True):
    name: str


class _OtherTerms(msgspec.Struct, forbid_unknown_fields=True):
    terms: list[list[str]]
    """Names of terms, for each equation."""


class _Rival(msgspec.Struct, forbid_unknown_fields=True):
    """Another search, whose law is compared with a candidate of this one."""

    search: str
    candidate: int = 0


class _Call(NamedTuple):
    """A request: what the server keeps, what stands in the address, and its body as a value of its type."""

    sessions: Sessions
    saved: SavedSessions
    path: Mapping[str, Any]
    query: Mapping[str, str]
    body: Any

    @property
    def search(self) -> Search:
        """The search that the address names."""
        return self.sessions.searches.get(self.path["name"])


def application(sessions: Sessions) -> Starlette:
    """Return what answers; each call in a thread, and all but light ones when it is their turn."""
    # Requests that take time and memory, tables that are sent among them, wait for their turn
    saved, few = SavedSessions(), asyncio.Semaphore(4)

    def endpoint(kind: type | None, is_light: bool, answer: Callable[[_Call], Any]) -> Callable[[Request], Any]:
        async def answering(request: Request) -> Response:
            try:
                async with nullcontext() if is_light else few:
                    content = b"" if kind is None else await request.body()
                    call = _Call(sessions, saved, request.path_params, request.query_params, content)
                    result = await run_in_threadpool(lambda: answer(call._replace(body=_body(content, kind))))
                    return result if isinstance(result, Response) else _json({} if result is None else result)
            except CommonlawError as error:
                return _json({"error": message(error)}, 422)
            except TooLargeError:
                return _json({"error": "the file is too large for the app: use the command commonlaw discover"}, 413)
            except TooSlowError:
                return _json({"error": "the file came to a stop on its way: open it again"}, 408)
            except ClientDisconnect:  # The answer has no receiver
                return Response(status_code=408)
            except Exception as error:
                return _json({"error": message(fault(error))}, 500)

        return answering

    routes = [Route(f"/{'' if name == 'index.html' else name}", _asset(name)) for name in ASSETS]
    for path, method, kind, is_light, answer in _ROUTES:
        routes.append(Route(path, endpoint(kind, is_light, answer), methods=[method]))
    return Starlette(routes=routes)


def _body(content: bytes, kind: type | None) -> Any:
    """Return what was sent: bytes, or the value of a type in JSON."""
    if kind in (None, bytes):
        return content
    result: Any = read_json(content, kind)
    check_lengths(msgspec.to_builtins(result))
    return result


def _asset(name: str) -> Callable[[Request], Response]:
    return lambda _: Response(ASSETS[name], media_type=_TYPES[Path(name).suffix])


def _message(call: _Call) -> Response:
    code = call.path["code"]
    if code not in {*sentences(), *notes()}:
        raise CommonlawError("message-unknown", name=code[:80], hint="")
    return Response(meaning(code), media_type="text/plain")


def _add_table(call: _Call) -> dict[str, str]:
    table = named(call.query.get("name", "table"), call.body)
    table.cells()
    return {"table": call.sessions.open_table(table)}


def _preview(call: _Call) -> dict[str, Any]:
    prepare()  # A search will be next
    return preview(call.sessions.tables.get(call.body.table), call.body.columns)


def _found(call: _Call) -> dict[str, Any]:
    question = call.search.question
    written = question.equations.written if question.equations else ""
    return {"found": call.search.found.shown, "asked": question, "written": written}


def _equations(call: _Call) -> dict[str, Any]:
    asked, table = call.body, call.sessions.tables.get(call.body.table)
    return solved(table, asked.columns, asked.equations, asked.moved)


def _comparison(call: _Call) -> dict[str, Any]:
    rival = call.sessions.searches.get(call.body.search).found
    return compared(call.search.found.of_candidate(call.body.candidate), rival)


def _file(call: _Call) -> Response:
    """Return a file of a candidate; if none is named, of the law."""
    name, search, index = call.path["file"], call.search, _number_in(call.query.get("candidate") or "0")
    if name not in _MAKERS and name != "report.html":
        raise CommonlawError("download-name", name=name, files=[*_MAKERS, "report.html"])
    # Only for the law, the first candidate, there is a program that finds it in the table
    result, source = search.found.of_candidate(index), None if index else search.question.source(search.table)
    content: str | bytes
    if name == "report.html":
        table, title = search.table, call.query.get("title", "")[:120]
        checksum = f"SHA-256 {sha256(table.content).hexdigest()}" if table.content else ""
        about = ", ".join(filter(None, (table.name, datetime.now().astimezone().strftime("%Y-%m-%d"), checksum)))
        fitted = [candidate.candidate for candidate in result.candidates] if len(result.candidates) > 1 else []
        rivals = sorted(fitted, key=lambda candidate: candidate.size)
        from commonlaw.report import law_report, to_page

        with one_draws:
            made = law_report(
                result.findings, table=source or "", words=text_in_page, rivals=rivals, title=title, about=about
            )
            content = to_page(made)
    else:
        content = _MAKERS[name](result, source)
    headers = {"content-disposition": f'attachment; filename="{name}"'}
    return Response(content, media_type="application/octet-stream", headers=headers)


def _figure_file(call: _Call) -> Response:
    """Return a picture of a candidate, which the page shows, too; or its program."""
    search, asked, name = call.search, call.query, call.path["file"]
    index = _number_in(asked.get("candidate", "0"))
    result, source = search.found.of_candidate(index), search.question.source(search.table)
    content = figure_file(name, result, source, index > 0, asked.get("object", ""), asked.get("parameter", ""))
    kind = {"svg": "image/svg+xml", "png": "image/png"}.get(name.rpartition(".")[2], "text/x-python")
    return Response(content, media_type=kind, headers={"content-disposition": f'attachment; filename="{name}"'})


def _number_in(text: str) -> int:
    """Return the number of a candidate in an address."""
    if not re.fullmatch("[0-9]{1,6}", text):
        raise CommonlawError("candidate-name", text=text[:20])
    return int(text)


def _script(found: Found, source: Source | None) -> str:
    if source is None:
        raise CommonlawError("candidate-program")
    return to_script(found.law, source)


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
        for cell in (cell for sheet in book.sheets.values() for row in sheet.iter_rows() for cell in row):
            cell.data_type = "s" if cell.data_type == "f" else cell.data_type  # A name that begins with =
    return content.getvalue()


_MAKERS: dict[str, Callable[[Found, Source | None], str | bytes]] = {
    "law.json": lambda found, _: to_json(found.law),
    "law.py": _script,
    "law.tex": lambda found, _: to_latex(found.law, found.law.objects[0]),
    "coefficients.tsv": lambda found, _: _wide(found.law).to_csv(sep="\t", lineterminator="\n"),
    "coefficients.xlsx": _workbook,
    "coefficients.csv": lambda found, _: coefficient_rows(found.law).to_csv(index=False, lineterminator="\n"),
    "law.svg": lambda found, source: figure_file("law.svg", found, source or Source()),
    "law.png": lambda found, source: figure_file("law.png", found, source or Source()),
    "fit.csv": lambda found, _: curves(found, found.findings.fit).to_frame().to_csv(index=False),
    "forecasts.csv": lambda found, _: curves(found, found.findings.forecast).to_frame().to_csv(index=False),
}


_ROUTES: tuple[tuple[str, str, type | None, bool, Callable[[_Call], Any]], ...] = (
    ("/first", "GET", None, True, lambda call: {"table": None, "search": None} | call.sessions.latest),
    ("/messages/{code}", "GET", None, True, _message),
    ("/tables", "POST", bytes, False, _add_table),
    (
        "/datasets", "POST", _DataSet, False,
        lambda call: {"table": call.sessions.open_table(sample_table(call.body.name))},
    ),
    ("/sessions", "GET", None, False, lambda call: call.saved.listed()),
    ("/sessions", "POST", Named, False, lambda call: call.saved.save(call.body, call.sessions)),
    ("/sessions/{key}", "POST", None, False, lambda call: call.saved.resume(call.path["key"], call.sessions)),
    ("/sessions/{key}", "DELETE", None, False, lambda call: call.saved.delete(call.path["key"])),
    ("/sessions/{key}/undo", "POST", None, False, lambda call: call.saved.undo(call.path["key"], call.sessions)),
    ("/sessions/{key}/restored", "POST", None, False, lambda call: call.saved.restore(call.path["key"])),
    ("/previews", "POST", _Recognised, False, _preview),
    ("/equations", "POST", Asked, True, _equations),
    ("/settings", "GET", None, True, lambda _: settings_form()),
    ("/searches", "GET", None, True, lambda call: call.sessions.laws()),
    ("/searches", "POST", Question, False, lambda call: {"search": call.sessions.search(call.body)}),
    ("/searches/{name}", "GET", None, True, lambda call: call.search.state()),
    ("/searches/{name}", "DELETE", None, True, lambda call: call.search.cancel()),
    ("/searches/{name}/stop", "POST", None, True, lambda call: call.search.stop()),
    ("/searches/{name}/question", "GET", None, True, lambda call: call.search.question),
    ("/searches/{name}/found", "GET", None, True, _found),
    (
        "/searches/{name}/terms", "POST", _OtherTerms, False,
        lambda call: call.sessions.fit_terms(call.path["name"], call.body.terms),
    ),
    ("/searches/{name}/terms", "GET", None, True, lambda call: call.search.fit_state()),
    ("/searches/{name}/terms", "DELETE", None, True, lambda call: call.search.cancel_fit()),
    ("/searches/{name}/forecasts", "POST", Sample, False, lambda call: simulated(call.search.found, call.body)),
    ("/searches/{name}/experiments", "POST", Budget, False, lambda call: suggested(call.search.found, call.body)),
    ("/searches/{name}/comparison", "POST", _Rival, False, _comparison),
    ("/searches/{name}/groups", "POST", Groups, False, lambda call: compared_groups(call.search.found, call.body)),
    ("/searches/{name}/figures/{file}", "GET", None, False, _figure_file),
    ("/searches/{name}/{file}", "GET", None, False, _file),
)  # fmt: skip
"""Addresses and methods, with the type of the body, whether the answer is light, and the answer: JSON, or {} for None.

What is light is answered at once, whatever else goes on.
"""


def _json(value: Any, status: int = 200) -> Response:
    return Response(msgspec.json.encode(value), status, media_type="application/json")
