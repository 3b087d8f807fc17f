// Options of the renderer that the description of a sensor sets.
#pragma once

#include <cstdint>

namespace sensor_rt {

struct RenderOptions {
  int samples_per_pixel = 0;
  int rays_across_fan = 0;        ///< laser rays that sample the sheet along the fan
  bool ground_truth = false;      ///< path tracing of every pixel
  int bounces = 0;                ///< largest number of reflections between surfaces on a light path
  int photons = 0;                ///< photons traced from the laser for that light
  std::uint64_t seed = 0;         ///< random seed of all paths and of speckle
  double speckle_contrast = 0.0;  ///< contrast of fully resolved speckle; 0: no speckle
  double row_readout = 0.0;       ///< s from one row's exposure to the next; 0: global shutter
};

}  // namespace sensor_rt
