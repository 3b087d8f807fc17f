// Batches of exposures through all stations, many at a time.
#pragma once

#include <cstdint>
#include <vector>

#include "sensor_rt/pipeline/sensor.h"
#include "sensor_rt/pipeline/stations.h"
#include "sensor_rt/scene/pose_track.h"
#include "sensor_rt/scene/scene.h"

namespace sensor_rt {

/// kRayTraced makes images and measures the stripe in them; kGeometric takes the laser's landing points
/// themselves.
enum class Engine { kRayTraced, kGeometric };

struct ScanOptions {
  Engine engine = Engine::kRayTraced;
  unsigned threads = 0;      ///< 0: as many as the machine has
  bool keep_images = false;  ///< needs cameras of one size
};

struct ScanResult {
  Profiles profiles;                  ///< in the order of the exposures
  std::vector<std::uint16_t> images;  ///< (exposure, camera, row, column) when kept
  std::vector<std::uint16_t> unlit;   ///< the same with the laser off, when the sensor takes such images
  StationSeconds seconds{};           ///< per station, summed over the threads
};

/// `as_built` is the sensor as it truly is, which makes the images; `sensor` is what is believed of it, by
/// which they are read. Throws std::invalid_argument when the exposures do not fit the scene, or the two
/// sensors differ in the number or size of their cameras.
ScanResult scan(const Scene& scene, const Sensor& as_built, const Sensor& sensor, const Exposures& exposures,
                const ScanOptions& options);

/// Images of all exposures and cameras: (exposure, camera, row, column). Needs cameras of one size. With the
/// laser off they are taken when those with the laser have ended.
std::vector<std::uint16_t> render_images(const Scene& scene, const Sensor& sensor, const Exposures& exposures,
                                         bool laser_on, unsigned threads);

/// Expected electrons before any noise, laid out like render_images. `whole_image` traces every pixel instead
/// of those that the laser can reach.
std::vector<float> expected_electrons(const Scene& scene, const Sensor& sensor, const Exposures& exposures,
                                      bool whole_image, unsigned threads);

}  // namespace sensor_rt
