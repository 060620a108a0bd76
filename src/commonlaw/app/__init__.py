"""The app: a page on this machine alone, from a table to a law without code."""
