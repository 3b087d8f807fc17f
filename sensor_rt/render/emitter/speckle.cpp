#include "sensor_rt/render/emitter/speckle.h"

#include <algorithm>
#include <cmath>

#include "sensor_rt/geometry/random.h"

namespace sensor_rt {
namespace {

/// Cell size in grains at the smallest grain size; below the tile size, so that a cell shows no grain twice.
constexpr double kGrainsPerCell = 96.0;

/// Offset of the cell grid from the centre planes of a shape, where surfaces often lie.
constexpr double kCellShift[3] = {0.3819, 0.2361, 0.1459};

}  // namespace

Speckle::Speckle(const RenderPlan& plan, const Scene& scene, const PoseTrack& track, std::size_t number)
    : plan_(plan), track_(track), camera_(number) {
  if (!enabled()) return;
  const Camera& camera = plan.settings.model.cameras[number];
  camera_from_sensor_ = camera.sensor_from_camera.inverse();
  const double grain_px = camera.grain_px(plan.settings.model.laser.wavelength);
  steps_per_pixel_ = SpeckleTile::kPerGrain / grain_px;
  cell_size_ = kGrainsPerCell * grain_px * plan.pixel_size;
  for (std::size_t s = 0; s < scene.shapes().size(); ++s) {
    reference_from_shape_.push_back(track.shape_from_reference(s, track.instants() / 2).inverse());
  }
}

/// Moves `cell` to the cell of a point.
void Speckle::enter(std::int32_t shape, const Eigen::Vector3d& point_in_shape, Cell& cell) const {
  std::array<std::int32_t, 3> index{};
  Eigen::Vector3d middle;
  for (int k = 0; k < 3; ++k) {
    const double number = std::floor(point_in_shape[k] / cell_size_ + kCellShift[k]);
    index[static_cast<std::size_t>(k)] = static_cast<std::int32_t>(number);
    middle[k] = (number + 0.5 - kCellShift[k]) * cell_size_;
  }
  if (cell.shape == shape && cell.index == index) return;
  cell.shape = shape;
  cell.index = index;
  const std::uint64_t seed = plan_.settings.seed;
  const auto bits = philox4x32(
      {static_cast<std::uint32_t>(index[0]), static_cast<std::uint32_t>(index[1]),
       static_cast<std::uint32_t>(index[2]), static_cast<std::uint32_t>(shape)},
      {static_cast<std::uint32_t>(seed) ^ (0x6A41Eu + 0x9E3779B9u * static_cast<std::uint32_t>(camera_)),
       static_cast<std::uint32_t>(seed >> 32)});
  const Camera& camera = plan_.settings.model.cameras[camera_];
  const Eigen::Vector2d seen =
      camera.project(camera_from_sensor_ * (reference_from_shape_[static_cast<std::size_t>(shape)] * middle));
  const Eigen::Vector2d piece(bits[0] % SpeckleTile::kSteps, bits[1] % SpeckleTile::kSteps);
  cell.from_pixel = piece - steps_per_pixel_ * seen;
}

/// Returns where a pinhole without distortion shows a point, px from the principal point: for displacements.
Eigen::Vector2d Speckle::image(const Eigen::Vector3d& point) const {
  const Eigen::Vector3d in_camera = camera_from_sensor_ * point;
  return plan_.settings.model.cameras[camera_].focal_px / in_camera.z() * in_camera.head<2>();
}

/// Returns the offset from pixel coordinates to steps of the tile at a point that has moved since
/// mid-exposure.
Eigen::Vector2d Speckle::from_pixel(std::size_t instant, std::int32_t shape, const Eigen::Vector3d& point,
                                    Cell& cell) const {
  const auto number = static_cast<std::size_t>(shape);
  const Eigen::Vector3d point_in_shape = track_.shape_from_reference(number, instant) * point;
  enter(shape, point_in_shape, cell);
  if (track_.instants() == 1) return cell.from_pixel;
  const Eigen::Vector2d motion = image(point) - image(reference_from_shape_[number] * point_in_shape);
  return cell.from_pixel - steps_per_pixel_ * motion;
}

double Speckle::at_point(std::size_t instant, std::int32_t shape, const Eigen::Vector3d& point,
                         const Eigen::Vector2d& pixel, Cell& cell) const {
  return static_cast<double>(
      plan_.speckle_tile->at(steps_per_pixel_ * pixel + from_pixel(instant, shape, point, cell)));
}

Speckle::Patch Speckle::patch(std::size_t instant, std::int32_t shape, const Eigen::Vector3d& point,
                              const Eigen::Vector3d& travel, Cell& cell) const {
  const Eigen::Vector2d middle = from_pixel(instant, shape, point, cell);
  if (travel.isZero()) return {1, {middle, middle}};
  // Gauss-Legendre nodes of the time interval.
  const double node = 0.5 / std::sqrt(3.0);
  const Eigen::Vector2d motion =
      node * steps_per_pixel_ * (image(point + 0.5 * travel) - image(point - 0.5 * travel));
  return {2, {middle - motion, middle + motion}};
}

}  // namespace sensor_rt
