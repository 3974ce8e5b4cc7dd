"""What the tree of sets of nearly the same readings takes over of a tree."""

from __future__ import annotations

from typing import NamedTuple

from magyc_gtsam.gap.model.problem import Model


class Outline(NamedTuple):
    """What the tree of nearly the same readings takes over of a tree, without its columns.

    Attributes:
        near: names, model and nats of the grid searches of the probable sets.
        refused: sets without a possible fit.
        unrivalled: terms, name and setting, that are not exchanged again.
    """

    near: tuple[tuple[tuple[str, ...], Model, float], ...]
    refused: frozenset[tuple[str, ...]]
    unrivalled: frozenset[tuple[object, ...]]
