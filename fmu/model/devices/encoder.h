// Encoders: resolution, noise and latency. Noise is a function of seed, axis and time only, so that it does
// not depend on how often or in which order the encoders are read.
#pragma once

#include <array>
#include <cstdint>

#include "fmu/model/axes_state.h"
#include "fmu/model/fields.h"

namespace robotcell {

class JsonReader;
struct CellDescription;

struct EncoderDescription {
  double resolution = 0;  // rad or m; 0: not quantized
  double noise = 0;       // standard deviation, rad or m
  std::int64_t latency_us = 0;
};

/// Reads the keys of an encoder among those of its axis; throws DescriptionError.
EncoderDescription parse_encoder(const JsonReader& json);

constexpr Element kEncoderRateElements[] = {
    {"qd[{i}]", "joint {i}"}, {"table_rate", "the rotary table"}, {"axis_rate.{a}", "the axis {a}"}};

/// Encoder readings of the axes.
struct Measurement {
  std::array<double, kAxes> position{};
  std::array<double, kAxes> rate{};

  template <class Visitor>
  static void declare(Visitor& visit, Measurement& m) {
    visit(m,
          field(m.position,
                with_axes(initially(Initial::kEncoders, {"", kRadian, "Measured angle of {e} (encoder){}"}),
                          kAxisElements)),
          field(m.rate, with_axes({"", kRadianPerSecond, "Measured angular velocity of {e}{}"},
                                  kEncoderRateElements)));
  }
};

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
