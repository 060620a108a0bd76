"""Layouts other than a table with a header and a row for each sample, each recognized by its structure.

A layout is a module with a function of this name, which returns None if the layout is another one; the first that does
not decides. Those in the table of `cells` get all rows of a text or of a sheet, and return the table in them; those in
the table of `columns` get a table, and return one with a row for each sample.
"""
