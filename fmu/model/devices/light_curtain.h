// Light curtain: parallel beams between two posts.
#pragma once

#include "fmu/model/devices/sensor_mount.h"
#include "fmu/model/fields.h"

namespace robotcell {

/// The first beam runs along z from the origin, the others beside it along x.
struct LightCurtain {
  static constexpr const char* kKey = "light_curtains";
  static constexpr const char* kVariables = "light_curtain";
  static constexpr const char* kName = "light curtain";

  struct Reading {
    bool interrupted = false;
    std::int32_t beams = 0;

    template <class Visitor>
    static void declare(Visitor& visit, Reading& reading) {
      visit(
          reading,
          field(
              reading.interrupted,
              {"interrupted", kNone,
               "True if any beam of {} was interrupted at its last reading; false before the first reading"}),
          field(reading.beams,
                bounded({"beams", kNone, "Number of beams of {} that were interrupted at its last reading"},
                        0)));
    }
  };

  LightCurtain(const JsonReader& json, const SensorContext& context);
  Reading read(const SensorView& view) const;

  SensorMount mount;
  double width = 0;         // m, between the posts
  double beam_spacing = 0;  // m
  int beams = 0;
};

}  // namespace robotcell
