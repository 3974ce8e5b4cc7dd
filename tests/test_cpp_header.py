"""The C++ headers give the residuals and Jacobians of the Python factors, over generated cases.

The one with GTSAM factors is compiled where GTSAM's headers and library are: under `GTSAM_PREFIX`, the Python
environment's prefix, /usr/local or /usr; `LDFLAGS` goes to the linker.
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import A, B, F, H, M, X

from magyc_gtsam.factors import KeyframeField, keyframe_field_factor, magnetometer_factor

ROOT = Path(__file__).parents[1]
EIGEN = [Path("/usr/include/eigen3"), Path("/usr/local/include/eigen3"), Path("/opt/homebrew/include/eigen3")]
CASES = 12
SIGMA = 1e-6


def compiled(folder, source, prefix=None):
    """The binary of tests/`source`, on Eigen's headers and the GTSAM under `prefix`."""
    compiler = shutil.which("g++") or shutil.which("clang++")
    include = next((path for path in EIGEN if (path / "Eigen" / "Core").exists()), None)
    if compiler is None or include is None:
        pytest.skip("needs a C++ compiler and Eigen's headers (Debian: g++ libeigen3-dev)")
    flags = ["-std=c++17", f"-I{ROOT / 'factors' / 'cpp'}", str(ROOT / "tests" / source), f"-isystem{include}"]
    if prefix is None:
        flags += ["-O1", "-Wall", "-Werror"]
    else:
        library = prefix / "lib"
        flags += ["-O0", f"-isystem{prefix / 'include'}", f"-L{library}", f"-Wl,-rpath,{library}", "-lgtsam"]
        flags += os.environ.get("LDFLAGS", "").split()
    subprocess.run([compiler, *flags, "-o", str(folder / "cases")], check=True)
    return folder / "cases"


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    return compiled(tmp_path_factory.mktemp("cpp"), "cpp_header.cpp")


@pytest.fixture(scope="module")
def gtsam_program(tmp_path_factory):
    prefixes = [Path(os.environ.get("GTSAM_PREFIX", sys.prefix)), Path("/usr/local"), Path("/usr")]
    found = [each for each in prefixes if (each / "include/gtsam/nonlinear/NonlinearFactor.h").exists()]
    if not found:
        pytest.skip("needs GTSAM's headers and library, which its Python wheel does not have (GTSAM_PREFIX)")
    return compiled(tmp_path_factory.mktemp("gtsam"), "cpp_gtsam.cpp", found[0])


def case(seed):
    """Values of every key, and a block of samples that is longer than its compression in every other case."""
    random = np.random.default_rng(seed)
    values = gtsam.Values()
    values.insert(X(0), gtsam.Rot3.Expmap(2 * random.normal(size=3)))
    values.insert(A(0), np.array([1.0, 0, 0, 1, 0, 1]) + 0.2 * random.normal(size=6))
    values.insert(H(0), 30 * random.normal(size=3))
    values.insert(B(0), 0.05 * random.normal(size=3))
    values.insert(F(0), np.array([20.0, 5, 43]) + random.normal(size=3))
    values.insert(M(0), gtsam.Rot3.Expmap(random.normal(size=3)))
    time = np.linspace(0, 1, 51)
    count = 20 if seed % 2 else 60
    block = KeyframeField.from_samples(
        (np.linspace(0.05, 0.95, count), 3e-5 * random.normal(size=(count, 3))),
        (time, random.normal(size=(51, 3))),
        0.5,
        bias=0.02 * random.normal(size=3),
        body_R_sensor=gtsam.Rot3.Expmap(random.normal(size=3)),
    )
    return values, block, 40e-6 * random.normal(size=3)


def told(program, kind, values, rest):
    numbers = [values.atRot3(X(0)).matrix(), values.atVector(A(0)), values.atPoint3(H(0)), values.atPoint3(F(0))]
    numbers += [values.atRot3(M(0)).matrix(), *rest]
    text = " ".join(" ".join(repr(float(x)) for x in np.ravel(each)) for each in numbers)
    done = subprocess.run([str(program)], input=f"{kind} {text}\n", capture_output=True, text=True, check=True)
    return np.array(done.stdout.split(), dtype=float)


def expected(factor, values):
    jacobian, right = factor.linearize(values).jacobian()
    sizes = [values.extract([key]).dim() for key in list(factor.keys())]
    parts = np.split(jacobian, np.cumsum(sizes)[:-1], axis=1)
    return np.concatenate([-right, *(part.ravel() for part in parts)])


@pytest.mark.parametrize("seed", range(CASES))
def test_a_sample(program, seed):
    values, _, measured = case(seed)
    factor = magnetometer_factor(
        X(0), A(0), H(0), measured, gtsam.noiseModel.Unit.Create(3), field_key=F(0), mounting_key=M(0)
    )
    found = told(program, "sample", values, [measured * 1e6])
    np.testing.assert_allclose(found, expected(factor, values), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("seed", range(CASES))
def test_a_block(program, seed):
    values, block, _ = case(seed)
    factor = keyframe_field_factor(
        X(0), A(0), H(0), block, SIGMA, gyro_bias_key=B(0), field_key=F(0), mounting_key=M(0)
    )
    rows = block.compressed()
    rest = [values.atVector(B(0)), [len(rows.share)], rows.design, rows.share, rows.field * 1e6]
    rest += [rows.bias, rows.body_R_sensor, [SIGMA * 1e6]]
    found = told(program, "block", values, rest)
    wanted = expected(factor, values)
    np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-9 * np.abs(wanted).max())


def on_pose(values):
    """The same values with a pose in place of the rotation."""
    posed = gtsam.Values(values)
    posed.erase(X(0))
    posed.insert(X(0), gtsam.Pose3(values.atRot3(X(0)), np.array([1.0, 2.0, 3.0])))
    return posed


@pytest.mark.parametrize("seed", range(CASES))
def test_the_gtsam_factor_of_a_sample(gtsam_program, seed):
    values, _, measured = case(seed)
    factor = magnetometer_factor(
        X(0), A(0), H(0), measured, gtsam.noiseModel.Unit.Create(3), field=1e-6 * values.atPoint3(F(0)),
        body_R_sensor=values.atRot3(M(0)),
    )  # fmt: skip
    found = told(gtsam_program, "sample", values, [measured * 1e6])
    np.testing.assert_allclose(found, expected(factor, on_pose(values)), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("seed", range(CASES))
def test_the_gtsam_factor_of_a_block(gtsam_program, seed):
    values, block, _ = case(seed)
    factor = keyframe_field_factor(X(0), A(0), H(0), block, SIGMA, field=1e-6 * values.atPoint3(F(0)))
    rows = block.compressed()
    rest = [block.bias, [len(rows.share)], rows.design, rows.share, rows.field * 1e6]
    rest += [rows.bias, rows.body_R_sensor, [SIGMA * 1e6]]
    found = told(gtsam_program, "block", values, rest)
    wanted = expected(factor, on_pose(values))
    np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-9 * np.abs(wanted).max())
