#include "sensor_rt/imaging/triangulate.h"

#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>

#include "sensor_rt/geometry/multiversion.h"
#include "sensor_rt/imaging/fuse.h"

namespace sensor_rt {
namespace {

/// Calls visit(array of each of the profiles) for every array.
template <typename Visit, typename... P>
void for_each_array(const Visit& visit, P&&... profiles) {
  visit(profiles.frame...);
  visit(profiles.camera...);
  visit(profiles.column...);
  visit(profiles.row...);
  visit(profiles.points_in_sensor...);
  visit(profiles.deviation...);
  visit(profiles.sigma...);
  visit(profiles.intensity...);
  visit(profiles.flags...);
}

/// d (p_x, p_y) / d (column, row).
Eigen::Matrix2d paper_jacobian(const Camera& camera, const Eigen::Vector2d& pixel) {
  const Eigen::Matrix2d signs = Eigen::Vector2d(-camera.side, 1.0).asDiagonal();
  if (camera.is_plain()) return signs;
  return camera.focal_px * signs * camera.ray_jacobian(camera.ray(pixel));
}

/// The end of the ray, at `point`, moves within the surface whose normal is `gradient`.
Eigen::Matrix<double, 3, 2> ray_form_jacobian(const Camera& camera, const Eigen::Vector2d& pixel,
                                              const Eigen::Vector3d& point, const Eigen::Vector3d& gradient) {
  const Eigen::Vector3d in_camera = camera.ray(pixel);
  const Eigen::Vector3d ray_in_sensor = camera.sensor_from_camera.rotation * in_camera;
  const double reach =
      ray_in_sensor.dot(point - camera.sensor_from_camera.translation) / ray_in_sensor.squaredNorm();
  const Eigen::Matrix<double, 3, 2> by_pixel =
      camera.sensor_from_camera.rotation.leftCols<2>() * camera.ray_jacobian(in_camera);
  return reach * (by_pixel - ray_in_sensor * (gradient.transpose() * by_pixel) / gradient.dot(ray_in_sensor));
}

/// Intersection of the pixel's ray with a sheet that is not the plane X = 0.
Eigen::Vector3d intersect_sheet(const Camera& camera, const SheetSurface& sheet,
                                const Eigen::Vector2d& pixel) {
  constexpr int kIterations = 20;          // four suffice for a sheet bent by some mrad
  constexpr double kSmallestStep = 1e-15;  // m
  const Eigen::Vector3d ray = (camera.sensor_from_camera.rotation * camera.ray(pixel)).normalized();
  Eigen::Vector3d point = triangulate_ray(camera, pixel);
  for (int iteration = 0; iteration < kIterations; ++iteration) {
    const SheetSurface::Offset offset = sheet.offset(point);
    const double step = offset.value / offset.gradient.dot(ray);
    point -= step * ray;
    if (std::abs(step) < kSmallestStep) return point;
  }
  // The last digit of the step may alternate; anything larger did not converge.
  constexpr double kConverged = 1e-12;  // m
  if (std::abs(sheet.offset(point).value) < kConverged) return point;
  return Eigen::Vector3d::Constant(std::numeric_limits<double>::quiet_NaN());
}

}  // namespace

Eigen::Vector3d triangulate_exact(const Camera& camera, const SheetSurface& sheet,
                                  const Eigen::Vector2d& pixel) {
  if (!sheet.is_nominal()) return intersect_sheet(camera, sheet, pixel);
  if (!camera.is_aligned) return triangulate_ray(camera, pixel);
  const Eigen::Vector2d p = camera.paper_coordinates(pixel);
  const double s = std::sin(camera.tilt);
  const double c = std::cos(camera.tilt);
  const double d = camera.focal_px * s - p.y() * c;
  return {0.0, camera.baseline() * p.x() / d,
          camera.height() + camera.baseline() * (camera.focal_px * c + p.y() * s) / d};
}

Eigen::Vector3d triangulate_ray(const Camera& camera, const Eigen::Vector2d& pixel) {
  const Eigen::Vector3d origin = camera.sensor_from_camera.translation;
  const Eigen::Vector3d direction = camera.sensor_from_camera.rotation * camera.ray(pixel);
  Eigen::Vector3d point = origin - origin.x() / direction.x() * direction;
  point.x() = 0.0;
  return point;
}

Eigen::Vector3d triangulate_eq4_as_printed(const Camera& camera, const Eigen::Vector2d& pixel) {
  const Eigen::Vector2d p = camera.paper_coordinates(pixel);
  const double angle = camera.tilt - std::atan(p.y() / camera.focal_px);
  return {0.0, camera.baseline() * p.x() / (camera.focal_px * std::sin(angle)),
          camera.baseline() / std::tan(angle) + camera.height()};
}

Eigen::Matrix<double, 3, 2> triangulation_jacobian(const Camera& camera, const SheetSurface& sheet,
                                                   const Eigen::Vector2d& pixel,
                                                   const Eigen::Vector3d& point) {
  if (!sheet.is_nominal()) return ray_form_jacobian(camera, pixel, point, sheet.offset(point).gradient);
  if (!camera.is_aligned) return ray_form_jacobian(camera, pixel, point, Eigen::Vector3d::UnitX());
  const Eigen::Vector2d p = camera.paper_coordinates(pixel);
  const double s = std::sin(camera.tilt);
  const double c = std::cos(camera.tilt);
  const double d = camera.focal_px * s - p.y() * c;
  Eigen::Matrix<double, 3, 2> by_paper = Eigen::Matrix<double, 3, 2>::Zero();
  by_paper(1, 0) = camera.baseline() / d;
  by_paper(1, 1) = camera.baseline() * p.x() * c / (d * d);
  by_paper(2, 1) = camera.baseline() * camera.focal_px / (d * d);
  return by_paper * paper_jacobian(camera, pixel);
}

namespace {

Eigen::Vector3d locate_by(TriangulationForm form, const Camera& camera, const SheetSurface& sheet,
                          const Eigen::Vector2d& pixel) {
  return form == TriangulationForm::kExact ? triangulate_exact(camera, sheet, pixel)
                                           : triangulate_eq4_as_printed(camera, pixel);
}

SENSOR_RT_MULTIVERSION
void locate_simply(const Triangulator::Constants& k, const double* __restrict column,
                   const double* __restrict row, Lanes3& __restrict point, Lanes3& __restrict per_row) {
  for (int l = 0; l < kLanes; ++l) {
    const double px = -k.side * (column[l] - k.cx);
    const double py = row[l] - k.cy;
    const double inverse = 1.0 / (k.focal * k.sine - py * k.cosine);
    const double scale = k.baseline * inverse;
    point.x[l] = 0.0;
    point.y[l] = scale * px;
    point.z[l] = k.height + scale * (k.focal * k.cosine + py * k.sine);
    per_row.x[l] = 0.0;
    per_row.y[l] = scale * inverse * px * k.cosine;
    per_row.z[l] = scale * inverse * k.focal;
  }
}

}  // namespace

Triangulator::Triangulator(const Camera& camera, TriangulationForm form, const SheetSurface& sheet)
    : camera_(camera),
      form_(form),
      sheet_(sheet),
      simple_(camera.is_plain() && camera.is_aligned && form == TriangulationForm::kExact &&
              sheet.is_nominal()),
      constants_{static_cast<double>(camera.side),
                 camera.cx_px,
                 camera.cy_px,
                 camera.focal_px,
                 camera.baseline(),
                 camera.height(),
                 std::sin(camera.tilt),
                 std::cos(camera.tilt)} {}

void Triangulator::locate(const double* column, const double* row, Lanes3& point, Lanes3& per_row) const {
  if (simple_) {
    locate_simply(constants_, column, row, point, per_row);
    return;
  }
  for (int l = 0; l < kLanes; ++l) {
    const Eigen::Vector2d pixel(column[l], row[l]);
    const Eigen::Vector3d at = locate_by(form_, camera_, sheet_, pixel);
    set_lane(point, l, at);
    set_lane(per_row, l, triangulation_jacobian(camera_, sheet_, pixel, at).col(1));
  }
}

namespace {

void triangulate_range(const Peaks& peaks, std::size_t begin, std::size_t end,
                       const std::vector<Camera>& cameras, const TriangulationOptions& options,
                       Profiles& out) {
  for (std::size_t i = begin; i < end; ++i) {
    const auto index = static_cast<std::size_t>(peaks.camera[i]);
    if (peaks.camera[i] < 0 || index >= cameras.size()) {
      throw std::invalid_argument("peak " + std::to_string(i) + " names camera " +
                                  std::to_string(peaks.camera[i]) + ", but the sensor has " +
                                  std::to_string(cameras.size()));
    }
    if (!options.keep_rejected && (peaks.flags[i] & kPeakRejected) != 0) continue;
    const Eigen::Vector2d pixel(peaks.column[i], peaks.row[i]);
    const Eigen::Vector3d point = locate_by(options.form, cameras[index], options.sheet, pixel);
    if (!(point.z() >= options.near && point.z() <= options.far)) continue;
    // The column centre is exact, so that the point is uncertain only along the image of its column.
    const auto row_sigma = static_cast<double>(peaks.row_sigma[i]);
    const Eigen::Vector3d deviation =
        triangulation_jacobian(cameras[index], options.sheet, pixel, point).col(1) * row_sigma;
    out.frame.push_back(peaks.frame[i]);
    out.camera.push_back(peaks.camera[i]);
    out.column.push_back(peaks.column[i]);
    out.row.push_back(peaks.row[i]);
    out.points_in_sensor.push_back(point);
    out.deviation.push_back(deviation.cast<float>());
    out.sigma.push_back(static_cast<float>(deviation.norm()));
    out.intensity.push_back(peaks.amplitude[i]);
    out.flags.push_back(peaks.flags[i]);
  }
}

}  // namespace

void triangulate(const Peaks& peaks, const std::vector<Camera>& cameras, const TriangulationOptions& options,
                 Profiles& out) {
  std::size_t begin = 0;
  while (begin < peaks.size()) {
    std::size_t end = begin + 1;
    while (end < peaks.size() && peaks.frame[end] == peaks.frame[begin]) ++end;
    const std::size_t first = out.size();
    triangulate_range(peaks, begin, end, cameras, options, out);
    if (options.fusion == Fusion::kWeighted) fuse(cameras, options.sheet, options.agreement_px, first, out);
    begin = end;
  }
}

void Profiles::clear() {
  for_each_array([](auto& array) { array.clear(); }, *this);
}

void Profiles::reserve(std::size_t count) {
  for_each_array([&](auto& array) { array.reserve(count); }, *this);
}

void Profiles::resize(std::size_t count) {
  const bool exact = is_exact();
  for_each_array([&](auto& array) { array.resize(count); }, *this);
  if (exact) deviation.clear();
}

void Profiles::move(std::size_t from, std::size_t to) {
  for_each_array(
      [&](auto& array) {
        if (!array.empty()) array[to] = array[from];
      },
      *this);
}

void Profiles::append(const Profiles& other) {
  for_each_array([](auto& to, const auto& from) { to.insert(to.end(), from.begin(), from.end()); }, *this,
                 other);
}

}  // namespace sensor_rt
