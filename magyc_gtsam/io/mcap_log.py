"""Reader of ROS messages in MCAP files, including files without an index or with an incomplete last chunk."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

from mcap.records import Channel, Metadata, Schema

from magyc_gtsam.io.log_info import LogInfo
from magyc_gtsam.io.mcap_records import METADATA, Block, records
from magyc_gtsam.io.request import Request
from magyc_gtsam.io.ros_log import RosLog, collected, info_of, recording_of
from magyc_gtsam.recording import Recording


def read(path: Path, request: Request) -> Recording:
    """Read an MCAP file; see `magyc_gtsam.io.read`."""
    request.only("MCAP")
    return recording_of(_load, path, request)


def info(path: Path) -> LogInfo:
    """Describe an MCAP file; see `magyc_gtsam.io.info`, which sets `problem`."""
    return info_of(_load, path, "MCAP")


def _load(path: Path, request: Request, wanted: Callable[[str, str], bool]) -> RosLog:
    """Load the topics of an MCAP file; see `ros_log.Load`."""
    notes: list[str] = []
    metadata: dict[str, str] = {}

    def ros_records() -> Iterator[Schema | Channel | Block]:
        for record in records(path, notes, request.report):
            if not isinstance(record, Metadata):
                yield record
            elif record.name == METADATA:
                metadata.update(record.metadata)

    return collected(path, ros_records(), request, wanted, notes, metadata)
