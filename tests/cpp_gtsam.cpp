// Reads cases from standard input, writes the GTSAM factors' residuals and Jacobians (tests/test_cpp_header.py).
#include <iomanip>
#include <iostream>
#include <string>
#include <vector>

#include "magnetometer_gtsam.hpp"

using namespace magyc;

template <class M>
void read(M& m) {
  for (Eigen::Index i = 0; i < m.rows(); ++i)
    for (Eigen::Index j = 0; j < m.cols(); ++j) std::cin >> m(i, j);
}

template <class M>
void write(const M& m) {
  for (Eigen::Index i = 0; i < m.rows(); ++i)
    for (Eigen::Index j = 0; j < m.cols(); ++j) std::cout << m(i, j) << ' ';
}

// As GTSAM itself calls it: by the base class, on a copy.
void write_factor(const CalibrationFactor& factor, const Matrix3& rotation, const Vector6& soft_iron,
                  const Vector3& hard_iron) {
  const gtsam::NonlinearFactor::shared_ptr copy = factor.clone();
  const gtsam::Pose3 pose(gtsam::Rot3(rotation), gtsam::Point3(1, 2, 3));
  gtsam::Matrix on_pose, on_soft_iron, on_hard_iron;
  const auto& called = dynamic_cast<const CalibrationFactor&>(*copy);
  write(called.evaluateError(pose, soft_iron, hard_iron, on_pose, on_soft_iron, on_hard_iron));
  write(on_pose), write(on_soft_iron), write(on_hard_iron);
}

int main() {
  std::cout << std::setprecision(17);
  std::string kind;
  while (std::cin >> kind) {
    Matrix3 rotation, mounting;
    Vector6 soft_iron;
    Vector3 hard_iron, field;
    read(rotation), read(soft_iron), read(hard_iron), read(field), read(mounting);
    if (kind == "sample") {
      Vector3 measured;
      read(measured);
      write_factor(MagnetometerFactor(0, 1, 2, measured, field, gtsam::noiseModel::Isotropic::Sigma(3, 0.5),
                                      gtsam::Rot3(mounting)),
                   rotation, soft_iron, hard_iron);
    } else {
      Vector3 bias;
      double count;
      read(bias);
      std::cin >> count;
      const auto k = static_cast<Eigen::Index>(count);
      Block block;
      block.design.resize(3 * k, 12), block.share.resize(k), block.field.resize(3 * k);
      read(block.design), read(block.share), read(block.field), read(block.bias), read(block.mounting);
      std::cin >> block.sigma;
      write_factor(KeyframeFieldFactor(0, 1, 2, block, field), rotation, soft_iron, hard_iron);
    }
    std::cout << '\n';
  }
}
