// Light that reaches single pixels.
#pragma once

#include <vector>

#include "sensor_rt/render/exposure_views.h"
#include "sensor_rt/render/lamps.h"
#include "sensor_rt/render/pixel_rays.h"
#include "sensor_rt/render/row_views.h"
#include "sensor_rt/render/sheet_light.h"
#include "sensor_rt/render/speckle.h"

namespace sensor_rt {

/// What the middle of a pixel shows by the light of lamps.
struct LampView {
  double light = 0.0;       ///< electrons per second
  std::int32_t shape = -1;  ///< -1: nothing is there
  Eigen::Vector3d normal = Eigen::Vector3d::Zero();
};

/// Traces pixels of one camera at a time: all samples of a pixel from the lens to the scene, and from the
/// laser to what they meet. Samples differ in place and in time, each with the poses of its instant.
class PixelTracer {
 public:
  explicit PixelTracer(const RenderPlan& plan);

  /// Makes the scene at the instants of an exposure ready; `views` must stay, and `rows`, which is not null
  /// when every row has views of its own.
  void set(const ExposureViews& views, RowViews* rows);
  void select_camera(std::size_t camera) {
    rays_.select_camera(camera);
    speckle_.select_camera(camera);
  }

  /// Expected electrons per second in a pixel, averaged over its area and the exposure. `patch`: what
  /// fills the pixel, if that is known.
  double trace(int column, int row, const Patch& patch = {});

  /// Reflectance under even light, seen along the middle of a pixel at mid-exposure; 0 where nothing is in
  /// view.
  double reflectance(int column, int row);

  /// The light of lamps, seen along the middle of a pixel at mid-exposure.
  LampView lamp_light(int column, int row);

  /// Number of the shape seen along the middle of a pixel at mid-exposure; -1: none.
  std::int32_t shape_at(int column, int row);

  /// Electrons per second in a pixel from a surface that sends back `irradiance` diffusely.
  double electrons(int column, int row, double irradiance) const {
    return rays_.electrons(column, row, irradiance);
  }

 private:
  void enter(int row) {
    if (rows_ != nullptr) use(rows_->of_row(rays_.camera(), row));
  }
  void use(const ExposureViews& views);
  /// Light sent to the eye from what lane l has met, as irradiance on a white diffuse surface.
  double brightness(const PacketHits& hits, int l, const Lanes3& direction, const Lanes3& from_source,
                    double irradiance) const;
  double sum_packet(int column, int row, std::size_t packet, const Lanes3& direction, const int* valid,
                    const Patch& patch);
  /// Meets what the middle of a pixel shows; returns the lane that did.
  int look(int column, int row, Lanes3& direction, PacketHits& hits);

  struct Surface {
    double reflectance;
    const Reflection* reflection;  ///< null for Lambertian surfaces, whose reflectance says all
  };

  const RenderPlan& plan_;
  PixelRays rays_;
  SheetLight sheet_;
  std::vector<Lanes3> sources_;  ///< per packet
  Speckle speckle_;
  Lamps lamps_;
  const ExposureViews* views_ = nullptr;
  RowViews* rows_ = nullptr;
  std::vector<Surface> surfaces_;  ///< per shape
};

}  // namespace sensor_rt
