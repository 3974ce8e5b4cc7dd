"""The public collections of the leaderboard: unit, licence and role of each recording."""

from __future__ import annotations

import re
from dataclasses import dataclass

from magyc_gtsam.study.leaderboard.phones import WALKS

BROAD_UNITS = {  # inferred from the data: gyroscope biases, misalignments and hard irons form these clusters
    "A": (1, 4, 6, 8, 10, 15),
    "B": (2, 5, 7, 11, 16, 18, 21, 28, 29, 30, 31),
    "C": (3, 24, 25, 26, 27),
    "D": (32, 33, 34, 35, 36),
}
_BROAD_COMMIT = "afbaa4d75c4cd7c8ca76b8145b1812312d87fb7f"
_PHONES_COMMIT = "7b070df5231ac78910ab076eeb026d2d8152a246"
_BROAD_TRIALS = """
01_undisturbed_slow_rotation_A 02_undisturbed_slow_rotation_B 03_undisturbed_slow_rotation_C
04_undisturbed_slow_rotation_with_breaks_A 05_undisturbed_slow_rotation_with_breaks_B
06_undisturbed_fast_rotation_A 07_undisturbed_fast_rotation_B 08_undisturbed_fast_rotation_with_breaks_A
09_undisturbed_fast_rotation_with_breaks_B 10_undisturbed_slow_translation_A 11_undisturbed_slow_translation_B
12_undisturbed_slow_translation_C 13_undisturbed_slow_translation_with_breaks_A
14_undisturbed_slow_translation_with_breaks_B 15_undisturbed_fast_translation_A 16_undisturbed_fast_translation_B
17_undisturbed_fast_translation_with_breaks_A 18_undisturbed_fast_translation_with_breaks_B
19_undisturbed_slow_combined_240s 20_undisturbed_slow_combined_360s 21_undisturbed_fast_combined
22_undisturbed_fast_combined_240s 23_undisturbed_fast_combined_360s 24_disturbed_tapping_A 25_disturbed_tapping_B
26_disturbed_phone_vibration_A 27_disturbed_phone_vibration_B 28_disturbed_stationary_magnet_A
29_disturbed_stationary_magnet_B 30_disturbed_stationary_magnet_C 31_disturbed_stationary_magnet_D
32_disturbed_attached_magnet_1cm 33_disturbed_attached_magnet_2cm 34_disturbed_attached_magnet_3cm
35_disturbed_attached_magnet_4cm 36_disturbed_attached_magnet_5cm 37_disturbed_office_A 38_disturbed_office_B
39_disturbed_mixed
"""


@dataclass(frozen=True)
class Collection:
    """A set of recordings that were published together.

    Attributes:
        name: name of the collection.
        licence: licence of the data.
        source: origin of the data.
        citation: citation of the paper.
        address: address of the folder with the recordings.
        files: names under which the recordings are kept.
        walks: whether each file is assembled from the files of `phones.parts_of` at the address.
    """

    name: str
    licence: str
    source: str
    citation: str
    address: str
    files: tuple[str, ...]
    walks: bool = False


BROAD = Collection(
    "BROAD",
    "CC BY 4.0",
    "github.com/dlaidig/broad",
    "Laidig, Caruso, Cereatti and Seel 2021",
    f"https://raw.githubusercontent.com/dlaidig/broad/{_BROAD_COMMIT}/data_mat/",
    tuple(f"{trial}.mat" for trial in _BROAD_TRIALS.split()),
)
PHONES = Collection(
    "phones",
    "CeCILL 2.1",
    "github.com/tyrex-team/benchmarks-attitude-smartphones",
    "Michel, Genevès, Fourati and Layaïda 2017",
    f"https://raw.githubusercontent.com/tyrex-team/benchmarks-attitude-smartphones/{_PHONES_COMMIT}/datasets/",
    tuple(f"{walk}.npz" for walk in WALKS),
    walks=True,
)
COLLECTIONS = (BROAD, PHONES)

_TRIAL = re.compile(r"^(?:broad_)?(\d\d)_")
_WALK = re.compile(r"^(Guillaume|Jakob|Thibaud)_(Nexus5|iPhone4S|iPhone5)_(NoDist|Dist)_")
_NAMED = {  # renamed files; their hard iron is that of this person's walks
    "nexus5_augmented_reality": ("phone Nexus5 Thibaud", True),
    "nexus5_calibration_d1": ("phone Nexus5 Thibaud", False),
}


@dataclass(frozen=True)
class RecordingKind:
    """Collection, unit and role of a recording.

    Attributes:
        collection: the collection it belongs to.
        unit: the instrument; calibrations are judged on other recordings of the same unit.
        judges: whether calibrations may be judged on it: undisturbed, and turned in all directions.
    """

    collection: Collection
    unit: str
    judges: bool


def kind_of(name: str) -> RecordingKind | None:
    """Return the kind of a recording from its file name without suffix; None if its unit is unknown.

    The hard iron of the Nexus 5 moved by 20 µT between the days of two persons, so that these count as two units;
    those of the iPhones stayed within two sigmas.
    """
    if name in _NAMED:
        unit, judges = _NAMED[name]
        return RecordingKind(PHONES, unit, judges)
    walk = _WALK.match(name)
    if walk is not None:
        person, model, disturbed = walk.groups()
        unit = f"phone {model}" + (f" {person}" if model == "Nexus5" else "")
        return RecordingKind(PHONES, unit, disturbed == "NoDist")
    trial = _TRIAL.match(name)
    if trial is None:
        return None
    unit = next((unit for unit, trials in BROAD_UNITS.items() if int(trial[1]) in trials), "")
    judges = ("_undisturbed_" in name or name.endswith("_rotation")) and "_translation" not in name
    return RecordingKind(BROAD, f"BROAD {unit}", judges) if unit else None
