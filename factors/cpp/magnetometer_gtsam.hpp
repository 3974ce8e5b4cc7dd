// GTSAM factors of the residuals in magnetometer.hpp: a thin wrapper, written against GTSAM 4.3's NoiseModelFactorN.
//
// It has NOT been compiled by this project, whose machines have GTSAM's Python wheel but not its headers; the residuals
// and Jacobians it calls are compiled and compared with the Python factors (tests/test_cpp_header.py).
// Soft iron keys hold a gtsam::Vector of 6, as graphs made in Python do; hard iron keys a Point3.
#pragma once

#include <gtsam/geometry/Pose3.h>
#include <gtsam/nonlinear/NonlinearFactor.h>

#include "magnetometer.hpp"

namespace magyc {

/// One sample on (Pose3, soft iron, hard iron) in a known field.
class MagnetometerFactor : public gtsam::NoiseModelFactorN<gtsam::Pose3, gtsam::Vector, gtsam::Point3> {
  using Base = gtsam::NoiseModelFactorN<gtsam::Pose3, gtsam::Vector, gtsam::Point3>;
  Vector3 measured_, field_;
  Matrix3 mounting_;

 public:
  using Base::evaluateError;

  MagnetometerFactor(gtsam::Key attitude, gtsam::Key soft_iron, gtsam::Key hard_iron, const Vector3& measured,
                     const Vector3& field, const gtsam::SharedNoiseModel& noise,
                     const gtsam::Rot3& body_R_sensor = gtsam::Rot3())
      : Base(noise, attitude, soft_iron, hard_iron), measured_(measured), field_(field),
        mounting_(body_R_sensor.matrix()) {}

  gtsam::NonlinearFactor::shared_ptr clone() const override {
    return std::make_shared<MagnetometerFactor>(*this);
  }

  gtsam::Vector evaluateError(const gtsam::Pose3& pose, const gtsam::Vector& soft_iron, const gtsam::Point3& hard_iron,
                              gtsam::OptionalMatrixType on_pose, gtsam::OptionalMatrixType on_soft_iron,
                              gtsam::OptionalMatrixType on_hard_iron) const override {
    SampleJacobians jacobians;
    const Vector3 residual = sample_error(pose.rotation().matrix(), Vector6(soft_iron), hard_iron, field_, mounting_,
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

/// A block of samples on (Pose3, soft iron, hard iron) in a known field, the gyroscope's bias held at the block's own.
class KeyframeFieldFactor : public gtsam::NoiseModelFactorN<gtsam::Pose3, gtsam::Vector, gtsam::Point3> {
  using Base = gtsam::NoiseModelFactorN<gtsam::Pose3, gtsam::Vector, gtsam::Point3>;
  Block block_;
  Vector3 field_;

 public:
  using Base::evaluateError;

  KeyframeFieldFactor(gtsam::Key attitude, gtsam::Key soft_iron, gtsam::Key hard_iron, const Block& block,
                      const Vector3& field)
      : Base(gtsam::noiseModel::Unit::Create(3 * block.share.size()), attitude, soft_iron, hard_iron), block_(block),
        field_(field) {}

  gtsam::NonlinearFactor::shared_ptr clone() const override {
    return std::make_shared<KeyframeFieldFactor>(*this);
  }

  gtsam::Vector evaluateError(const gtsam::Pose3& pose, const gtsam::Vector& soft_iron, const gtsam::Point3& hard_iron,
                              gtsam::OptionalMatrixType on_pose, gtsam::OptionalMatrixType on_soft_iron,
                              gtsam::OptionalMatrixType on_hard_iron) const override {
    BlockJacobians jacobians;
    const gtsam::Vector residual = block_error(block_, pose.rotation().matrix(), Vector6(soft_iron), hard_iron,
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
