"""The project's one exception root; it lives in the lowest layer so that every layer can raise it."""


class MagycError(ValueError):
    """Wrong input or arguments. The message states the problem, its place, the limit, and the remedy."""
