#include "fmu/model/devices/encoder.h"

#include <algorithm>
#include <cmath>

#include "fmu/control/time_units.h"
#include "fmu/model/description/cell_description.h"
#include "fmu/model/description/json_reader.h"
#include "fmu/model/quantization.h"
#include "fmu/model/random.h"

namespace robotcell {

constexpr double kMaxLatency = 0.1;  // s

EncoderDescription parse_encoder(const JsonReader& json) {
  return {json.at("encoder_resolution").number(0, 1), json.at("encoder_noise").number(0, 1),
          std::llround(json.at("encoder_latency").number(0, kMaxLatency) * kMicrosecondsPerSecond)};
}

Encoders::Encoders(const CellDescription& cell, std::int32_t instance_seed)
    : key_(key_of_seeds(cell.seed, instance_seed)) {
  for (std::size_t i = 0; i < cell.joints.size(); ++i) encoders_[i] = cell.joints[i].encoder;
  encoders_[kTableAxis] = cell.table.encoder;
  for (std::size_t i = 0; i < cell.axes.size(); ++i) encoders_[kFirstFurtherAxis + i] = cell.axes[i].encoder;
}

std::array<double, kAxes> Encoders::read(const std::array<double, kAxes>& position,
                                         std::int64_t time_us) const {
  std::array<double, kAxes> measured = position;
  for (std::size_t i = 0; i < kAxes; ++i) {
    const EncoderDescription& encoder = encoders_[i];
    if (encoder.noise > 0) {
      measured[i] += encoder.noise * normal(mixed(mixed(key_ + i) ^ static_cast<std::uint64_t>(time_us)));
    }
    measured[i] = quantized(measured[i], encoder.resolution);
  }
  return measured;
}

std::int64_t Encoders::max_latency_us() const {
  std::int64_t longest = 0;
  for (const EncoderDescription& encoder : encoders_) longest = std::max(longest, encoder.latency_us);
  return longest;
}

}  // namespace robotcell
