// Processing of batches of exposures in parallel.
#pragma once

#include <cstdint>
#include <vector>

#include "sensor_rt/geometry/large_vector.h"
#include "sensor_rt/pipeline/sensor.h"
#include "sensor_rt/pipeline/stages.h"
#include "sensor_rt/scene/pose_track.h"
#include "sensor_rt/scene/scene.h"

namespace sensor_rt {

/// kRayTraced renders images and extracts the stripe; kGeometric uses the hit points of the laser rays with
/// simulated image noise.
enum class Engine { kRayTraced, kGeometric };

struct ScanOptions {
  Engine engine = Engine::kRayTraced;
  unsigned threads = 0;      ///< 0: one per hardware thread
  bool keep_images = false;  ///< requires cameras of equal size
  /// Also returns the points of peaks that are rejected by their flags; ray-traced engine only.
  bool keep_rejected = false;
};

struct ScanResult {
  Profiles profiles;                  ///< in the order of the exposures
  LargeVector<std::uint16_t> images;  ///< (exposure, camera, row, column) when kept
  /// Background frames (laser off), if the sensor takes them and images are kept.
  LargeVector<std::uint16_t> background;
  StageSeconds seconds{};  ///< per stage, summed over the threads
};

/// Throws std::invalid_argument that names the key of the sensor that the engine does not support.
void check_engine(const Sensor& sensor, Engine engine);

/// Simulates a scan. `as_built` is the true sensor, which generates the images; `sensor` is the nominal
/// sensor, which is used to evaluate them. Throws std::invalid_argument when the exposures do not match the
/// scene, the sensors differ in the number or size of their cameras, or the engine does not support an
/// option.
ScanResult scan(const Scene& scene, const Sensor& as_built, const Sensor& sensor, const Exposures& exposures,
                const ScanOptions& options);

/// Renders the images of all exposures and cameras: (exposure, camera, row, column). Requires cameras of
/// equal size. Background frames (laser off) directly follow those with the laser on.
LargeVector<std::uint16_t> render_images(const Scene& scene, const Sensor& sensor, const Exposures& exposures,
                                         bool laser_on, unsigned threads);

/// Returns the expected electrons without noise, in the layout of render_images.
std::vector<float> expected_electrons(const Scene& scene, const Sensor& sensor, const Exposures& exposures,
                                      unsigned threads);

}  // namespace sensor_rt
