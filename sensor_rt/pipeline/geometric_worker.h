// Geometric engine: poses to points without images.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "sensor_rt/fan/fan_caster.h"
#include "sensor_rt/imaging/triangulate.h"
#include "sensor_rt/pipeline/sensor.h"
#include "sensor_rt/pipeline/stages.h"
#include "sensor_rt/pipeline/stripe_response.h"

namespace sensor_rt {

/// Uses the hit points of laser rays as measured points. With the noise of the sensor `as_built`, their rows
/// get random errors with the standard deviation that the extraction of `sensor` has for stripes of this
/// height and width, stripes that it would not detect are discarded, and points are triangulated from the
/// rows.
class GeometricWorker {
 public:
  /// Both sensors must outlive the worker. `lamps`: the scene contains lamps.
  GeometricWorker(const Sensor& as_built, const Sensor& sensor, bool lamps);

  /// Computes the points of an exposure into `out`, which must be empty.
  void run(const Scene& scene, const Exposures& exposures, std::size_t exposure, Profiles& out);

  StageSeconds& seconds() { return seconds_; }

 private:
  /// Measured values of each of points_.
  struct Measured {
    std::vector<double> row;
    std::vector<float> sigma;  ///< of the row, as stated by the extraction, px
    std::vector<float> intensity;
    std::vector<std::uint32_t> flags;
  };

  void take_exact(Profiles& out);
  /// Adds the image noise to the rows and discards points that images would not show.
  void measure(std::int64_t frame);
  /// Measures `count` of sixteen points of one camera from `first` on.
  void measure_lanes(std::int64_t frame, std::size_t first, std::size_t count);
  /// Discards the ends of runs of neighbouring rays, and short runs, as the extraction does.
  void trim_runs();
  void triangulate(Profiles& out);
  void fuse_points(Profiles& out);

  const Sensor& as_built_;
  const Sensor& sensor_;
  bool exact_;  ///< the points need no triangulation: no noise, and both sensors agree
  FanCaster caster_;
  FanPoints points_;
  Measured measured_;
  std::vector<std::size_t> kept_;  ///< of points_
  std::vector<Triangulator> triangulators_;
  // Per camera; identical unless the sensor as built has other noise.
  std::vector<std::shared_ptr<const StripeResponse>> stated_;
  std::vector<std::shared_ptr<const StripeResponse>> true_;
  // Of the kept points, for fusion:
  std::vector<double> column_;
  std::vector<std::int32_t> ray_;
  StageSeconds seconds_{};
};

}  // namespace sensor_rt
