#include "sensor_rt/detector/quantile_table.h"

#include <cmath>

namespace sensor_rt {
namespace {

float node_value(std::uint32_t pattern) {
  float value = 0.0f;
  std::memcpy(&value, &pattern, sizeof value);
  return value;
}

}  // namespace

double normal_upper_tail(double p) {
  const double root_two = std::sqrt(2.0);
  const double root_two_pi = std::sqrt(2.0 * std::acos(-1.0));
  double x = 0.0;  // Newton's method on the logarithm of the tail, which is concave: no overshoot
  for (int i = 0; i < 60; ++i) {
    const double tail = 0.5 * std::erfc(x / root_two);
    const double hazard = std::exp(-0.5 * x * x) / (root_two_pi * tail);
    const double step = std::log(tail / p) / hazard;
    x += step;
    if (std::fabs(step) < 1e-14) break;
  }
  return x;
}

QuantileTable::QuantileTable(const Tail& lower, const Tail& upper) {
  const auto fill = [this](std::uint32_t offset, const Tail& tail) {
    const auto quantile = [&tail](std::uint32_t i) {
      return tail(static_cast<double>(node_value((kFirst + i) << kShift)) * 0x1p-32);
    };
    double here = quantile(0);
    for (std::uint32_t i = 0; i + 1 < kNodes; ++i) {
      const double next = quantile(i + 1);
      const double span = static_cast<double>(node_value((kFirst + i + 1) << kShift)) -
                          static_cast<double>(node_value((kFirst + i) << kShift));
      segments_[offset + i] = {static_cast<float>(here), static_cast<float>((next - here) / span)};
      here = next;
    }
    segments_[offset + kNodes - 1] = {static_cast<float>(here), 0.0f};
  };
  fill(0, lower);
  fill(kNodes, upper);
}

const QuantileTable& standard_normal() {
  static const QuantileTable table([](double p) { return -normal_upper_tail(p); }, normal_upper_tail);
  return table;
}

}  // namespace sensor_rt
