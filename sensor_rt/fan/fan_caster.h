// Geometric mode: where the laser's rays land and which cameras see it, without images.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "sensor_rt/geometry/large_vector.h"
#include "sensor_rt/optics/camera.h"
#include "sensor_rt/optics/laser_sheet.h"
#include "sensor_rt/optics/projector.h"
#include "sensor_rt/tracing/ray_view.h"
#include "sensor_rt/tracing/sight_lines.h"

namespace sensor_rt {

/// Points of a profile as its cameras see them, as a structure of arrays.
struct FanPoints {
  LargeVector<Eigen::Vector3d> point;  ///< sensor frame, m
  LargeVector<std::int32_t> column;    ///< px, the nearest one
  LargeVector<double> row;             ///< px
  /// Reflectance times cosine of incidence, and the laser's power there over the mean.
  LargeVector<float> brightness;
  LargeVector<std::int32_t> camera;

  std::size_t size() const { return point.size(); }
  void resize(std::size_t count);
};

/// What of the sensor the geometric mode needs.
struct FanGeometry {
  std::vector<Camera> cameras;
  LaserSheet laser;
  double near = 0.0;  ///< points with z outside [near, far] of the sheet are left out
  double far = 0.0;
  int rays = 0;
};

/// Casts `rays` laser rays at equal angles across the fan, at mid-exposure, and keeps each closest hit for
/// every camera that has a free view of the lit side of the surface within its image. Keeps scratch memory:
/// one per thread.
class FanCaster {
 public:
  explicit FanCaster(const FanGeometry& geometry);

  /// Points of one profile, camera by camera in ascending columns.
  void cast(const Scene& scene, const Exposures& exposures, std::size_t exposure, FanPoints& points);

 private:
  /// Landing points of sixteen rays; used is 0 for those that are lost.
  struct Landing {
    Lanes3 point;
    Lanes3 in_sensor;  ///< the same point in the sensor frame
    Lanes3 normal;     ///< towards the light
    alignas(64) double brightness[kLanes];
    alignas(64) double used[kLanes];
  };

  /// Sixteen landing points seen by one camera.
  struct alignas(64) View {
    Lanes3 direction;
    double column[kLanes];
    double row[kLanes];
    int open[kLanes];  ///< -1 where the point is seen, as far as is known; else 0
    Window window;     ///< holds those points
  };

  void land(const Scene& scene);
  /// What a camera could see if nothing hid anything, and the windows that hold it.
  void look(std::size_t camera);
  /// Writes what a camera sees at `points`[first] and after; returns how many.
  std::size_t see(std::size_t camera, std::size_t first, FanPoints& points);

  FanGeometry geometry_;
  std::vector<Projector> projectors_;
  Fan fan_;
  FanSearch search_;
  std::vector<PacketHits> hits_;
  std::vector<double> relative_power_;  ///< per ray
  std::vector<HalfSpace> laser_region_;
  std::vector<std::vector<HalfSpace>> camera_regions_;
  PoseTrack track_;
  RayView laser_view_;
  RayView camera_view_;
  Windows bundles_;
  SightLines sight_lines_;
  std::vector<Landing> landings_;
  std::vector<View> views_;
};

}  // namespace sensor_rt
