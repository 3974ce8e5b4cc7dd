"""The project's one exception root; it lives in the lowest layer so that every layer can raise it."""


class MagycError(ValueError):
    """Wrong input or arguments. The message states the problem, its place, the limit, and the remedy."""


class SingularError(MagycError):
    """The equations of a model have no finite or no unique solution."""

    def __init__(self, what: str) -> None:
        """State what was not found, such as "the eigenvalues"."""
        super().__init__(
            f"the data give no calibration: {what} of the model's equations cannot be computed, as where readings were "
            "smoothed or interpolated and have no noise of their own; log each sensor's own samples"
        )
