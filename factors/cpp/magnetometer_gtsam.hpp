// GTSAM factors of the residuals in magnetometer.hpp, for GTSAM 4.1 to 4.3.
//
// docs/slam.md lists the systems and versions with which this was compiled; tests/test_cpp_header.py compiles it where
// GTSAM's headers are installed and compares both factors with the Python ones.
// Soft iron keys hold a gtsam::Vector of 6, as graphs made in Python do; hard iron keys a Point3.
#pragma once

#include <gtsam/config.h>
#include <gtsam/geometry/Pose3.h>
#include <gtsam/nonlinear/NonlinearFactor.h>

#include <stdexcept>
#include <string>

#include "magnetometer.hpp"

namespace magyc {

// GTSAM 4.3 passes Jacobians by pointer, earlier versions by boost::optional; both are read in the same way.
#if GTSAM_VERSION_NUMERIC >= 40300
using OptionalMatrix = gtsam::OptionalMatrixType;
using CalibrationFactor = gtsam::NoiseModelFactorN<gtsam::Pose3, gtsam::Vector, gtsam::Point3>;
#else
using OptionalMatrix = boost::optional<gtsam::Matrix&>;
using CalibrationFactor = gtsam::NoiseModelFactor3<gtsam::Pose3, gtsam::Vector, gtsam::Point3>;
#endif

/// The six elements of a soft iron; throws std::invalid_argument if a key holds another number of values.
inline Vector6 elements(const gtsam::Vector& soft_iron) {
  if (soft_iron.size() != 6)
    throw std::invalid_argument("soft iron: the key holds " + std::to_string(soft_iron.size()) +
                                " numbers, 6 are expected");
  return Vector6(soft_iron);
}

/// One sample on (Pose3, soft iron, hard iron) in a known field.
class MagnetometerFactor : public CalibrationFactor {
  Vector3 measured_, field_;
  Matrix3 mounting_;

 public:
  using CalibrationFactor::evaluateError;

  MagnetometerFactor(gtsam::Key attitude, gtsam::Key soft_iron, gtsam::Key hard_iron, const Vector3& measured,
                     const Vector3& field, const gtsam::SharedNoiseModel& noise,
                     const gtsam::Rot3& body_R_sensor = gtsam::Rot3())
      : CalibrationFactor(noise, attitude, soft_iron, hard_iron), measured_(measured), field_(field),
        mounting_(body_R_sensor.matrix()) {}

  gtsam::NonlinearFactor::shared_ptr clone() const override {
    return gtsam::NonlinearFactor::shared_ptr(new MagnetometerFactor(*this));
  }

  gtsam::Vector evaluateError(const gtsam::Pose3& pose, const gtsam::Vector& soft_iron, const gtsam::Point3& hard_iron,
                              OptionalMatrix on_pose, OptionalMatrix on_soft_iron,
                              OptionalMatrix on_hard_iron) const override {
    SampleJacobians jacobians;
    const Vector3 residual = sample_error(pose.rotation().matrix(), elements(soft_iron), hard_iron, field_, mounting_,
                                          measured_, &jacobians);
    if (on_pose) {
      on_pose->setZero(3, 6);
      on_pose->leftCols<3>() = jacobians.rotation;
    }
    if (on_soft_iron) *on_soft_iron = jacobians.soft_iron;
    if (on_hard_iron) *on_hard_iron = jacobians.hard_iron;
    return residual;
  }
};

/// A block of samples on (Pose3, soft iron, hard iron) in a known field, with the gyroscope's bias held at the block's.
class KeyframeFieldFactor : public CalibrationFactor {
  Block block_;
  Vector3 field_;

 public:
  using CalibrationFactor::evaluateError;

  KeyframeFieldFactor(gtsam::Key attitude, gtsam::Key soft_iron, gtsam::Key hard_iron, const Block& block,
                      const Vector3& field)
      : CalibrationFactor(gtsam::noiseModel::Unit::Create(3 * block.share.size()), attitude, soft_iron, hard_iron), block_(block),
        field_(field) {}

  gtsam::NonlinearFactor::shared_ptr clone() const override {
    return gtsam::NonlinearFactor::shared_ptr(new KeyframeFieldFactor(*this));
  }

  gtsam::Vector evaluateError(const gtsam::Pose3& pose, const gtsam::Vector& soft_iron, const gtsam::Point3& hard_iron,
                              OptionalMatrix on_pose, OptionalMatrix on_soft_iron,
                              OptionalMatrix on_hard_iron) const override {
    BlockJacobians jacobians;
    const gtsam::Vector residual = block_error(block_, pose.rotation().matrix(), elements(soft_iron), hard_iron,
                                               block_.bias, field_, block_.mounting, &jacobians);
    if (on_pose) {
      on_pose->setZero(residual.size(), 6);
      on_pose->leftCols<3>() = jacobians.rotation;
    }
    if (on_soft_iron) *on_soft_iron = jacobians.soft_iron;
    if (on_hard_iron) *on_hard_iron = jacobians.hard_iron;
    return residual;
  }
};

}  // namespace magyc
