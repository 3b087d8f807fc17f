// Direct light in single pixels.
#pragma once

#include <vector>

#include "sensor_rt/render/emitter/sheet_light.h"
#include "sensor_rt/render/emitter/speckle.h"
#include "sensor_rt/render/exposure_views.h"
#include "sensor_rt/render/integrator/pixel_rays.h"
#include "sensor_rt/render/row_views.h"
#include "sensor_rt/tracing/lamps.h"

namespace sensor_rt {

/// Lamp light and surface at the centre of a pixel.
struct LampView {
  double light = 0.0;       ///< electrons per second
  std::int32_t shape = -1;  ///< -1: no surface
  Eigen::Vector3d normal = Eigen::Vector3d::Zero();
};

/// Direct light in the pixels of one camera: rays from the lens samples to the scene, and shadow rays from
/// the laser. Samples differ in position and time, each with the poses of its instant. Without state.
class PixelTracer {
 public:
  /// All must outlive it; `rows` is not null when every row has its own views.
  PixelTracer(const RenderPlan& plan, const ExposureViews& views, RowViews* rows, std::size_t camera);

  /// Returns the expected electrons per second in a pixel, averaged over its area and the exposure. `patch`:
  /// the surface that fills the pixel, if known.
  double trace(int column, int row, const Patch& patch = {}) const;

  /// Returns the electrons per second in a pixel beyond those that it would have if the first face of the
  /// unshadowed patch filled it. Little depends on the samples where the faces form small angles.
  double beyond_first_face(int column, int row, const Patch& patch) const;

  /// Returns the directional albedo seen through the centre of a pixel at mid-exposure; 0 without a hit.
  double reflectance(int column, int row) const;

  /// Returns the lamp light seen through the centre of a pixel at mid-exposure.
  LampView lamp_light(int column, int row) const;

  /// Returns the index of the shape seen through the centre of a pixel at mid-exposure; -1: none.
  std::int32_t shape_at(int column, int row) const;

  /// Returns the electrons per second in a pixel from a surface that reflects `irradiance` diffusely.
  double electrons(int column, int row, double irradiance) const {
    return rays_.electrons(column, row, irradiance);
  }

 private:
  /// Ray through the centres of the lens and a pixel at mid-exposure, and its hit, in lane 0.
  struct Middle {
    const ExposureViews& views;
    Lanes3 direction;
    PacketHits hits;
  };

  const ExposureViews& views_of(int row) const {
    return rows_ != nullptr ? rows_->of_row(rays_.camera(), row) : views_;
  }
  /// Returns the light reflected to the viewpoint at the hit of lane l, as the equivalent irradiance on a
  /// white diffuse surface.
  double brightness(const PacketHits& hits, int l, const Lanes3& direction, const Lanes3& from_source,
                    double irradiance) const;
  /// Computes the irradiance at the hits of a packet, without shadows.
  void light(std::size_t packet, const Lanes3& direction, const PacketHits& hits, Lanes3& from_source,
             double* irradiance, int* lit) const;
  double sum_reflected(const PacketHits& hits, const Lanes3& direction, const int* valid,
                       const Lanes3& from_source, const double* irradiance, const int* lit) const;
  double sum_packet(const ExposureViews& views, int column, int row, std::size_t packet,
                    const Lanes3& direction, const int* valid, const Patch& patch) const;
  Middle trace_middle(int column, int row) const;

  struct Surface {
    double reflectance;
    const Bsdf* brdf;  ///< null for Lambertian surfaces
  };

  const RenderPlan& plan_;
  const ExposureViews& views_;
  RowViews* rows_;
  PixelRays rays_;
  SheetLight sheet_;
  Speckle speckle_;
  std::vector<Surface> surfaces_;  ///< per shape
};

}  // namespace sensor_rt
