// Viewing rays of single pixels.
#pragma once

#include <vector>

#include "sensor_rt/geometry/lanes.h"
#include "sensor_rt/render/render_plan.h"

namespace sensor_rt {

/// Generates the rays through the samples of the pixels of one camera, with their radiometric weights.
class PixelRays {
 public:
  struct PixelRay {
    double x, y;                        ///< direction (x, y, 1) in the camera frame at the pixel's centre
    double dx_du, dx_dv, dy_du, dy_dv;  ///< its change per pixel
  };

  PixelRays(const RenderPlan& plan, std::size_t camera);

  std::size_t camera() const { return number_; }

  PixelRay pixel_ray(int column, int row) const;

  /// Computes the directions (sensor frame, any length) of the `packet`-th sixteen samples of a pixel.
  void through_samples(int column, int row, std::size_t packet, Lanes3& direction) const;

  /// Sets all lanes to the direction from the centre of the lens through the pixel centre.
  void through_centre(int column, int row, Lanes3& direction) const;

  /// Returns the electrons per second in a pixel from a surface that reflects `irradiance` diffusely.
  double electrons(int column, int row, double irradiance) const;

  /// Whether all rays start at the lens centre (no depth of field).
  bool share_viewpoint() const { return !camera_.has_depth_of_field(); }
  /// Returns the ray origins of the `packet`-th sixteen samples.
  const Lanes3& viewpoints(std::size_t packet) const { return samples_.viewpoints[packet]; }

 private:
  std::size_t number_;
  const Camera& camera_;
  const CameraSamples& samples_;
  double electrons_per_irradiance_;
  double axes_[9];        ///< camera x, y, z in the sensor frame
  double focus_[3] = {};  ///< inverse depth in focus: constant, per x, per y
};

}  // namespace sensor_rt
