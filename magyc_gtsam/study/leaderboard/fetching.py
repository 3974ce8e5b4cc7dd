"""Search for the recordings of the leaderboard in a folder, or a single download with checksums for later runs."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from magyc_gtsam.engine import Progress
from magyc_gtsam.extras import needs
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.storage.files import sha256, whole_file
from magyc_gtsam.study.leaderboard.collections import COLLECTIONS
from magyc_gtsam.study.leaderboard.phones import arrays_of, parts_of
from magyc_gtsam.study.leaderboard.reading import FORMS

CHECKSUMS = "registry.txt"  # in pooch's format: per line a file name and its SHA-256


def local(folder: Path) -> list[Path]:
    """Return the recordings in a folder and its subfolders by name.

    Raises:
        MagycError: no such folder, or none in it.
    """
    if not folder.is_dir():
        raise MagycError(
            f"{folder}: is not a folder; give the folder with the recordings, or omit it to fetch them"
        )
    found = sorted((p for p in folder.rglob("*") if p.suffix in FORMS), key=lambda p: p.name)
    if not found:
        raise MagycError(f"{folder}: holds no recording ({', '.join(FORMS)})")
    return found


def fetch(folder: Path | None = None, address: str | None = None, progress: Progress | None = None) -> list[Path]:
    """Return all recordings of the collections, fetching the missing ones.

    The checksums of a mirror are in its `registry.txt`. The published originals have none: their addresses name a
    commit, and the checksum of the first download is stored and compared with all later ones.

    Args:
        folder: folder to store them in; None for the user's cache.
        address: address of a mirror with recordings and `registry.txt`; None for the collections' own addresses.
        progress: called with the share done.

    Raises:
        MagycError: the extra `leaderboard` is missing, an address does not answer, or a file has changed.
    """
    pooch = _pooch()
    kept = folder if folder is not None else Path(pooch.os_cache("magyc-gtsam"))
    kept.mkdir(parents=True, exist_ok=True)
    if address is not None:
        base = address.rstrip("/") + "/"
        known: dict[str, str | None] = dict(_registry_at(base))
        wanted = [(base, name, False) for name in known]
    else:
        known = dict(_registry(kept / CHECKSUMS))
        wanted = [(c.address, name, c.walks) for c in COLLECTIONS for name in c.files]
    files = []
    for done, (base, name, walk) in enumerate(wanted, start=1):
        files.append((_walk if walk else _recording)(base, name, known.get(name), kept))
        if address is None and name not in known:
            known[name] = sha256(files[-1])
            _note(kept / CHECKSUMS, known)
        if progress is not None:
            progress(done / len(wanted))
    return sorted(files, key=lambda p: p.name)


def _pooch() -> Any:
    with needs("the leaderboard, without --folder", "pooch", "leaderboard"):
        import pooch
    pooch.get_logger().setLevel("ERROR")
    return pooch


def _recording(base: str, name: str, known: str | None, folder: Path) -> Path:
    """Fetch a recording that is a single file at the address."""
    if Path(name).name != name or Path(name).suffix not in FORMS:
        raise MagycError(f"{base}{CHECKSUMS}: {name!r} is not the name of a recording ({', '.join(FORMS)})")
    return _retrieved(base, name, known, folder)


def _walk(base: str, name: str, known: str | None, folder: Path) -> Path:
    """Fetch the files of a walk, and store them as one file of arrays."""
    kept = folder / name
    if kept.exists() and known == sha256(kept):
        return kept
    walk = Path(name).stem
    with tempfile.TemporaryDirectory() as temporary:
        for published in parts_of(walk):
            _retrieved(base, published, None, Path(temporary))
        arrays = arrays_of(Path(temporary), walk)
    with whole_file(kept) as part, part.open("wb") as file:
        np.savez(file, allow_pickle=False, **arrays)
    return kept


def _retrieved(base: str, name: str, known: str | None, folder: Path) -> Path:
    try:
        return Path(_pooch().retrieve(base + name, known, fname=Path(name).name, path=folder))
    except ValueError:
        raise MagycError(
            f"{base}{name}: its SHA-256 differs from the stored {known}; the file was not kept"
        ) from None
    except OSError as error:  # the base of requests' errors
        raise MagycError(
            f"{base}{name}: cannot be fetched ({type(error).__name__}); check the network, or give --folder"
        ) from None


def _registry_at(base: str) -> Mapping[str, str]:
    """Fetch the present registry of a mirror."""
    with tempfile.TemporaryDirectory() as folder:
        try:
            file = _pooch().retrieve(base + CHECKSUMS, None, fname=CHECKSUMS, path=folder)
        except (OSError, ValueError) as error:
            raise MagycError(
                f"{base}{CHECKSUMS}: cannot be fetched ({type(error).__name__}); a mirror holds the recordings and "
                "this file, a name and a SHA-256 a line"
            ) from None
        return _registry(Path(file))


def _registry(file: Path) -> Mapping[str, str]:
    """Return {name: SHA-256}; empty if there is no file."""
    if not file.exists():
        return {}
    rows: Sequence[list[str]] = [line.split() for line in file.read_text(encoding="utf-8").splitlines() if line]
    for row in rows:
        if len(row) != 2 or len(row[1]) != 64:
            raise MagycError(f"{file}: {' '.join(row)!r} is not a name and a SHA-256")
    return dict((name, digest) for name, digest in rows)


def _note(file: Path, known: Mapping[str, str | None]) -> None:
    with whole_file(file) as part:
        part.write_text("".join(f"{name} {digest}\n" for name, digest in known.items()), encoding="utf-8")
