// Encoders: resolution, noise and latency. Noise is a function of seed, axis and time only, so that it does
// not depend on how often or in which order the encoders are read.
#pragma once

#include <array>
#include <cstdint>

#include "fmu/model/cell_values.h"
#include "fmu/model/description/cell_description.h"

namespace robotcell {

class Encoders {
 public:
  /// The noise depends on the seed of the description and that of the instance.
  Encoders(const CellDescription& cell, std::int32_t instance_seed);

  /// Readings at an instant; `position` already includes the latency.
  std::array<double, kAxes> read(const std::array<double, kAxes>& position, std::int64_t time_us) const;

  std::int64_t latency_us(std::size_t axis) const { return encoders_[axis].latency_us; }
  std::int64_t max_latency_us() const;

 private:
  std::array<EncoderDescription, kAxes> encoders_;
  std::uint64_t key_;
};

}  // namespace robotcell
