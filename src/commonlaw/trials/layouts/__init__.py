"""Layouts other than a table with a header and a row for each sample, each recognized by its structure.

A layout is a module with a function of this name and a line in the table of `cells`: it gets all rows of a text or of a
sheet, and returns the table in them, or None if the layout is another one. The first that does not decides.
"""
