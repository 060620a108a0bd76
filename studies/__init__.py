"""Studies: finished investigations that run from end to end and make a report."""
