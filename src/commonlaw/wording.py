"""How things are counted in words."""


def counted(count: int, noun: str, ending: str = "s") -> str:
    """Return a number of things.

    >>> counted(1, "trial"), counted(3, "box", "es")
    ('1 trial', '3 boxes')
    """
    return f"{count} {noun}{'' if count == 1 else ending}"
