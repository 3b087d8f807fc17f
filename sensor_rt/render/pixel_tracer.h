// Light that reaches single pixels.
#pragma once

#include <vector>

#include "sensor_rt/render/render_plan.h"
#include "sensor_rt/render/sheet_light.h"
#include "sensor_rt/scene/ray_view.h"

namespace sensor_rt {

/// Traces pixels of one camera at a time: all samples of a pixel from the lens to the scene, and from the
/// laser to what they meet. Samples differ in place and in time, each with the poses of its instant.
class PixelTracer {
 public:
  explicit PixelTracer(const RenderPlan& plan);

  /// Makes the scene at the instants of an exposure ready.
  void set(const Scene& scene, const PoseTrack& track);
  void select_camera(std::size_t camera);

  /// Expected electrons per second in a pixel, averaged over its area and the exposure.
  double trace(int column, int row);

  /// Reflectance under even light, seen along the middle of a pixel at mid-exposure; 0 where nothing is in
  /// view.
  double reflectance(int column, int row);

  /// Electrons per second in a pixel from a surface that sends back `irradiance` diffusely.
  double electrons(int column, int row, double irradiance) const;

 private:
  struct PixelRay {
    double x, y;                        ///< direction (x, y, 1) in the camera frame at the pixel's centre
    double dx_du, dx_dv, dy_du, dy_dv;  ///< its change per pixel
  };

  PixelRay pixel_ray(int column, int row) const;
  /// Light sent to the eye from what lane l has met, as irradiance on a white diffuse surface.
  double brightness(const PacketHits& hits, int l, const Lanes3& direction, const Lanes3& from_source,
                    double irradiance) const;
  double sum_packet(std::size_t packet, const Lanes3& direction, const int* valid);

  const RenderPlan& plan_;
  SheetLight sheet_;
  const Scene* scene_ = nullptr;
  RayView shadow_view_;
  std::vector<RayView> camera_views_;
  std::vector<std::size_t> lane_instants_;
  std::vector<double> sample_column_;  ///< padded to whole packets
  std::vector<double> sample_row_;
  struct Surface {
    double reflectance;
    const Reflection* reflection;  ///< null for Lambertian surfaces, whose reflectance says all
  };
  std::vector<Surface> surfaces_;  ///< per shape
  // The selected camera:
  std::size_t number_ = 0;
  const Camera* camera_ = nullptr;
  double axes_[9] = {};  ///< camera x, y, z in the sensor frame
  double eye_[3] = {};
};

}  // namespace sensor_rt
