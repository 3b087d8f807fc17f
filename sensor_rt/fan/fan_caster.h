// Geometric mode: intersections of the laser rays, their visibility in the cameras, and the resulting stripe
// images.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <vector>

#include "sensor_rt/fan/stripe_optics.h"
#include "sensor_rt/geometry/band.h"
#include "sensor_rt/geometry/large_vector.h"
#include "sensor_rt/optics/camera.h"
#include "sensor_rt/optics/laser_emitter.h"
#include "sensor_rt/optics/projector.h"
#include "sensor_rt/tracing/lamps.h"
#include "sensor_rt/tracing/ray_view.h"

namespace sensor_rt {

/// Points of a profile as seen by the cameras, as a structure of arrays.
struct FanPoints {
  LargeVector<Eigen::Vector3d> point;  ///< sensor frame, m
  LargeVector<double> column;          ///< px
  LargeVector<double> row;             ///< px
  /// Reflectance times cosine of incidence times the relative laser power.
  LargeVector<float> brightness;
  LargeVector<std::int32_t> camera;
  LargeVector<std::int32_t> ray;
  // Stripe parameters, if requested:
  /// Peak height above the background before integration over pixels, electrons.
  LargeVector<float> height_e;
  LargeVector<float> width;         ///< standard deviation along the column, px
  LargeVector<float> background_e;  ///< ambient and lamp light, electrons per pixel

  std::size_t size() const { return point.size(); }
  void resize(std::size_t count);
};

/// Further parameters of the stripe images.
struct StripeSettings {
  double quantum_efficiency = 0.0;
  double ambient_irradiance = 0.0;  ///< on every surface, W/m²
  Band band_pass;
};

/// Parameters of the sensor that the geometric mode uses.
struct FanGeometry {
  std::vector<Camera> cameras;
  LaserSheet laser;
  double near = 0.0;  ///< points with z outside [near, far] in the sheet frame are discarded
  double far = 0.0;
  int rays = 0;
  std::optional<StripeSettings> stripes;  ///< compute the stripe parameters as well
};

/// Casts `rays` laser rays at equal angles across the fan, at mid-exposure, and keeps each closest hit for
/// every camera that sees the lit side of the surface unoccluded and within its image. Ideal mirrors are
/// invisible. Keeps scratch memory: use one per thread.
class FanCaster {
 public:
  explicit FanCaster(const FanGeometry& geometry);

  /// Computes the points of one profile, sorted by camera and column.
  void cast(const Scene& scene, const Exposures& exposures, std::size_t exposure, FanPoints& points);

 private:
  /// Hit points of sixteen rays; used is 0 for rays without a hit.
  struct HitPoints {
    Lanes3 point;
    Lanes3 in_sensor;  ///< the same point in the sensor frame
    Lanes3 normal;     ///< towards the light
    alignas(64) double brightness[kLanes];
    alignas(64) double used[kLanes];
    HitLight light;
  };

  /// Stripes of a packet.
  struct Stripes {
    float height_e[kLanes];
    float width[kLanes];
    float background_e[kLanes];
  };

  /// Sixteen hit points as seen by one camera.
  struct alignas(64) View {
    Lanes3 direction;
    double column[kLanes];
    double row[kLanes];
    int unoccluded[kLanes];  ///< -1 where the camera sees the point, else 0
  };

  void find_hits(const SceneQuery& query);
  /// Computes the laser light on the hits of the p-th packet, and their motion.
  void light(std::size_t p, const double* cosine);
  void find_motion(const Scene& scene);
  /// Projects the hit points of the p-th packet to a camera and finds those that it sees.
  void project(std::size_t camera, std::size_t p, View& view) const;
  /// Writes the points that a camera sees to `points` from `first` on; returns their number.
  std::size_t append_visible(const SceneQuery& query, std::size_t camera, std::size_t first,
                             FanPoints& points) const;
  /// Computes the stripe parameters of the p-th packet in a camera.
  void measure_stripes(const SceneQuery& query, std::size_t camera, std::size_t p, const View& view,
                       Stripes& stripes) const;
  /// Returns where a ray of the p-th packet hits, as a camera sees it.
  SurfacePoint surface_point(const SceneQuery& query, std::size_t p, int lane, const View& view) const;
  /// Returns the lamp light on the p-th packet, as irradiance on a white diffuse surface.
  double lamp_light(const SceneQuery& query, std::size_t p, const View& view) const;

  FanGeometry geometry_;
  LaserEmitter laser_;
  std::vector<Projector> projectors_;
  std::vector<Lanes3> directions_;  ///< of the rays, in packets of sixteen
  std::vector<PacketHits> hits_;
  std::vector<double> relative_power_;  ///< per ray
  std::vector<StripeOptics> optics_;    ///< per camera
  std::vector<double> instants_;      ///< instants of the exposure: its middle, then start and end if needed
  std::vector<Displacement> motion_;  ///< per shape, during the exposure; empty: none
  double duration_ = 0.0;             ///< s
  std::vector<HalfSpace> laser_region_;
  std::vector<std::vector<HalfSpace>> camera_regions_;
  PoseTrack track_;
  RayView laser_view_;
  RayView camera_view_;
  std::vector<HitPoints> hit_points_;
};

}  // namespace sensor_rt
