"""Modules import one way, none another in a circle, for types included; one reads, one writes, one speaks."""

import ast
import re
from pathlib import Path

import grimp

import commonlaw

SOURCES = Path(commonlaw.__file__).parent

CHANGES_DISK = {
    "chmod", "hardlink_to", "makedirs", "mkdir", "open", "remove", "rename", "rmdir", "symlink_to", "tofile", "touch",
    "unlink", "write_bytes", "write_text",
}  # fmt: skip
"""Methods, and functions of modules, that change files or can."""

READS_DISK = {"fromfile", "genfromtxt", "loadtxt", "memmap", "open", "read_bytes", "read_excel", "read_text"}
"""What takes bytes out of a file by itself."""

MAKES_FILES = {"fcntl", "msvcrt", "shutil", "tempfile"}
"""Modules for that."""

TALKS = {"cli/output.py", "runtime/progress.py", "trials/workbook_process.py"}
"""What writes to standard output or standard error: what people are shown, and what another process reads."""


def reached(imports, start):
    """Return the modules that are imported from one on, directly or through others."""
    found, left = set(), [start]
    while left:
        new = imports[left.pop()] - found
        found |= new
        left += new
    return found


def test_no_files_import_each_other_in_a_circle():
    graph = grimp.build_graph("commonlaw", cache_dir=None)
    imports = {module: graph.find_modules_directly_imported_by(module) for module in graph.modules}
    reach = {module: reached(imports, module) for module in imports}
    circles = {frozenset(other for other in reach[module] if module in reach[other]) for module in reach}
    named = [" <-> ".join(sorted(circle)) for circle in circles if circle]
    assert not named, "import circles:\n" + "\n".join(named)


def changes_of_disk(module):
    """Yield the line and the name of whatever changes files in a module."""
    for node in ast.walk(ast.parse(module.read_text())):
        if isinstance(node, ast.Call):
            used = {getattr(node.func, "attr", "")} & CHANGES_DISK | {getattr(node.func, "id", "")} & {"open"}
        elif isinstance(node, ast.Import | ast.ImportFrom):
            used = {getattr(node, "module", None), *(each.name for each in node.names)} & MAKES_FILES
        else:
            continue
        yield from (f"{module.relative_to(SOURCES)}:{node.lineno}: {each}" for each in used)


def test_one_module_changes_what_is_on_disk():
    changes = [each for module in SOURCES.rglob("*.py") for each in changes_of_disk(module)]
    assert [each for each in changes if not each.startswith(("runtime/files.py:", "cli/output.py:"))] == [], (
        "write by commonlaw.runtime.files"
    )


def test_one_module_reads_what_is_on_disk():
    modules = [
        each
        for each in SOURCES.rglob("*.py")
        if each.name not in ("diagnostics.py", "reading.py", "files.py", "output.py")
        and str(each.relative_to(SOURCES)) != "kernel/__init__.py"
    ]
    calls = [node for each in modules for node in ast.walk(ast.parse(each.read_text())) if isinstance(node, ast.Call)]
    names = {getattr(call.func, "attr", getattr(call.func, "id", "")) for call in calls}
    assert not names & READS_DISK, "read by commonlaw.runtime.reading, within its limits"


def test_one_module_shows_people_what_there_is_to_say():
    talk = re.compile(r"click\.s?echo\b|^ *print\(|sys\.std(out|err)\.\w*write|\bConsole\(", re.MULTILINE)
    talking = {str(each.relative_to(SOURCES)) for each in SOURCES.rglob("*.py") if talk.search(each.read_text())}
    assert talking == TALKS, "say it by commonlaw.cli.output"
