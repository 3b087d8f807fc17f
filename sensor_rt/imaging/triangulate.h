// Peaks -> Profiles: points in the sensor frame with their uncertainty.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include <Eigen/Dense>

#include "sensor_rt/geometry/large_vector.h"
#include "sensor_rt/imaging/peaks.h"
#include "sensor_rt/optics/camera.h"

namespace sensor_rt {

/// kEq4AsPrinted is the published form, kept for comparison: its Y is too large by sqrt(f² + p_y²) / f.
enum class TriangulationForm { kExact, kEq4AsPrinted };

/// kWeighted: points that several cameras saw become one, see fuse.h.
enum class Fusion { kNone, kWeighted };

struct TriangulationOptions {
  TriangulationForm form = TriangulationForm::kExact;
  Fusion fusion = Fusion::kNone;
  double agreement_px = 0.0;   ///< points of two cameras further apart than this and their noise stay apart
  double near = 0.0;           ///< m: points with sensor Z outside [near, far] are left out
  double far = 0.0;            ///< m
  bool keep_rejected = false;  ///< true: also triangulate peaks whose flags are in kPeakRejected
};

/// Points of any number of frames, as a structure of arrays. Metres, sensor frame (x = 0 on the laser sheet).
struct Profiles {
  LargeVector<std::int64_t> frame;
  LargeVector<std::int32_t> camera;
  LargeVector<std::int32_t> column;
  LargeVector<double> row;  ///< px, as the camera saw it
  LargeVector<Eigen::Vector3d> points_in_sensor;
  /// One standard deviation along the line on which the point is uncertain, m: its covariance is d dᵀ. Empty
  /// when all points are exact.
  LargeVector<Eigen::Vector3d> deviation;
  LargeVector<float> sigma;          ///< m: length of the deviation
  LargeVector<float> intensity;      ///< amplitude of the peak, DN
  LargeVector<std::uint32_t> flags;  ///< PeakFlag bits

  std::size_t size() const { return points_in_sensor.size(); }
  bool is_exact() const { return deviation.empty(); }
  /// Drops the points and keeps the memory.
  void clear();
  void reserve(std::size_t count);
  /// Both exact, or neither, unless one is empty.
  void append(const Profiles& other);
  void resize(std::size_t count);
  void move(std::size_t from, std::size_t to);
};

/// Point on the laser sheet seen at a pixel: closed form (pinhole in the frame of the paper, distortion and
/// sensor tilt removed first); the ray form for cameras that do not stand as in the paper.
Eigen::Vector3d triangulate_exact(const Camera& camera, const Eigen::Vector2d& pixel);

/// The same as the intersection of the pixel's ray with the sheet X = 0, from the camera's pose alone.
Eigen::Vector3d triangulate_ray(const Camera& camera, const Eigen::Vector2d& pixel);

/// Dumitrache & Borangiu, Eq. 4, as printed (without the stray f in the denominator of Z).
Eigen::Vector3d triangulate_eq4_as_printed(const Camera& camera, const Eigen::Vector2d& pixel);

/// d point / d (column, row) of triangulate_exact, m/px.
Eigen::Matrix<double, 3, 2> triangulation_jacobian(const Camera& camera, const Eigen::Vector2d& pixel);

/// Appends the points of all usable peaks, which are sorted by frame, camera and column. Throws
/// std::invalid_argument when a peak names a camera that is not there.
void triangulate(const Peaks& peaks, const std::vector<Camera>& cameras, const TriangulationOptions& options,
                 Profiles& out);

}  // namespace sensor_rt
