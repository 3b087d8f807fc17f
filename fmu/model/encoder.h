// Encoders: resolution, noise and latency. The noise is a function of seed, axis and time alone, so that it
// does not depend on how often or in which order anybody asks.
#pragma once

#include <array>
#include <cstdint>

#include "fmu/model/cell_description.h"
#include "fmu/model/cell_values.h"

namespace robotcell {

class Encoders {
 public:
  /// Two seeds: the description's and the instance's; either changes all noise.
  Encoders(const CellDescription& cell, std::int32_t instance_seed);

  /// What they say at an instant of these positions, which are as old as their latencies.
  std::array<double, kAxes> read(const std::array<double, kAxes>& position, std::int64_t time_us) const;

  std::int64_t latency_us(std::size_t axis) const { return encoders_[axis].latency_us; }
  std::int64_t longest_latency_us() const;

 private:
  std::array<EncoderDescription, kAxes> encoders_;
  std::uint64_t key_;
};

}  // namespace robotcell
