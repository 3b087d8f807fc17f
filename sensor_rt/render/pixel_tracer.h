// Direct light in single pixels.
#pragma once

#include <vector>

#include "sensor_rt/render/exposure_views.h"
#include "sensor_rt/render/pixel_rays.h"
#include "sensor_rt/render/row_views.h"
#include "sensor_rt/render/sheet_light.h"
#include "sensor_rt/render/speckle.h"
#include "sensor_rt/tracing/lamps.h"

namespace sensor_rt {

/// Lamp light and surface at the centre of a pixel.
struct LampView {
  double light = 0.0;       ///< electrons per second
  std::int32_t shape = -1;  ///< -1: no surface
  Eigen::Vector3d normal = Eigen::Vector3d::Zero();
};

/// Traces pixels of one camera at a time: rays from the lens samples to the scene, and shadow rays from the
/// laser. Samples differ in position and time, each with the poses of its instant.
class PixelTracer {
 public:
  explicit PixelTracer(const RenderPlan& plan);

  /// Prepares the instants of an exposure. `views` must outlive its use, and so must `rows`, which is not
  /// null when every row has its own views.
  void set(const ExposureViews& views, RowViews* rows);
  void select_camera(std::size_t camera) {
    rays_.select_camera(camera);
    speckle_.select_camera(camera);
  }

  /// Returns the expected electrons per second in a pixel, averaged over its area and the exposure. `patch`:
  /// the surface that fills the pixel, if known.
  double trace(int column, int row, const Patch& patch = {});

  /// Returns the electrons per second in a pixel beyond those that it would have if the first face of the
  /// unshadowed patch filled it. Little depends on the samples where the faces form small angles.
  double beyond_first_face(int column, int row, const Patch& patch);

  /// Returns the directional albedo seen through the centre of a pixel at mid-exposure; 0 without a hit.
  double reflectance(int column, int row);

  /// Returns the lamp light seen through the centre of a pixel at mid-exposure.
  LampView lamp_light(int column, int row);

  /// Returns the index of the shape seen through the centre of a pixel at mid-exposure; -1: none.
  std::int32_t shape_at(int column, int row);

  /// Returns the electrons per second in a pixel from a surface that reflects `irradiance` diffusely.
  double electrons(int column, int row, double irradiance) const {
    return rays_.electrons(column, row, irradiance);
  }

 private:
  void enter(int row) {
    if (rows_ != nullptr) use(rows_->of_row(rays_.camera(), row));
  }
  void use(const ExposureViews& views);
  /// Returns the light reflected to the viewpoint at the hit of lane l, as the equivalent irradiance on a
  /// white diffuse surface.
  double brightness(const PacketHits& hits, int l, const Lanes3& direction, const Lanes3& from_source,
                    double irradiance) const;
  /// Computes the irradiance at the hits of a packet, without shadows.
  void light(std::size_t packet, const Lanes3& direction, const PacketHits& hits, Lanes3& from_source,
             double* irradiance, int* lit) const;
  double sum_reflected(const PacketHits& hits, const Lanes3& direction, const int* valid,
                       const Lanes3& from_source, const double* irradiance, const int* lit) const;
  double sum_packet(int column, int row, std::size_t packet, const Lanes3& direction, const int* valid,
                    const Patch& patch);
  /// Traces the ray through the pixel centre; returns its lane.
  int trace_middle(int column, int row, Lanes3& direction, PacketHits& hits);

  struct Surface {
    double reflectance;
    const Bsdf* brdf;  ///< null for Lambertian surfaces
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
