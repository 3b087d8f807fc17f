#include "sensor_rt/visibility/free_distances.h"

#include <algorithm>

namespace sensor_rt {

FreeDistances::FreeDistances(RTCScene scene, const DirectionGrid& grid, double farthest)
    : scene_(scene), farthest_(static_cast<float>(farthest * (1.0 + 1e-6))) {
  const int cells = grid.tiles() * DirectionGrid::kTileCells;
  for (int cell = 0; cell < cells; ++cell) {
    const Eigen::Vector3f direction = grid.direction(cell).cast<float>();
    for (int k = 0; k < 3; ++k) direction_[k].push_back(direction[k]);
  }
  distance_.resize(static_cast<std::size_t>(cells));
  is_cast_.resize(static_cast<std::size_t>(grid.tiles()));
}

void FreeDistances::start(const Eigen::Vector3f& origin, const Eigen::Vector3f& normal, float min_cosine) {
  origin_ = origin;
  normal_ = normal;
  min_cosine_ = min_cosine;
  std::fill(is_cast_.begin(), is_cast_.end(), std::uint8_t{0});
}

void FreeDistances::cast(std::size_t tile) {
  constexpr int kCells = DirectionGrid::kTileCells;
  const std::size_t first = tile * kCells;
  is_cast_[tile] = 1;
  alignas(64) int valid[kCells];
  bool any = false;
  RTCRayHit16 rays{};
  for (int l = 0; l < kCells; ++l) {
    const std::size_t cell = first + static_cast<std::size_t>(l);
    const float x = direction_[0][cell];
    const float y = direction_[1][cell];
    const float z = direction_[2][cell];
    // Cells beyond the poles have a zero direction, which is below min_cosine for every sample.
    const bool faces = x * normal_.x() + y * normal_.y() + z * normal_.z() >= min_cosine_;
    valid[l] = faces ? -1 : 0;
    any = any || faces;
    rays.ray.org_x[l] = origin_.x();
    rays.ray.org_y[l] = origin_.y();
    rays.ray.org_z[l] = origin_.z();
    rays.ray.dir_x[l] = x;
    rays.ray.dir_y[l] = y;
    rays.ray.dir_z[l] = z;
    rays.ray.tfar[l] = farthest_;
    rays.ray.mask[l] = ~0u;
    rays.hit.geomID[l] = RTC_INVALID_GEOMETRY_ID;
  }
  if (any) intersect16(scene_, valid, rays);
  for (int l = 0; l < kCells; ++l)
    distance_[first + static_cast<std::size_t>(l)] = valid[l] != 0 ? rays.ray.tfar[l] : 0.0f;
}

}  // namespace sensor_rt
