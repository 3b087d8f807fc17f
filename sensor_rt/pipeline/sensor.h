// Sensor description: optics and the settings of all pipeline stages.
#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "sensor_rt/detector/detector.h"
#include "sensor_rt/imaging/extract.h"
#include "sensor_rt/imaging/triangulate.h"
#include "sensor_rt/optics/sensor_model.h"
#include "sensor_rt/render/render_options.h"

namespace sensor_rt {

/// Content of the JSON description of a sensor.
struct Sensor : SensorModel, RenderOptions {
  DetectorParameters detector;
  std::shared_ptr<const Detector> image_sensor;  ///< with `detector`; keeps its fixed patterns between scans
  ExtractionOptions extraction;
  ImageNoise image_noise;
  TriangulationOptions triangulation;
  bool range_as_printed = false;  ///< the measuring field of a camera is range_trapezoid_as_printed
  bool noise = false;
  bool laser_off_frame = false;  ///< take a background frame (laser off) and subtract it before extraction
  int geometric_rays = 0;        ///< number of laser rays of the geometric engine
};

/// Returns the extractor of a sensor; see Extractor.
Extractor make_extractor(const Sensor& sensor, bool all_peaks);

/// Parses a resolved description (SI units, all keys present). Throws std::invalid_argument that names the
/// key.
Sensor parse_sensor(const std::string& json);

}  // namespace sensor_rt
