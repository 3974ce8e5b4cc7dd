"""Decompression of the chunks of an MCAP file, with a limit of the unpacked size."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from pathlib import Path

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.storage.files import size_of

LARGEST_CHUNK = 1 << 28  # bytes, unpacked; recorders write chunks of 1 to 16 MB


class Damage(MagycError):
    """Error of a record or chunk that cannot be read, although the rest of the file can."""


# Limit of the unpacked size: a multiple of the file's size, and bytes. Measurements pack to 1/5, headers to 1/10.
UNPACKED = (100, 1 << 26)


def allowance(path: Path, what: str = "", limit: tuple[int, int] | None = None) -> Callable[[int], None]:
    """Return a function that is told of bytes before they are kept, and raises once a file asks for too many.

    Args:
        path: the file, or the folder of a bag.
        what: what the file does then, and the remedy; the default is about unpacking.
        limit: a multiple of the file's size, and bytes beside it; that of unpacking if None.
    """
    limit = UNPACKED if limit is None else limit
    size = size_of(path)
    left = limit[0] * size + limit[1]
    what = what or (
        f"unpacks to more than {limit[0]} times its {size} bytes, the limit that protects the memory; is it a log of "
        "measurements?"
    )

    def take(count: int) -> None:
        nonlocal left
        left -= count
        if left < 0:
            raise MagycError(f"{path}: {what}")

    return take


def decompressed(data: bytes, compression: str, size: int, checksum: int) -> bytes:
    """Decompress the records of a chunk.

    Args:
        data: compressed records.
        compression: "zstd", "lz4" or "" for none.
        size: declared size of the result, bytes.
        checksum: declared CRC-32 of the result; 0 for none.

    Raises:
        Damage: see `unpacked`.
    """
    if compression in ("zstd", "lz4"):
        if size > LARGEST_CHUNK:
            raise Damage(f"it declares {size} bytes, more than the limit of {LARGEST_CHUNK}")
        try:
            data = _zstd(data, size) if compression == "zstd" else _lz4(data, size)
        except (RuntimeError, ValueError, MemoryError) as error:  # RuntimeError is lz4's
            raise Damage(str(error) or type(error).__name__) from None
    if checksum and (calculated := zlib.crc32(data)) != checksum:
        raise Damage(f"crc validation failed in Chunk, expected: {checksum}, calculated: {calculated}")
    return data


def _zstd(data: bytes, size: int) -> bytes:
    import zstandard  # only if needed: it is slow to import

    try:
        named = zstandard.frame_content_size(data)
        if named > size:
            raise ValueError(f"it unpacks to {named} bytes, not to {size}")
        decompressor = zstandard.ZstdDecompressor(max_window_size=LARGEST_CHUNK)
        return decompressor.decompress(data, max_output_size=max(size, 1))
    except zstandard.ZstdError as error:
        raise ValueError(str(error) or type(error).__name__) from None


def _lz4(data: bytes, size: int) -> bytes:
    import lz4.frame  # only if needed

    decompressor = lz4.frame.LZ4FrameDecompressor()
    # Without a limit the input would be unpacked completely before its length is known.
    result = bytes(decompressor.decompress(data, max_length=size + 1))
    if len(result) > size:
        raise ValueError(f"it unpacks to more than {size} bytes")
    if not decompressor.eof:
        raise ValueError("it ends too early")
    return result
