#include "sensor_rt/scene/spatial_order.h"

#include <algorithm>
#include <limits>

namespace sensor_rt {
namespace {

constexpr float kInfinity = std::numeric_limits<float>::infinity();

struct Middle {
  float at[3];
  std::uint32_t face;
};

/// Partitions recursively: the first half of each aligned power-of-two block of leaves lies on one side of
/// the second half.
void split(Middle* first, std::size_t count) {
  if (count <= kFacesPerLeaf) return;
  std::size_t half = kFacesPerLeaf;
  while (2 * half < count) half *= 2;
  float low[3] = {kInfinity, kInfinity, kInfinity};
  float high[3] = {-kInfinity, -kInfinity, -kInfinity};
  for (std::size_t i = 0; i < count; ++i) {
    for (int k = 0; k < 3; ++k) {
      low[k] = std::min(low[k], first[i].at[k]);
      high[k] = std::max(high[k], first[i].at[k]);
    }
  }
  int axis = 0;
  for (int k = 1; k < 3; ++k) axis = high[k] - low[k] > high[axis] - low[axis] ? k : axis;
  // The face index breaks ties, so that the order does not depend on the standard library.
  std::nth_element(first, first + half, first + count, [axis](const Middle& a, const Middle& b) {
    return a.at[axis] < b.at[axis] || (a.at[axis] == b.at[axis] && a.face < b.face);
  });
  split(first, half);
  split(first + half, count - half);
}

}  // namespace

std::vector<std::uint32_t> spatial_order(const MeshView& mesh, const Eigen::Vector3d& centre) {
  std::vector<Middle> middles(mesh.face_count);
  for (std::size_t f = 0; f < mesh.face_count; ++f) {
    const Eigen::Vector3d middle = (mesh.corner(f, 0) + mesh.corner(f, 1) + mesh.corner(f, 2)) / 3.0 - centre;
    for (int k = 0; k < 3; ++k) middles[f].at[k] = static_cast<float>(middle[k]);
    middles[f].face = static_cast<std::uint32_t>(f);
  }
  split(middles.data(), middles.size());
  std::vector<std::uint32_t> order(mesh.face_count);
  std::transform(middles.begin(), middles.end(), order.begin(), [](const Middle& one) { return one.face; });
  return order;
}

}  // namespace sensor_rt
