// Lamp light and surfaces at the centres of pixels.
#pragma once

#include "sensor_rt/render/exposure_views.h"
#include "sensor_rt/render/lamps/pixel_rays.h"
#include "sensor_rt/render/row_views.h"
#include "sensor_rt/tracing/lamps.h"

namespace sensor_rt {

/// Lamp light and surface at the centre of a pixel.
struct LampView {
  double light = 0.0;       ///< electrons per second
  std::int32_t shape = -1;  ///< -1: no surface
  Eigen::Vector3d normal = Eigen::Vector3d::Zero();
};

/// Rays from the centre of the lens of one camera through the centres of pixels at mid-exposure, for light
/// that varies slowly over the image. Without state.
class CentreTracer {
 public:
  /// All must outlive it; `rows` is not null when every row has its own views.
  CentreTracer(const RenderPlan& plan, const ExposureViews& views, RowViews* rows, std::size_t camera);

  /// Returns the directional albedo; 0 without a hit.
  double reflectance(int column, int row) const;

  LampView lamp_light(int column, int row) const;

  /// Returns the index of the shape; -1: none.
  std::int32_t shape_at(int column, int row) const;

  /// Returns the electrons per second in a pixel from a surface that reflects `irradiance` diffusely.
  double electrons(int column, int row, double irradiance) const {
    return rays_.electrons(column, row, irradiance);
  }

 private:
  /// A ray and its hit, in lane 0.
  struct Centre {
    const ExposureViews& views;
    Lanes3 direction;
    PacketHits hits;
  };

  Centre trace(int column, int row) const;

  const RenderPlan& plan_;
  const ExposureViews& views_;
  RowViews* rows_;
  PixelRays rays_;
};

}  // namespace sensor_rt
