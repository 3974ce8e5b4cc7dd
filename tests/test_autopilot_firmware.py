"""Vehicles of random parameters: from a log's bytes to the exported parameters, through the firmware's own formulas.

What the sensors sensed comes out of the reader, whatever the vehicle did to it; and what is exported, on the vehicle,
corrects as the calibration does, and leaves the other sensors alone.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_export import symmetric, turned
from test_io_ardupilot import dataflash
from test_io_px4 import ulog, written

import magyc_gtsam as mg
from magyc_gtsam.factors.effects.term import Term
from magyc_gtsam.io import read
from magyc_gtsam.io.px4_calibration import euler, mounting
from magyc_gtsam.recording import Array

Parameters = dict[str, float]
ROWS = 40
TIME = np.arange(ROWS) * 0.1


def of_axes(parameters: Parameters, pattern: str, default: float = 0.0) -> Array:
    return np.array([parameters.get(pattern.format(axis), default) for axis in "XYZ"])


def found(random: np.random.Generator, recording: mg.Recording, current: str, throttle: str) -> mg.Calibration:
    """A calibration with a field of motors or none, and with a misalignment or none."""
    channel = [None, current, throttle][random.integers(3)]
    terms = []
    if channel is not None:
        size = 1e-7 if channel == current else 3e-6
        setting = {"reference_0": 0.4} if random.integers(2) else {}
        terms.append(Term("motor-current", random.normal(0, size, 3), np.eye(3) * 1e-18, setting, (channel,)))
    if random.integers(2):
        terms.append(Term("misalignment", random.normal(0, 0.05, 3), np.eye(3) * 1e-9))
    asymmetric = np.eye(3) + 0.1 * random.normal(size=(3, 3))
    assert recording.autopilot is not None
    return mg.Calibration(
        (asymmetric + asymmetric.T) / 2,
        random.normal(0, 20e-6, 3),
        random.normal(0, 0.01, 3),
        terms=tuple(terms),
        configuration={"autopilot": recording.autopilot.to_dict()},
    )


def expected(calibration: mg.Calibration, field: Array, channels: dict[str, Array]) -> Array:
    """What `apply` gives, without a rotation that the vehicle cannot apply."""
    fixed = calibration.configuration["autopilot"]["magnetometer"]["fixed"]
    terms = tuple(term for term in calibration.terms if not (fixed and term.name == "misalignment"))
    needed = {name: channels[name] for term in terms for name in term.channels}
    return np.asarray(replace(calibration, terms=terms).apply(field, time=TIME, channels=needed))


class Ardupilot:
    """A vehicle with up to three compasses and two gyroscopes."""

    def __init__(self, random: np.random.Generator) -> None:
        self.compasses = int(random.integers(1, 4))
        self.order = random.permutation(self.compasses)  # of the drivers, by priority
        self.sensed = random.normal(0, 300, (self.compasses, ROWS, 3))  # milligauss, in the compasses' axes
        self.rates = random.normal(0, 0.5, (2, ROWS, 3))
        self.throttle, self.current = random.uniform(0, 1, ROWS), random.uniform(0, 30, ROWS)
        self.of_outputs = random.normal(0, 20, (ROWS, 3))
        p: Parameters = {"AHRS_ORIENTATION": int(random.choice([0, 2, 6, 16, 24, 101])), "CUST_ROT_ENABLE": 1}
        p |= {"COMPASS_MOTCT": int(random.integers(3)), "COMPASS_PMOT_EN": int(random.integers(2))}
        p |= {f"CUST_ROT{k}_{a}": random.uniform(-40, 40) for k in (1, 2) for a in ("ROLL", "PITCH", "YAW")}
        p |= {f"INS_{name}_{a}": random.normal(0, 0.02) for name in ("GYROFFS", "GYR2OFFS") for a in "XYZ"}
        for driver, n in enumerate(self.suffixes):
            p |= {f"COMPASS_DEV_ID{n}": 100 + driver}
            p |= {f"COMPASS_PRIO{self.order.tolist().index(driver) + 1}_ID": 100 + driver}
            p |= {f"COMPASS_ORIENT{n}": int(random.choice([0, 4, 6, 8, 101, 102]))}
            p |= {
                f"COMPASS_EXTERN{n or 'AL'}": int(random.integers(3)),
                f"COMPASS_SCALE{n}": random.choice([0, 1.1, 2]),
            }
            for a in "XYZ":
                p |= {
                    f"COMPASS_OFS{n}_{a}": random.uniform(-300, 300),
                    f"COMPASS_DIA{n}_{a}": random.uniform(0.8, 1.3),
                }
                p |= {
                    f"COMPASS_MOT{n}_{a}": random.choice([0, 2]),
                    f"COMPASS_ODI{n}_{a}": random.uniform(-0.1, 0.1),
                }
        self.parameters = p

    @property
    def suffixes(self) -> list[str]:
        return ["", "2", "3"][: self.compasses]

    def turn(self, p: Parameters, number: float) -> Array:
        return turned(p, f"CUST_ROT{int(number) - 100}_") if number > 100 else mounting(int(number))

    def mounted(self, p: Parameters, driver: int) -> Array:
        """AP_Compass_Backend::rotate_field."""
        n = self.suffixes[driver]
        own = p[f"COMPASS_ORIENT{n}"] if p[f"COMPASS_EXTERN{n or 'AL'}"] else p["AHRS_ORIENTATION"]
        return self.turn(p, own)

    def motors(self, p: Parameters, driver: int) -> Array:
        if p["COMPASS_PMOT_EN"] and driver == 0:
            return self.of_outputs
        power = (0 * self.throttle, self.throttle, self.current)[int(p["COMPASS_MOTCT"])]
        return np.asarray(power[:, None] * of_axes(p, f"COMPASS_MOT{self.suffixes[driver]}_{{}}"))

    def field(self, p: Parameters, driver: int) -> Array:
        """AP_Compass_Backend::correct_field."""
        n = self.suffixes[driver]
        scale = p[f"COMPASS_SCALE{n}"]
        field = self.sensed[driver] @ self.mounted(p, driver).T + of_axes(p, f"COMPASS_OFS{n}_{{}}")
        matrix = symmetric(*([p[f"COMPASS_{m}{n}_{a}"] for a in "XYZ"] for m in ("DIA", "ODI")))
        return np.asarray(field * (scale if 1 / 1.5 <= scale <= 1.5 else 1) @ matrix + self.motors(p, driver))

    def log(self, path: Path) -> Path:
        p = self.parameters
        board = self.turn(p, p["AHRS_ORIENTATION"])
        messages: list[tuple[str, tuple]] = [("PARM", (0, name, float(value))) for name, value in p.items()]
        for row in range(ROWS):
            at = 1_000_000 + row * 100_000
            for k, driver in enumerate(self.order):
                field, motor = (each(p, driver)[row].astype(int) for each in (self.field, self.motors))
                offset = of_axes(p, f"COMPASS_OFS{self.suffixes[driver]}_{{}}").astype(int)
                messages.append(("MAG", (at, k, *field, *offset, *motor, 1, at)))
            for k, name in enumerate(("GYROFFS", "GYR2OFFS")):
                rate = board @ (self.rates[k, row] - of_axes(p, f"INS_{name}_{{}}"))
                messages.append(("IMU", (at, k, *rate, 0.0, 0.0, -9.8)))
            messages += [("BAT", (at, 0, self.current[row])), ("CTUN", (at, 0.0, self.throttle[row]))]
        more = {"BAT": (70, "QBf", "TimeUS,I,Curr"), "CTUN": (71, "Qff", "TimeUS,ThI,ThO")}
        return dataflash(path, messages, more)


@pytest.mark.parametrize("seed", range(12))
def test_ardupilot(tmp_path: Path, seed: int) -> None:
    random = np.random.default_rng(seed)
    vehicle = Ardupilot(random)
    before = vehicle.parameters
    path = vehicle.log(tmp_path / "a.BIN")
    board = vehicle.turn(before, before["AHRS_ORIENTATION"])
    channels = {"BAT.Curr": vehicle.current, "CTUN.ThO": vehicle.throttle}
    for place, driver in enumerate(vehicle.order):
        k = int(random.integers(2))
        recording = read(path, magnetic_field=f"MAG[{place}]", angular_rate=f"IMU[{k}]")
        field = vehicle.sensed[driver] @ vehicle.mounted(before, driver).T * 1e-7
        np.testing.assert_allclose(recording.magnetic_field, field, atol=2.5e-7)
        np.testing.assert_allclose(recording.angular_rate, vehicle.rates[k] @ board.T, atol=1e-6)
        calibration = found(random, recording, "BAT.Curr", "CTUN.ThO")
        text = calibration.export("ardupilot")
        after = before | {n: float(v) for n, v in re.findall(r"^(\w+),(.*)$", text, re.MULTILINE)}
        np.testing.assert_allclose(
            vehicle.field(after, driver) * 1e-7, expected(calibration, field, channels), atol=1e-9
        )
        np.testing.assert_array_equal(vehicle.turn(after, after["AHRS_ORIENTATION"]), board)
        offset = of_axes(after, f"INS_{('GYROFFS', 'GYR2OFFS')[k]}_{{}}")
        rate = calibration.apply_gyroscope(vehicle.rates[k] @ board.T)
        np.testing.assert_allclose((vehicle.rates[k] - offset) @ board.T, rate, atol=1e-7)
        for other in set(vehicle.order) - {driver}:
            was, now = (vehicle.field(p, other) - vehicle.motors(p, other) for p in (before, after))
            np.testing.assert_allclose(was, now, atol=1e-9)
            was, now = (vehicle.motors(p, other) for p in (before, after))
            assert np.array_equal(was, now) or not now.any()


class Px4:
    """A vehicle with up to three compasses in four slots, and a gyroscope."""

    def __init__(self, random: np.random.Generator) -> None:
        self.slots = random.permutation(4)[: random.integers(1, 4)].tolist()
        self.corrected = bool(random.integers(2))  # vehicle_magnetometer, else sensor_mag
        self.sensed = dict(zip(self.slots, random.normal(0, 0.3, (len(self.slots), ROWS, 3)), strict=True))
        self.rates = random.normal(0, 0.5, (ROWS, 3))
        self.throttle, self.current = random.uniform(0, 1, ROWS), random.uniform(0, 30, ROWS)
        self.gyroscope = f"CAL_GYRO{random.integers(4)}_"
        p: Parameters = {
            "SENS_BOARD_ROT": int(random.choice([0, 2, 6, 8])),
            "SENS_BOARD_Z_OFF": random.choice([0, -2.0]),
        }
        p |= {"CAL_MAG_COMP_TYP": int(random.integers(4)), f"{self.gyroscope}ID": 77}
        p |= {f"{self.gyroscope}ROT": int(random.choice([-1, 6]))}
        p |= {f"{self.gyroscope}{a}OFF": random.normal(0, 0.02) for a in "XYZ"}
        for slot in self.slots:
            mag = f"CAL_MAG{slot}_"
            p |= {f"{mag}ID": 11 + slot, f"{mag}ROT": int(random.choice([-1, 0, 4, 6, 100]))}
            p |= {f"{mag}{a}": random.uniform(-30, 30) for a in ("ROLL", "PITCH", "YAW")}
            for a in "XYZ":
                p |= {f"{mag}{a}OFF": random.normal(0, 0.1), f"{mag}{a}SCALE": random.uniform(0.8, 1.2)}
                p |= {f"{mag}{a}ODIAG": random.uniform(-0.1, 0.1)}
                p |= {f"{mag}{a}COMP": 0.0 if self.corrected else random.choice([0.0, 0.2])}
        self.parameters = p

    def turn(self, p: Parameters, prefix: str) -> Array:
        number = int(p[f"{prefix}ROT"])
        if number == 100:
            return turned(p, prefix)
        board = euler(0.0, 0.0, p["SENS_BOARD_Z_OFF"]) @ mounting(int(p["SENS_BOARD_ROT"]))
        return mounting(number) if number >= 0 else board

    def motors(self, p: Parameters, slot: int) -> Array:
        """Magnetometer::UpdatePower; there is no second battery."""
        power = (0 * self.current, self.throttle, self.current * 1e-3, 0 * self.current)[
            int(p["CAL_MAG_COMP_TYP"])
        ]
        return np.asarray(power[:, None] * of_axes(p, f"CAL_MAG{slot}_{{}}COMP"))

    def field(self, p: Parameters, slot: int, power: float = 1.0) -> Array:
        """Magnetometer::Correct."""
        raw = self.sensed[slot] + power * self.motors(p, slot) - of_axes(p, f"CAL_MAG{slot}_{{}}OFF")
        scale, beside = (of_axes(p, f"CAL_MAG{slot}_{{}}{name}") for name in ("SCALE", "ODIAG"))
        turn = self.turn(p, f"CAL_MAG{slot}_")
        return np.asarray(raw @ symmetric(scale.tolist(), beside.tolist()) @ turn.T)

    def log(self, path: Path) -> Path:
        at = [10_000_000 + row * 100_000 for row in range(ROWS)]
        name = "vehicle_magnetometer" if self.corrected else "sensor_mag"
        messages = [
            ("sensor_gyro", 0, [(t, 77, *w) for t, w in zip(at, self.rates, strict=True)]),
            ("battery_status", 0, list(zip(at, self.current, strict=True))),
            ("actuator_controls_0", 0, [(t, 0, 0, 0, c) for t, c in zip(at, self.throttle, strict=True)]),
        ]
        for k, slot in enumerate(self.slots):
            rows = self.field(self.parameters, slot, 0.0) if self.corrected else self.sensed[slot]
            messages.append((name, k, [(t, 11 + slot, *m) for t, m in zip(at, rows, strict=True)]))
        more = {"battery_status": {"timestamp": "Q", "current_a": "f"}}
        more |= {"actuator_controls_0": {"timestamp": "Q", "control": "4f"}}
        more |= {"vehicle_magnetometer": {"timestamp": "Q", "device_id": "I", "magnetometer_ga": "3f"}}
        return ulog(path, self.parameters, messages, more)


@pytest.mark.parametrize("seed", range(12))
def test_px4(tmp_path: Path, seed: int) -> None:
    pytest.importorskip("pyulog")
    random = np.random.default_rng(seed)
    vehicle = Px4(random)
    before = vehicle.parameters
    path = vehicle.log(tmp_path / "a.ulg")
    current, throttle = "battery_status.current_a", "actuator_controls_0.control[3]"
    turn = vehicle.turn(before, vehicle.gyroscope)
    for k, slot in enumerate(vehicle.slots):
        name = "vehicle_magnetometer" if vehicle.corrected else "sensor_mag"
        recording = read(path, magnetic_field=f"{name}[{k}]")
        field = vehicle.sensed[slot] @ vehicle.turn(before, f"CAL_MAG{slot}_").T * 1e-4
        np.testing.assert_allclose(recording.magnetic_field, field, atol=1e-9)
        np.testing.assert_allclose(recording.angular_rate, vehicle.rates @ turn.T, atol=1e-6)
        calibration = found(random, recording, current, throttle)
        after = before | written(calibration.export("px4"))
        wanted = expected(calibration, field, {current: vehicle.current, throttle: vehicle.throttle})
        np.testing.assert_allclose(vehicle.field(after, slot) * 1e-4, wanted, atol=1e-9)
        rate = calibration.apply_gyroscope(vehicle.rates @ turn.T)
        offset = of_axes(after, f"{vehicle.gyroscope}{{}}OFF")
        np.testing.assert_allclose((vehicle.rates - offset) @ turn.T, rate, atol=1e-7)
        for other in set(vehicle.slots) - {slot}:
            np.testing.assert_array_equal(vehicle.field(before, other, 0.0), vehicle.field(after, other, 0.0))
            was, now = (vehicle.motors(p, other) for p in (before, after))
            assert np.array_equal(was, now) or not now.any()
