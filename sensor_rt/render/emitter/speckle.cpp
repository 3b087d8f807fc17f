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
    : plan_(plan), camera_(number) {
  if (!enabled()) return;
  const Camera& camera = plan.settings.model.cameras[number];
  camera_from_sensor_ = camera.sensor_from_camera.inverse();
  const double grain_px = plan.settings.model.laser.wavelength * camera.f_number / camera.pixel_pitch;
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

/// Returns the image displacement, px, of a surface point relative to mid-exposure; distortion is neglected
/// over this short distance.
Eigen::Vector2d Speckle::motion(std::int32_t shape, const Eigen::Vector3d& point,
                                const Eigen::Vector3d& point_in_shape) const {
  const double focal = plan_.settings.model.cameras[camera_].focal_px;
  const Eigen::Vector3d now = camera_from_sensor_ * point;
  const Eigen::Vector3d then =
      camera_from_sensor_ * (reference_from_shape_[static_cast<std::size_t>(shape)] * point_in_shape);
  return focal * (now.head<2>() / now.z() - then.head<2>() / then.z());
}

double Speckle::factor(const PoseTrack& track, std::size_t instant, std::int32_t shape,
                       const Eigen::Vector3d& point, const Eigen::Vector2d& pixel, Cell& cell) const {
  const Eigen::Vector3d point_in_shape =
      track.shape_from_reference(static_cast<std::size_t>(shape), instant) * point;
  enter(shape, point_in_shape, cell);
  Eigen::Vector2d at_middle = pixel;
  if (track.instants() > 1) at_middle -= motion(shape, point, point_in_shape);
  const Eigen::Vector2d step = steps_per_pixel_ * at_middle + cell.from_pixel;
  return static_cast<double>(plan_.speckle_tile->at(std::lround(step.x()), std::lround(step.y())));
}

}  // namespace sensor_rt
