// Magnetometer residuals with soft iron, hard iron, mounting and the world's field: Eigen only.
//
//   sample   r = A S^T R^T f + h - m                      (factors/pose.py)
//   block    r = (A S^T S0 G y + share h - m) / sigma      (factors/keyframe_field.py)
//
// R body->world, S sensor->body, A symmetric from its upper triangle row by row. Jacobians on rotations are with
// respect to R Exp(phi), as GTSAM's. magnetometer_gtsam.hpp makes GTSAM factors of these functions.
#pragma once

#include <Eigen/Core>
#include <stdexcept>

namespace magyc {

using Matrix3 = Eigen::Matrix3d;
using Vector3 = Eigen::Vector3d;
using Vector6 = Eigen::Matrix<double, 6, 1>;
using Matrix36 = Eigen::Matrix<double, 3, 6>;

inline Matrix3 skew(const Vector3& v) {
  return (Matrix3() << 0, -v.z(), v.y(), v.z(), 0, -v.x(), -v.y(), v.x(), 0).finished();
}

/// Return the symmetric matrix of an upper triangle, row by row.
inline Matrix3 unvech(const Vector6& a) {
  return (Matrix3() << a(0), a(1), a(2), a(1), a(3), a(4), a(2), a(4), a(5)).finished();
}

/// Return d(A u)/d vech(A).
inline Matrix36 on_vech(const Vector3& u) {
  Matrix36 d = Matrix36::Zero();
  d.row(0) << u.x(), u.y(), u.z(), 0, 0, 0;
  d.row(1) << 0, u.x(), 0, u.y(), u.z(), 0;
  d.row(2) << 0, 0, u.x(), 0, u.y(), u.z();
  return d;
}

/// Jacobians of one sample, 3 rows each.
struct SampleJacobians {
  Matrix3 rotation, hard_iron, field, mounting;
  Matrix36 soft_iron;
};

/// Return the residual of one sample; field, hard iron and measurement in one unit.
inline Vector3 sample_error(const Matrix3& rotation, const Vector6& soft_iron, const Vector3& hard_iron,
                            const Vector3& field, const Matrix3& mounting, const Vector3& measured,
                            SampleJacobians* jacobians = nullptr) {
  const Matrix3 iron = unvech(soft_iron);
  const Vector3 in_body = rotation.transpose() * field;
  const Vector3 seen = mounting.transpose() * in_body;
  if (jacobians) {
    const Matrix3 to_sensor = iron * mounting.transpose();
    jacobians->rotation = to_sensor * skew(in_body);
    jacobians->soft_iron = on_vech(seen);
    jacobians->hard_iron.setIdentity();
    jacobians->field = to_sensor * rotation.transpose();
    jacobians->mounting = iron * skew(seen);
  }
  return iron * seen + hard_iron - measured;
}

/// Samples around a keyframe, as in `KeyframeField`: k samples or their compressed rows.
struct Block {
  Eigen::MatrixXd design;      ///< (3k, 12), rows of sample 0 first; columns v, then delta_j v
  Eigen::VectorXd share;       ///< (k)
  Eigen::VectorXd field;       ///< (3k), in the unit of the hard iron
  Vector3 bias;                ///< rad/s in the body frame, at which the gyroscope was integrated
  Matrix3 mounting;            ///< S0, the mounting contained in the design
  double sigma;                ///< in the unit of the hard iron
};

/// Jacobians of a block, 3k rows each.
struct BlockJacobians {
  Eigen::MatrixXd rotation, soft_iron, hard_iron, gyro_bias, field, mounting;
};

/// Return the whitened residual of a block; the gyroscope's bias is in the body frame.
inline Eigen::VectorXd block_error(const Block& block, const Matrix3& rotation, const Vector6& soft_iron,
                                   const Vector3& hard_iron, const Vector3& gyro_bias, const Vector3& field,
                                   const Matrix3& mounting, BlockJacobians* jacobians = nullptr) {
  const Eigen::Index k = block.share.size();
  if (block.design.rows() != 3 * k || block.design.cols() != 12 || block.field.size() != 3 * k || !(block.sigma > 0))
    throw std::invalid_argument("magyc::Block: design must be (3k, 12), field (3k), share (k), sigma above 0");
  const Vector3 in_body = rotation.transpose() * field, moved = gyro_bias - block.bias;
  Eigen::Matrix<double, 12, 1> y;
  y << in_body, moved.x() * in_body, moved.y() * in_body, moved.z() * in_body;
  const Matrix3 turn = mounting.transpose() * block.mounting, iron = unvech(soft_iron) * turn;
  Eigen::VectorXd residual(3 * k);
  if (jacobians) {
    for (auto* each : {&jacobians->rotation, &jacobians->hard_iron, &jacobians->gyro_bias, &jacobians->field,
                       &jacobians->mounting})
      each->resize(3 * k, 3);
    jacobians->soft_iron.resize(3 * k, 6);
  }
  for (Eigen::Index s = 0; s < k; ++s) {
    const auto g = block.design.middleRows<3>(3 * s);
    const Vector3 turned = turn * (g * y);
    residual.segment<3>(3 * s) =
        (iron * (g * y) + block.share(s) * hard_iron - block.field.segment<3>(3 * s)) / block.sigma;
    if (!jacobians) continue;
    Matrix3 on_body = g.leftCols<3>();
    Matrix3 on_bias;
    for (int j = 0; j < 3; ++j) {
      on_body += moved(j) * g.middleCols<3>(3 * (j + 1));
      on_bias.col(j) = g.middleCols<3>(3 * (j + 1)) * in_body;
    }
    const Matrix3 scaled = iron / block.sigma;
    jacobians->rotation.middleRows<3>(3 * s) = scaled * on_body * skew(in_body);
    jacobians->soft_iron.middleRows<3>(3 * s) = on_vech(turned) / block.sigma;
    jacobians->hard_iron.middleRows<3>(3 * s) = block.share(s) / block.sigma * Matrix3::Identity();
    jacobians->gyro_bias.middleRows<3>(3 * s) = scaled * on_bias;
    jacobians->field.middleRows<3>(3 * s) = scaled * on_body * rotation.transpose();
    jacobians->mounting.middleRows<3>(3 * s) = unvech(soft_iron) * skew(turned) / block.sigma;
  }
  return residual;
}

}  // namespace magyc
