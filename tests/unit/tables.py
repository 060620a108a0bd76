"""Tables of drops, and how they become files."""

import openpyxl
import pandas as pd

HEADER = ["ball", "drop", "time (s)", "height [m]", "wind", "mass [kg]"]
ROWS = [
    ["golf", 1, 0.0, 50.0, 0.1, 0.046],
    ["golf", 1, 0.1, 49.95, 0.2, 0.046],
    ["golf", 2, 0.0, 40.12345678901234, 0.3, 0.046],
    ["tennis", 1, 0.0, 30, 0.4, 0.057],
    ["tennis", 1, 0.25, 1 / 3, 0.5, 0.057],
]
FRAME = pd.DataFrame(ROWS, columns=HEADER)
ROLES = {"object": "ball", "trial": "drop", "inputs": "wind"}


def workbook(path, sheets):
    book = openpyxl.Workbook()
    book.remove(book.active)
    for name, rows in sheets.items():
        sheet = book.create_sheet(name)
        for row in rows:
            sheet.append(row)
    book.save(path)
    return path


def text(path, content):
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path
