"""The message of a failure, in one line."""

from __future__ import annotations

from magyc_gtsam.option_names import as_options


def explained(error: Exception, command: str = "") -> str:
    """Return the message of a failure, with arguments of the library named as options of the command line.

    Args:
        error: the failure.
        command: the command that failed, if its name is known.
    """
    usage = getattr(error, "format_message", None)  # of usage errors, in every version of click
    if usage is not None:
        context = getattr(error, "ctx", None)
        path = context.command_path if context is not None else f"magyc-gtsam {command}".rstrip()
        text = usage().replace("Value error, ", "").removesuffix(".")
        return f"{text}{' See' if text.endswith('?') else '; see'} {path} --help"
    from magyc_gtsam.factors.errors import MagycError

    if isinstance(error, MagycError):
        return as_options(str(error))
    if isinstance(error, OSError):
        where = f"{error.filename}: " if error.filename else ""
        return f"{where}{error.strerror or error}; check the path, its permissions and the space left"
    if isinstance(error, MemoryError):
        return f"not enough memory ({error}); use a part of the log (--start, --end)"
    return (
        f"internal error: {type(error).__name__}: {error}; this is a bug, please report it "
        "(MAGYC_DEBUG=1 shows the traceback)"
    )
