// Reads cases from standard input, writes residuals and Jacobians row by row (tests/test_cpp_header.py).
#include <iomanip>
#include <iostream>
#include <string>

#include "magnetometer.hpp"

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
      SampleJacobians j;
      write(sample_error(rotation, soft_iron, hard_iron, field, mounting, measured, &j));
      write(j.rotation), write(j.soft_iron), write(j.hard_iron), write(j.field), write(j.mounting);
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
      BlockJacobians j;
      write(block_error(block, rotation, soft_iron, hard_iron, bias, field, mounting, &j));
      write(j.rotation), write(j.soft_iron), write(j.hard_iron), write(j.gyro_bias), write(j.field), write(j.mounting);
    }
    std::cout << '\n';
  }
}
