// A sensor ready to work: its optics and the settings of every station behind them.
#pragma once

#include <cstdint>
#include <string>

#include "sensor_rt/detector/detector.h"
#include "sensor_rt/imaging/extract.h"
#include "sensor_rt/imaging/triangulate.h"
#include "sensor_rt/optics/sensor_model.h"

namespace sensor_rt {

/// Everything that the JSON description of a sensor says.
struct Sensor : SensorModel {
  DetectorParameters detector;
  ExtractionOptions extraction;
  ImageNoise image_noise;
  TriangulationOptions triangulation;
  bool noise = false;
  std::uint64_t seed = 0;
  int samples_per_pixel = 0;
  int rays_across_fan = 0;        ///< laser rays that mark the pixels to trace
  bool ground_truth = false;      ///< path tracing of the whole image
  int bounces = 0;                ///< reflections between surfaces
  int photons = 0;                ///< that follow them from the laser
  double speckle_contrast = 0.0;  ///< of fully resolved grains
  bool laser_off_frame = false;   ///< a second image without the laser is taken away before extraction
  double row_readout = 0.0;       ///< s from row to row of a rolling shutter; 0: global
  int geometric_rays = 0;         ///< laser rays of the geometric mode
};

/// See Extractor.
Extractor make_extractor(const Sensor& sensor, bool all_peaks);

/// Parses a resolved description (SI units, all keys present). Throws std::invalid_argument naming the key at
/// fault.
Sensor parse_sensor(const std::string& json);

}  // namespace sensor_rt
