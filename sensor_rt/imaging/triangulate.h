// Triangulation: Peaks -> Profiles, points in the sensor frame with their uncertainty.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include <Eigen/Dense>

#include "sensor_rt/geometry/lanes.h"
#include "sensor_rt/geometry/large_vector.h"
#include "sensor_rt/imaging/peaks.h"
#include "sensor_rt/optics/camera.h"
#include "sensor_rt/optics/laser_sheet.h"

namespace sensor_rt {

/// kEq4AsPrinted is the published form, kept for comparison: its Y is too large by sqrt(f² + p_y²) / f.
enum class TriangulationForm { kExact, kEq4AsPrinted };

/// kWeighted: points seen by several cameras are merged, see fuse.h.
enum class Fusion { kNone, kWeighted };

struct TriangulationOptions {
  TriangulationForm form = TriangulationForm::kExact;
  SheetSurface sheet;  ///< that kExact intersects; by default the plane X = 0
  Fusion fusion = Fusion::kNone;
  double agreement_px = 0.0;   ///< largest difference of merged points, in addition to noise
  double near = 0.0;           ///< m: points with sensor Z outside [near, far] are discarded
  double far = 0.0;            ///< m
  bool keep_rejected = false;  ///< true: also triangulate peaks whose flags are in kPeakRejected
};

/// Points of any number of frames, as a structure of arrays. Metres, sensor frame (x = 0 on the nominal laser
/// sheet).
struct Profiles {
  LargeVector<std::int64_t> frame;
  LargeVector<std::int32_t> camera;
  LargeVector<std::int32_t> column;
  LargeVector<double> row;  ///< px, in the camera image
  LargeVector<Eigen::Vector3d> points_in_sensor;
  /// One standard deviation d along the line on which the point is uncertain, m; its covariance is d dᵀ.
  /// Empty when all points are exact.
  LargeVector<Eigen::Vector3f> deviation;
  LargeVector<float> sigma;          ///< m: norm of the deviation
  LargeVector<float> intensity;      ///< amplitude of the peak, DN
  LargeVector<std::uint32_t> flags;  ///< PeakFlag bits

  std::size_t size() const { return points_in_sensor.size(); }
  bool is_exact() const { return deviation.empty(); }
  /// Removes the points and keeps the memory.
  void clear();
  void reserve(std::size_t count);
  /// Appends points; both must be exact, or neither, unless one is empty.
  void append(const Profiles& other);
  void resize(std::size_t count);
  void move(std::size_t from, std::size_t to);
};

/// Returns the point on the laser sheet seen at a pixel. On the plane X = 0 by the closed form (pinhole in
/// the frame of the paper, distortion and sensor tilt removed first), and by the ray form for cameras whose
/// pose deviates from the paper's; on any other sheet by Newton's method along the pixel's ray, which starts
/// on that plane. Not a number where the ray misses the sheet.
Eigen::Vector3d triangulate_exact(const Camera& camera, const SheetSurface& sheet,
                                  const Eigen::Vector2d& pixel);

/// Returns the intersection of the pixel's ray with the sheet X = 0, from the camera pose alone.
Eigen::Vector3d triangulate_ray(const Camera& camera, const Eigen::Vector2d& pixel);

/// Returns the point by Dumitrache & Borangiu, Eq. 4, as printed (without the stray f in the denominator of
/// Z).
Eigen::Vector3d triangulate_eq4_as_printed(const Camera& camera, const Eigen::Vector2d& pixel);

/// Returns the Jacobian d point / d (column, row) of triangulate_exact at its point, m/px.
Eigen::Matrix<double, 3, 2> triangulation_jacobian(const Camera& camera, const SheetSurface& sheet,
                                                   const Eigen::Vector2d& pixel,
                                                   const Eigen::Vector3d& point);

/// Triangulates sixteen pixels of a camera at a time.
class Triangulator {
 public:
  Triangulator(const Camera& camera, TriangulationForm form, const SheetSurface& sheet);

  /// Computes the points, and d point / d row of triangulate_exact, m/px.
  void locate(const double* column, const double* row, Lanes3& point, Lanes3& per_row) const;

  /// Constants of the paper's closed form, for cameras without distortion and sensor tilt.
  struct Constants {
    double side, cx, cy, focal, baseline, height, sine, cosine;
  };

 private:
  Camera camera_;
  TriangulationForm form_;
  SheetSurface sheet_;
  bool simple_;  ///< the closed form applies
  Constants constants_;
};

/// Appends the points of all usable peaks, which are sorted by frame, camera and column. Throws
/// std::invalid_argument when a peak refers to a missing camera.
void triangulate(const Peaks& peaks, const std::vector<Camera>& cameras, const TriangulationOptions& options,
                 Profiles& out);

}  // namespace sensor_rt
