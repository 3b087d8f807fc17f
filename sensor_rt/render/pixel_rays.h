// The rays of sight of single pixels.
#pragma once

#include <vector>

#include "sensor_rt/geometry/lanes.h"
#include "sensor_rt/render/render_plan.h"

namespace sensor_rt {

/// Rays through the samples of a pixel, and what their light is worth.
class PixelRays {
 public:
  explicit PixelRays(const RenderPlan& plan);

  void select_camera(std::size_t camera);
  std::size_t camera() const { return number_; }

  /// Directions (sensor frame, any length) of the `packet`-th sixteen samples of a pixel.
  void through_samples(int column, int row, std::size_t packet, Lanes3& direction) const;

  /// All lanes along the middle of the pixel, from the eyes of the first sixteen samples.
  void through_middle(int column, int row, Lanes3& direction) const;

  /// Lanes along corners of pixels: to the left of the given columns and above the given rows.
  void through_corners(const int* columns, const int* rows, Lanes3& direction) const;

  /// Electrons per second in a pixel from a surface that sends back `irradiance` diffusely.
  double electrons(int column, int row, double irradiance) const;

  /// Whether all rays start in one point, the middle of the lens.
  bool share_eye() const { return !camera_->has_depth_of_field(); }
  const double* eye() const { return eye_; }
  /// Where the rays of the `packet`-th sixteen samples start.
  const Lanes3& eyes(std::size_t packet) const { return eyes_[packet]; }

 private:
  struct PixelRay {
    double x, y;                        ///< direction (x, y, 1) in the camera frame at the pixel's centre
    double dx_du, dx_dv, dy_du, dy_dv;  ///< its change per pixel
  };

  PixelRay pixel_ray(int column, int row) const;

  const RenderPlan& plan_;
  /// What the samples of a camera's pixels have in common, padded to whole packets.
  struct Samples {
    std::vector<double> column;  ///< px from the pixel's centre
    std::vector<double> row;
    std::vector<double> lens_x;  ///< m from the middle of the lens, in the camera frame
    std::vector<double> lens_y;
  };

  void direct(const PixelRay& ray, const double* du, const double* dv, std::size_t packet,
              Lanes3& direction) const;

  std::vector<Samples> samples_;  ///< per camera
  std::vector<double> nowhere_;   ///< sixteen zeros
  // The selected camera:
  std::size_t number_ = 0;
  const Camera* camera_ = nullptr;
  double axes_[9] = {};  ///< camera x, y, z in the sensor frame
  double eye_[3] = {};
  double focus_[3] = {};  ///< sharp inverse depth: constant, per x, per y
  std::vector<Lanes3> eyes_;
};

}  // namespace sensor_rt
