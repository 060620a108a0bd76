"""Files import one way: none imports another in a circle, for types only or within a function included."""

import grimp


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
