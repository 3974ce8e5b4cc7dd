"""Many logs and many units of work: found, read lazily, calibrated each by itself, on processes or a cluster."""

from __future__ import annotations

import csv
import json
import multiprocessing
import os
import re
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import engine_work
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

import magyc_gtsam as mg
from magyc_gtsam.cli import main
from magyc_gtsam.cli.many import unique_names
from magyc_gtsam.cli.many_table import distinct_names
from magyc_gtsam.engine import DIED, run_many
from magyc_gtsam.io import SUFFIXES, write_mcap
from magyc_gtsam.io.many import find_logs

DIVE = Path(__file__).parents[1] / "datasets" / "calibration_dive.mcap"


@pytest.fixture(scope="module")
def season(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A tree with two dives, a file that is no log, and one that cannot be read."""
    from magyc_gtsam.io import write_mcap

    folder = tmp_path_factory.mktemp("season")
    (folder / "june").mkdir()
    for seed, name in ((1, "a.mcap"), (2, "june/a.mcap")):
        write_mcap(folder / name, mg.simulate("wide", 120, 10, seed=seed).recording)
    (folder / "june" / "broken.csv").write_text("time,nothing\n")
    (folder / "notes.md").write_text("no log")
    (folder / ".hidden.csv").write_text("no log")
    return folder


@pytest.fixture
def in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """As on a machine of one core: to start processes takes longer than the logs, and has tests of its own below."""
    monkeypatch.setattr("os.cpu_count", lambda: 1)


def test_logs_are_found(season: Path) -> None:
    all_of_them = (season / "a.mcap", season / "june/a.mcap", season / "june/broken.csv")
    assert find_logs(season) == all_of_them
    assert find_logs([season / "june/a.mcap", season]) == (all_of_them[1], all_of_them[0], all_of_them[2])
    assert find_logs(str(season / "**" / "*.mcap")) == all_of_them[:2]
    assert find_logs(season / "notes.md") == (season / "notes.md",)  # what is named is meant
    for wrong, says in (
        (season / "july", "no such file or folder"),
        (season / "*.bin", "no logs match"),
    ):
        with pytest.raises(mg.MagycError, match=says):
            find_logs(wrong)
    (season / "empty").mkdir(exist_ok=True)
    with pytest.raises(mg.MagycError, match="no logs in this folder"):
        find_logs(season / "empty")


def test_logs_of_every_reader_are_found(tmp_path: Path) -> None:
    """A folder listed the suffixes of half of them, and left the others out without a word."""
    bag = tmp_path / "bag"  # of ROS 2: a folder, and one log
    bag.mkdir()
    (bag / "metadata.yaml").touch()
    logs = {bag / "bag_0.db3", *(tmp_path / f"LOG{suffix.upper()}" for suffix in SUFFIXES if suffix != ".db3")}
    for log in logs:
        log.touch()
    assert {".tlog", ".bag", ".db3", ".zip", ".bbl", ".bfl"} < set(SUFFIXES)
    assert set(find_logs(tmp_path)) == logs
    assert set(find_logs(str(tmp_path / "**" / "*"))) == logs
    with pytest.raises(mg.MagycError, match=r"got a directory; read its bag_0\.db3"):
        mg.read(bag)


def test_read_many_reads_when_asked(season: Path) -> None:
    logs = mg.read_many(season)
    assert len(logs) == 3
    np.testing.assert_array_equal(logs[1].magnetic_field, mg.read(season / "june/a.mcap").magnetic_field)
    assert [log.duration for log in logs[:2]] == pytest.approx([119.9, 119.9])
    with pytest.raises(mg.MagycError, match="broken"):
        logs[2]
    history = mg.calibrate_many(logs)
    assert history.groups == ((0, 1),)
    assert history.contradictions[0].index == 2


def test_names_of_folders_are_unique() -> None:
    assert unique_names([Path("a.mcap"), Path("b.mcap")]) == ["a", "b"]
    assert unique_names([Path("x/a.mcap"), Path("y/a.mcap")]) == ["x-a", "y-a"]
    assert unique_names([Path("a.mcap"), Path("a.csv")]) == ["a", "a-2"]


def test_calibrate_a_folder(
    season: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], in_this_process: None
) -> None:
    folder = tmp_path / "results"
    assert main(["calibrate", str(season), "--output", str(folder)]) == 2  # the worst
    output, errors = capsys.readouterr()
    assert output.count("✔") == 2
    assert "without a trusted calibration: 1 of 3 logs" in errors
    assert "broken.csv" in errors
    with open(folder / "calibrations.csv", encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["exit_code"] for row in rows] == ["0", "0", "2"]
    for row in rows[:2]:
        calibration = mg.Calibration.load((folder / row["page"]).with_name("calibration.yaml"))
        assert float(row["hard_iron_y_uT"]) == calibration.hard_iron[1] * 1e6
        assert row["page"] in (folder / "index.html").read_text(encoding="utf-8")
    parquet = pytest.importorskip("pyarrow.parquet")
    table = parquet.read_table(folder / "calibrations.parquet").to_pylist()
    assert [row["hard_iron_x_uT"] for row in table[:2]] == [float(row["hard_iron_x_uT"]) for row in rows[:2]]

    # Run again, it goes on where it was: what is there is not made again.
    before = (folder / rows[0]["page"]).stat().st_mtime_ns
    assert main(["calibrate", str(season), "--output", str(folder), "--json"]) == 2
    again = json.loads(capsys.readouterr().out)["logs"]
    assert [row["hard_iron_x_uT"] for row in again] == [row["hard_iron_x_uT"] for row in table]
    assert (folder / rows[0]["page"]).stat().st_mtime_ns == before


def test_a_bug_costs_only_its_log(
    season: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    in_this_process: None,
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise ZeroDivisionError("no")

    monkeypatch.setattr("magyc_gtsam.cli.many.calibrate_log", fail)
    assert main(["calibrate", str(season), "-o", str(tmp_path / "all")]) == 2
    assert capsys.readouterr().err.count("internal error: ZeroDivisionError: no") == 3


def test_what_does_nothing_is_refused(
    season: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for words, says in (
        (["calibrate", DIVE, "--altitude", "3"], "--altitude: has no effect without a location"),
        (["calibrate", DIVE, "--hard-iron-walk", "3"], "give it (--prior)"),
        (["calibrate", season, "--pdf"], "--pdf: is for one LOG"),
        (["calibrate", season, "--sensor", "accelerometer"], "LOGS: not with --sensor accelerometer"),
        (["info", DIVE, "--strip"], "--strip: has no effect without --json"),
        (["online", DIVE, "--picture", "1"], "--picture: has no effect without --json"),
        (["export", "any.yaml", "px4", "--per-motor"], "--per-motor: has no effect without the target ardupilot"),
        (
            ["export", "any.yaml", "ardupilot", "--battery-voltage", "12"],
            "--battery-voltage: has no effect without",
        ),
    ):
        assert main(list(map(str, words))) == 2
        assert says in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("reset", ["1970-01-01", "1980-01-06", "2000-01-01"])
def test_a_log_of_a_clock_that_was_not_set_is_not_the_first(
    reset: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], in_this_process: None
) -> None:
    """Ordered by it the newest dive came first, and the iron of another one was predicted."""
    for k, day in enumerate(["2024-05-01", "2024-05-02", reset]):
        dive = mg.simulate("wide", 120, 10, seed=k, hard_iron=[2e-6 + 2e-6 * k, 12e-6, 9e-6]).recording
        start = np.datetime64(day, "s").astype(float) + 60.0
        write_mcap(tmp_path / f"dive{k + 1}.mcap", replace(dive, attitude=None, time=dive.time + start))
    assert main(["history", str(tmp_path), "-o", str(tmp_path / "out")]) == 0
    told = capsys.readouterr()
    assert "note: dive3.mcap has no date (its clock was not set" in told.err
    assert "2024-05-02" in told.out
    assert mg.Calibration.load(tmp_path / "out" / "next.yaml").hard_iron[0] == pytest.approx(6e-6, abs=1e-6)


def test_a_history_says_that_the_last_log_is_not_in_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], in_this_process: None
) -> None:
    """Its iron jumped half-way; the next was predicted from the logs before it without a word."""
    for k in range(3):
        dive = mg.simulate("wide", 300 if k == 2 else 120, 10, seed=k).recording
        step = np.where(dive.time[:, None] >= 150.0, [5e-6, 0.0, -8e-6], 0.0)
        write_mcap(tmp_path / f"dive{k}.mcap", replace(dive, magnetic_field=dive.magnetic_field + step))
    (tmp_path / "dive9.csv").write_text("time,nothing\n", encoding="utf-8")  # no log
    assert main(["history", str(tmp_path), "-o", str(tmp_path / "out")]) == 0
    told = capsys.readouterr()
    assert (
        "note: dive2.mcap, the last log, is not used: the prediction holds if the iron did not change" in told.err
    )
    assert "; 2 more logs left out, the last one among them" in told.out.splitlines()[0]
    (tmp_path / "dive2.mcap").unlink()
    assert main(["history", str(tmp_path), "-o", str(tmp_path / "again")]) == 0
    told = capsys.readouterr()
    assert "the last log" not in told.err
    assert told.out.splitlines()[0].endswith("; 1 more log left out")


def test_a_history_of_no_usable_log_says_why_of_each(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], in_this_process: None
) -> None:
    for seed in range(4):
        write_mcap(tmp_path / f"level{seed}.mcap", mg.simulate((1, 1, 5), 60, 10, seed=seed).recording)
    (tmp_path / "broken.csv").write_text("time,nothing\n", encoding="utf-8")
    output = tmp_path / "out"
    assert main(["history", *map(str, sorted(tmp_path.glob("*.*"))), "-o", str(output)]) == 1
    told = capsys.readouterr().err.splitlines()
    assert "none of 5 logs has a trusted calibration" in told[0]
    assert "broken.csv: " in told[1]
    assert [f"level{seed}.mcap: too little motion" in told[2 + seed] for seed in range(4)] == [True] * 4
    assert not output.exists()
    assert main(["history", str(tmp_path / "broken.csv"), "-o", str(output), "--json"]) == 2
    assert json.loads(capsys.readouterr().out)["contradictions"][0][1] == "broken.csv"
    with pytest.raises(mg.MagycError, match="5°-3: too little"):  # not only of the first few
        mg.calibrate_many(mg.read_many(sorted(tmp_path.glob("*.mcap"))))


def test_history_command(
    season: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "history"
    assert main(["history", str(season / "a.mcap"), str(season / "june"), "-o", str(folder), "--json"]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert shown["groups"] == [[0, 1]]
    assert shown["contradictions"][0][0] == 2
    monkeypatch.setattr("os.cpu_count", lambda: 1)  # the rest in this process
    assert main(["history", str(season / "a.mcap"), str(season / "june"), "-o", str(folder)]) == 0
    (unused,) = (line for line in capsys.readouterr().out.splitlines() if "broken.csv" in line)
    assert re.fullmatch(r"\S*broken.csv +– +– +not used: holds a header but no data", unused)
    following = mg.Calibration.load(folder / "next.yaml")
    assert shown["next"]["hard_iron"] == following.hard_iron.tolist()
    assert "from one log to the next" in shown["verdict"]["sentence"]
    assert {"history.yaml", "report.html", "px4.params", "next.yaml"} <= {file.name for file in folder.iterdir()}

    added = tmp_path / "added"
    shutil.copy(DIVE, tmp_path / "third.mcap")
    command = ["history", str(tmp_path / "third.mcap"), "--add", str(folder / "history.yaml"), "-o", str(added)]
    assert main(command) in (0, 1)  # simulated alike, but another instrument may be seen in it
    assert "third.mcap" in capsys.readouterr().out
    assert len(mg.History.load(added / "history.yaml")) == 4
    assert main(["history", str(season / "a.mcap"), "--add", str(folder / "history.yaml")]) == 2
    assert "a.mcap: its samples are in the history already as " in capsys.readouterr().err
    again = [*command[:3], str(added / "history.yaml"), "-o", str(tmp_path / "again")]
    assert main(again) == 2
    assert "third.mcap: its samples are in the history already; name a new log" in capsys.readouterr().err
    assert main([*again, "--end", "200"]) == 2  # a part of it
    assert "third.mcap: its samples are in the history already; name a new log" in capsys.readouterr().err
    (tmp_path / "empty.csv").write_text("t,mx,my,mz,wx,wy,wz\n", encoding="utf-8")
    assert main(["history", str(tmp_path / "empty.csv"), *command[2:], "-q"]) == 1
    assert "note: empty.csv is not used: holds a header but no data" in capsys.readouterr().err
    alone = tmp_path / "alone"
    assert main(["history", str(DIVE), "-o", str(alone)]) in (0, 1)
    write_mcap(tmp_path / DIVE.name, mg.simulate("wide", 120, 10, seed=5).recording)
    of_same_name = [
        "history",
        str(tmp_path / DIVE.name),
        "--add",
        str(alone / "history.yaml"),
        "-o",
        str(tmp_path / "again"),
    ]
    capsys.readouterr()
    assert main(of_same_name) in (0, 1)
    assert f"{DIVE.name} (2)" in capsys.readouterr().out
    assert main(["history", str(tmp_path / "third.mcap"), "--add", str(DIVE)]) == 2
    assert "not a text file; a history.yaml is expected here" in capsys.readouterr().err
    assert main([*command[:-1], str(tmp_path / "other"), "--gyroscope-scale", "1"]) == 2
    assert "calibrate all of them with the same gyroscope_scale" in capsys.readouterr().err


def test_parameters_of_an_earlier_run_do_not_stay_beside_an_untrusted_result(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], in_this_process: None
) -> None:
    a, b, c, d = (str(tmp_path / f"{name}.mcap") for name in "abcd")
    one, other = np.eye(3), np.diag([1.2, 0.9, 1.0])
    for seed, (path, iron) in enumerate(((a, one), (b, one), (c, other), (d, other))):
        write_mcap(path, mg.simulate("wide", 120, 10, seed=seed, soft_iron=iron).recording)
    together, each = tmp_path / "together", tmp_path / "each"
    for logs, code in (([a, b], 0), ([a, b, c, d], 1), ([a, b], 0), ([a, c], 1)):  # one instrument, or two
        assert main(["history", *logs, "-o", str(together), "-q"]) == code
        assert (together / "px4.params").exists() == (code == 0)
        assert mg.Calibration.load(together / "next.yaml").trusted == (code == 0)
        assert (": give the logs of one instrument alone" in capsys.readouterr().err) == (code == 1)
    for code in (0, 1):
        assert main(["calibrate", a, b, "-o", str(each), "-q"]) == code
        assert (each / "a" / "px4.params").exists() == (code == 0)
        write_mcap(a, mg.simulate("tiny", 30, 10).recording)
    write_mcap(a, mg.simulate("wide", 120, 10, seed=1).recording)
    assert main(["calibrate", a, b, "-o", str(each), "-q"]) == 0
    Path(a).write_text("time,nothing\n")
    assert main(["calibrate", a, b, "-o", str(each), "-q"]) == 2
    assert not (each / "a").exists()  # nothing of a log that is refused now
    assert (each / "b" / "px4.params").exists()


def test_results_are_not_read_as_logs(season: Path, tmp_path: Path, in_this_process: None) -> None:
    folder = tmp_path / "season"
    shutil.copytree(season, folder)
    logs = find_logs(folder)
    one = str(folder / "a.mcap")
    assert main(["calibrate", str(folder), "-o", str(folder / "results"), "-q"]) == 2
    assert main(["history", one, "-o", str(folder / "history"), "-q"]) == 0
    assert main(["compare", one, "-o", str(folder / "compared"), "-q", "--methods", "smoother"]) in (0, 1)
    assert {file.name for file in folder.rglob("*.csv")} >= {"calibrations.csv", "comparison.csv"}
    assert len(list(folder.rglob("vectornav.txt"))) == 3
    (folder / ".uploads").mkdir()
    (folder / ".uploads" / "a.csv").write_text("time,mx,my,mz\n")
    assert find_logs(folder) == logs
    (folder / "vectornav.txt").write_text("time,mx,my,mz\n")  # no result, as none is beside it
    assert folder / "vectornav.txt" in find_logs(folder)


def units(count: int) -> dict[str, Any]:
    return {f"unit-{seed}": (seed, 40) for seed in range(count)}


def test_processes_give_the_same_bits_and_go_on_where_they_were(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")
    here = run_many(engine_work.spectrum, units(6), workers=1)
    assert list(here) == list(units(6))
    assert run_many(engine_work.spectrum, units(6), workers=2) == here

    shares: list[float] = []
    first = run_many(engine_work.spectrum, units(3), workers=1, parts=tmp_path, progress=shares.append)
    assert shares == pytest.approx([1 / 3, 2 / 3, 1])
    assert len(list(tmp_path.glob("*.parquet"))) == 3
    both = run_many(engine_work.spectrum, units(6), workers=1, parts=tmp_path, progress=shares.append)
    assert len(shares) == 6
    assert both == here
    assert first == {name: here[name] for name in units(3)}


def test_a_process_that_dies_costs_its_unit(tmp_path: Path) -> None:
    once = {str(seed): (seed, str(tmp_path / "marker")) for seed in range(6)}
    rows = run_many(engine_work.kill_once, once, workers=2)
    assert rows == {str(seed): engine_work.spectrum((seed, 30)) for seed in range(6)}
    always = run_many(engine_work.kill_always, {str(i): i for i in range(4)}, workers=2)
    assert always == {"0": {"unit": 0}, "1": {"error": DIED}, "2": {"unit": 2}, "3": {"unit": 3}}


def test_an_interrupt_does_not_wait_for_units_that_run(tmp_path: Path) -> None:
    def interrupt(share: float) -> None:
        raise KeyboardInterrupt

    marker, before = tmp_path / "ended", {*multiprocessing.active_children()}
    with pytest.raises(KeyboardInterrupt):
        run_many(engine_work.last, {str(i): (i, str(marker)) for i in range(2)}, workers=2, progress=interrupt)
    assert {*multiprocessing.active_children()} <= before
    assert not marker.exists()


def test_engines_that_cannot_be_had() -> None:
    with pytest.raises(mg.MagycError, match="must be 'local' or the address"):
        run_many(engine_work.spectrum, units(1), engine="cluster")


@pytest.mark.skipif(os.name == "nt", reason="kills a process by a signal")
def test_a_cluster_with_a_worker_killed_gives_the_same_bits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    distributed, dask = pytest.importorskip("distributed"), pytest.importorskip("dask")
    once = {str(seed): (seed, str(tmp_path / "marker")) for seed in range(12)}
    tests = str(Path(__file__).parent)
    # Half a minute otherwise, where a result is asked of the worker that was killed.
    monkeypatch.setenv("DASK_DISTRIBUTED__COMM__TIMEOUTS__CONNECT", "3s")
    dask.config.refresh()
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, silence_logs=50
    ) as cluster:
        with distributed.Client(cluster) as client:
            client.run(lambda: __import__("sys").path.insert(0, tests))
            client.register_worker_callbacks(lambda: __import__("sys").path.insert(0, tests))
        rows = run_many(engine_work.kill_once, once, engine=cluster.scheduler_address)
    assert (tmp_path / "marker").exists()  # it was killed
    assert rows == {str(seed): engine_work.spectrum((seed, 30)) for seed in range(12)}


def test_every_compass_of_a_log(tmp_path: Path, capsys: pytest.CaptureFixture[str], in_this_process: None) -> None:
    """Two magnetometers beside one gyroscope: a page and parameters each, and one table."""
    log = tmp_path / "two.mcap"
    irons = ([1e-5, 2e-6, -3e-6], [-8e-6, 1e-5, 4e-6])
    with open(log, "wb") as file:
        writer = Writer(file)
        writer.start("ros2")
        known: dict[str, int] = {}
        for k, iron in enumerate(irons):
            part = tmp_path / f"part{k}.mcap"
            write_mcap(part, mg.simulate("wide", 100, seed=5, hard_iron=iron).recording)
            with open(part, "rb") as source:
                for schema, channel, message in make_reader(source).iter_messages():
                    if schema is None or (k and channel.topic != "/imu/mag"):
                        continue
                    topic = f"{channel.topic}_{k}" if channel.topic == "/imu/mag" else channel.topic
                    if topic not in known:
                        own = writer.register_schema(schema.name, schema.encoding, schema.data)
                        known[topic] = writer.register_channel(topic, channel.message_encoding, own)
                    writer.add_message(known[topic], message.log_time, message.data, message.publish_time)
        writer.finish()
    folder = tmp_path / "out"
    assert main(["calibrate", str(log), "--all", "-o", str(folder)]) == 0
    assert "/imu/mag_1" in capsys.readouterr().out
    with open(folder / "calibrations.csv", encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["magnetometer"] for row in rows] == ["/imu/mag_0", "/imu/mag_1"]
    for k, (row, iron) in enumerate(zip(rows, irons, strict=True)):
        own = (folder / row["page"]).parent
        calibration = mg.Calibration.load(own / "calibration.yaml")
        np.testing.assert_allclose(calibration.hard_iron, iron, atol=1e-6)
        assert f"CAL_MAG{k}_XOFF" in (own / "px4.params").read_text(encoding="utf-8")
        assert f"COMPASS_OFS{['', 2][k]}_X" in (own / "ardupilot.param").read_text(encoding="utf-8")
    assert main(["calibrate", str(log), "--all", "--magnetic-field", "/imu/mag_0", "-o", str(folder)]) == 2
    assert "leave out --magnetic-field" in capsys.readouterr().err


def test_logs_of_one_name_are_told_apart_by_their_folders():
    logs = [Path(name) for name in ("a/1/dive.mcap", "b/1/dive.mcap", "b/2/dive.mcap", "b/1/other.csv")]
    names = ["a/1/dive.mcap", "b/1/dive.mcap", "2/dive.mcap", "other.csv"]
    assert list(distinct_names(logs).values()) == names
